"""The command that tunes: the tuner in the browser, without a notebook around it."""

from __future__ import annotations

import argparse
import os
import sys
import threading
import webbrowser
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

from endolab._extras import need
from endolab.cli.options import add_command, integer, load_endoscope, wide

if TYPE_CHECKING:
    from endolab.model.endoscope import Calibration
    from endolab.numerics.arrays import FloatArray


def _tune(arguments: argparse.Namespace) -> None:
    need("ipywidgets", "anywidget", "tornado")
    from endolab.cli.lab import free_port
    from endolab.io.images import read_frame

    port = free_port(arguments.port)

    from endolab.workbench.tuning.server import Page

    calibration = load_endoscope(arguments)
    pictures = find_pictures(arguments.frame)
    first = read_frame(pictures[0], calibration)
    truth = None
    if arguments.truth is not None:
        if len(pictures) > 1:
            raise ValueError("--truth is of one frame, and there is a folder of them")
        truth = read_truth(arguments.truth, calibration)

    def make() -> Any:
        from endolab.workbench.tuning.widget import TunerBox

        return TunerBox(first, calibration, truth, width=arguments.width, pictures=pictures)

    def announce() -> None:
        taken = f" (port {arguments.port} is taken)" if port != arguments.port else ""
        print(f"tuner: {page.link}{taken}")
        if page.origin is not None:
            print(f"through the proxy: {page.origin}{urlsplit(page.link).path}")
        print("It ends when its page is closed, or by Ctrl-C.", flush=True)
        if arguments.browser:
            threading.Thread(target=_open, args=(page.link,), daemon=True).start()

    page = Page(make, f"{first.name} · endolab", port, arguments.origin)
    with suppress(KeyboardInterrupt):  # which is how it ends
        page.run(announce)
    print("ended", flush=True)
    os._exit(0)  # Python would wait for a solve that is still being compiled


def find_pictures(source: str | Path) -> list[Path]:
    """Find a picture, or those of a folder in the order of their numbers, but for depth maps.

    OSError or ValueError in one sentence, if there is none.
    """
    from endolab.io.datasets.folders import depth_layout
    from endolab.io.video import is_sequence, open_frames

    path = Path(source)
    if not is_sequence(path):
        return [path]
    names = open_frames(path).names if path.is_dir() else []  # not of a video
    pictures = [path / name for name in names if depth_layout(name) is None]
    if not pictures:
        raise ValueError(f"{path}: expected a picture or a folder of pictures")
    return pictures


def read_truth(path: str | Path, calibration: Calibration) -> FloatArray:
    """Read the true distance, (H, W), mm, of a frame of this size: truth.npz, or a data set's depth map."""
    import numpy as np

    from endolab.frames.frame import check_size
    from endolab.io.datasets.folders import true_z
    from endolab.io.surfaces import read_depth

    is_z = not str(path).endswith(".npz")
    truth = true_z(path) if is_z else read_depth(path, ("distance",))["distance"]
    check_size(str(path), truth.shape[::-1], calibration.camera)
    cosine = calibration.camera.field.cos_alpha
    return truth / np.where(cosine > 0, cosine, np.nan) if is_z else truth


def _open(link: str) -> None:
    if not webbrowser.open(link):
        print("There is no browser that could be opened; open the link.", file=sys.stderr)


def add_tune_command(commands: Any) -> None:
    """Add the command `tune` to a parser."""
    command = add_command(
        commands,
        "tune",
        _tune,
        "the tuner in the browser",
        "endolab tune frame.png --calibration endoscope.json",
        "endolab tune frames --calibration c3vd --width 480",
        "endolab tune a.png --calibration endoscope.json --truth truth.npz",
    )
    option = command.add_argument
    option(
        "frame",
        metavar="FRAME",
        help="PNG, JPEG or TIFF, 8 or 16 bits; or a folder of these",
    )
    text = "endoscope.json, or a known endoscope's name"
    option("--calibration", required=True, metavar="CAL", help=text)
    option(
        "--truth",
        metavar="T",
        help="truth.npz of the frame, or its depth map of a published data set",
    )
    option(
        "--width", type=wide, default=320, metavar="PX", help="to begin with (default 320)"
    )
    option(
        "--port",
        type=integer,
        default=8877,  # apart from JupyterLab's
        metavar="N",
        help="the next free one (default 8877)",
    )
    text = "of a proxy in front of it, such as https://lab.example.org, whose pages may come too"
    option("--origin", metavar="URL", help=text)
    text = "print the link, and open no browser"
    option("--no-browser", action="store_false", dest="browser", help=text)

"""The command that tunes: the tuner in the browser, without a notebook around it."""

from __future__ import annotations

import os
import threading
import webbrowser
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from endolab._extras import need
from endolab.cli.solving import (
    Count,
    Lamps,
    Port,
    Rectangle,
    free_port,
    load,
    load_endoscope,
    show_progress,
    tunnel,
)

if TYPE_CHECKING:
    from endolab.model.endoscope import Calibration
    from endolab.numerics.arrays import FloatArray


def tune(
    frame: str,
    /,
    *,
    calibration: str | None = None,
    fov: float | None = None,
    crop: Rectangle = None,
    lamp: Lamps = None,
    truth: str | None = None,
    width: Count = 320,
    port: Port = 8877,
    origin: str | None = None,
    no_browser: bool = False,
    html: str | None = None,
) -> None:
    """Open the tuner in the browser.

    - endolab tune picture.jpg
    - endolab tune frame.png --calibration endoscope.json
    - endolab tune frames --calibration c3vd --width 480
    - endolab tune a.png --calibration endoscope.json --truth truth.npz

    Parameters
    ----------
    frame : path
        A picture (PNG, JPEG, TIFF, AVIF, DICOM ...), or a folder of these.
    calibration : path
        endoscope.json, a known endoscope's name, or another program's file; a nominal fisheye without.
    fov : float
        Across what the picture shows, degrees, without a calibration (140).
    crop : COLUMN,ROW,WIDTH,HEIGHT
        The part of the calibration's picture that this one shows, as of a zoom, px; or the part of this one
        that is the calibration's, as an eye of a stereo picture.
    lamp : X,Y[,Z]
        Where a lamp stands, mm: x right, y down of the lens; once for each, instead of those listed.
    truth : path
        truth.npz of the frame, or its depth map of a published data set.
    width : int
        Of the frame to begin with, px.
    port : int
        Where to listen, or on the next that is free.
    origin : str
        Of a proxy in front of it, such as https://lab.example.org, whose pages may come too.
    no_browser : bool
        Print the link, and open no browser.
    html : path
        Write a tuner that needs no Python into this page, λ × regulariser, and open nothing.
    """
    need("ipywidgets", "anywidget", "tornado")
    from endolab.io.images import read_frame
    from endolab.workbench.tuning.server import Page

    pictures = find_pictures(frame)
    endoscope = load_endoscope(calibration, [frame], fov, crop)
    known, _ = load(endoscope, {}, {"lamps": lamp}, None)
    first = read_frame(pictures[0], known)
    true = None if truth is None else read_truth(truth, known)
    if true is not None and len(pictures) > 1:
        raise ValueError("--truth is of one frame, and there is a folder of them")

    def make() -> Any:
        from endolab.workbench.tuning.widget import TunerBox

        return TunerBox(first, known, true, width=width, pictures=pictures)

    if html is not None:
        box = make()
        with show_progress("answer") as show:
            box.export_html(html, show)
        box.close()
        print(f"tuner without Python: {html}")
        return
    listening = free_port(port)
    remote = tunnel(listening)
    page = Page(make, f"{first.name} · endolab", listening, origin)

    def announce() -> None:
        print(f"tuner: {page.link}")
        if remote:
            print(remote)
        print("It ends when its page is closed, or by Ctrl-C.", flush=True)
        if not (no_browser or remote):
            threading.Thread(target=webbrowser.open, args=(page.link,), daemon=True).start()

    with suppress(KeyboardInterrupt):  # which is how it ends
        page.run(announce)
    print("ended", flush=True)
    os._exit(0)  # Python would wait for a solve that is still being compiled


def find_pictures(source: str | Path) -> list[Path]:
    """Find a picture, or those of a folder in the order of their numbers, but for depth maps.

    OSError or ValueError in one sentence, if there is none.
    """
    from endolab.io.datasets.published import depth_layout
    from endolab.io.video import open_frames

    frames = open_frames(source)
    pictures = [frames.path / name for name in frames.names if not depth_layout(name)]
    if frames.is_video or not pictures:
        raise ValueError(f"{source}: expected a picture or a folder of pictures")
    return pictures


def read_truth(path: str | Path, calibration: Calibration) -> FloatArray:
    """Read the true distance, (H, W), mm, of a frame of this size: truth.npz, or a data set's depth map."""
    import numpy as np

    from endolab.io.datasets.published import true_z
    from endolab.io.surfaces import read_depth

    is_z = not str(path).endswith(".npz")
    truth = true_z(path) if is_z else read_depth(path, ("distance",))["distance"]
    height, width = truth.shape
    cosine = calibration.fit(str(path), width, height).camera.field.cos_alpha
    return truth / np.where(cosine > 0, cosine, np.nan) if is_z else truth

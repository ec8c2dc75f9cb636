"""The command that tunes: the tuner in the browser, without a notebook around it."""

import argparse
import os
import sys
import threading
import webbrowser
from contextlib import suppress
from typing import Any

from endolab._extras import need
from endolab.cli.options import add_command, whole, wide

PORT = 8877  # the first that is tried, apart from JupyterLab's


def _tune(arguments: argparse.Namespace) -> None:
    need("ipywidgets", "anywidget", "tornado")
    from endolab.cli.lab import free_port
    from endolab.datasets.known_endoscopes import load_calibration
    from endolab.io.images import read_frame

    port = free_port(arguments.port)

    from endolab.tuning.folder import find_pictures, read_truth
    from endolab.tuning.server import Page

    calibration = load_calibration(arguments.calibration)
    pictures = find_pictures(arguments.frame)
    if arguments.truth is not None and len(pictures) > 1:
        raise ValueError("--truth is of one frame, and there is a folder of them")
    first = read_frame(pictures[0], calibration)
    truth = None if arguments.truth is None else read_truth(arguments.truth, calibration)

    def make() -> Any:
        from endolab.tuning.widget import TunerBox

        return TunerBox(first, calibration, truth, width=arguments.width, pictures=pictures)

    def opened() -> None:
        taken = f" (port {arguments.port} is taken)" if port != arguments.port else ""
        print(f"tuner: {page.link}{taken}", flush=True)
        print("It ends when its page is closed, or by Ctrl-C.", flush=True)
        if arguments.browser:
            threading.Thread(target=_open, args=(page.link,), daemon=True).start()

    page = Page(make, f"{first.name} · endolab", port)
    with suppress(KeyboardInterrupt):  # which is how it ends
        page.run(opened)
    print("ended", flush=True)
    if page.busy:  # Python would wait for it
        os._exit(0)


def _open(link: str) -> None:
    if not webbrowser.open(link):
        print("There is no browser that could be opened; open the link.", file=sys.stderr, flush=True)


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
    option("frame", metavar="FRAME", help="PNG, JPEG or TIFF, 8 or 16 bits; or a folder of these")
    how = "endoscope.json, or a known endoscope's name"
    option("--calibration", required=True, metavar="CAL", help=how)
    option("--truth", metavar="T", help="truth.npz of the frame, or its depth map of a published data set")
    option("--width", type=wide, default=320, metavar="PX", help="to begin with (default 320)")
    option("--port", type=whole, default=PORT, metavar="N", help=f"the next free one (default {PORT})")
    how = "print the link, and open no browser"
    option("--no-browser", action="store_false", dest="browser", help=how)

"""The Rerun viewer: native, or in a notebook; for this machine only."""

import contextlib
import io
import os
import socket
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import psutil

VIEWER_PORT = 9876  # the viewer's own default
NO_SCREEN = "the Rerun viewer did not start: it needs a screen; record to a file instead"


def start_viewer(path: Path | None = None) -> subprocess.Popen[bytes] | None:
    """Start the native viewer and return it, or None if there is one; a recording is opened in either.

    One that follows a run forgets what is oldest beyond 2 GB. Not by ``rr.spawn``, which listens to the
    network. An OSError says that it does not start.
    """
    is_running = is_listening(VIEWER_PORT)
    if is_running and path is None:
        return None
    screens = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")  # Linux has one of them then
    if sys.platform == "linux" and not any(os.environ.get(name) for name in screens):
        raise OSError(NO_SCREEN)
    # Run as a module, rerun_cli exits with 0 whatever has happened.
    program = "import sys, rerun_cli.__main__ as cli; sys.exit(cli.main())"
    words = f"--bind 127.0.0.1 --port {VIEWER_PORT}".split()
    if path is None:
        words += ["--memory-limit", "2GB", "--expect-data-soon"]
    else:
        words.append(str(path.resolve()))
    viewer = subprocess.Popen(
        [sys.executable, "-c", program, *words],
        # The one variable by which the viewer sends no usage data.
        env=os.environ | {"CI": "1"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # an interrupt ends the run and leaves the window
    )
    started = time.monotonic()
    # With a screen that it cannot use it listens for a moment before it gives up.
    while time.monotonic() < started + 1.5 or (
        not is_listening(VIEWER_PORT) and time.monotonic() < started + 20
    ):
        if viewer.poll() is not None:
            if is_running and viewer.returncode == 0:  # it has passed the recording on
                return None
            raise OSError(NO_SCREEN)
        time.sleep(0.1)
    return viewer


def end(program: subprocess.Popen[bytes]) -> None:
    """End a viewer, with all that it has started, at once."""
    with contextlib.suppress(psutil.Error):
        children = psutil.Process(program.pid).children(recursive=True)
        for child in children:
            child.kill()
        psutil.wait_procs(children, 5)
    program.kill()
    program.communicate()


def is_listening(port: int) -> bool:
    """Whether a program on this machine listens to a port."""
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def front_end() -> bool:
    """Whether someone looks at this notebook; a test or a script that runs one shows no widgets."""
    # Told to kernels by those who show what they say: Jupyter's server, VS Code, Colab.
    names = ("JPY_SESSION_NAME", "VSCODE_PID", "COLAB_RELEASE_TAG")
    return "ipykernel" in sys.modules and any(os.environ.get(name) for name in names)


def notebook_viewer() -> Any:
    """Rerun's module for notebooks, with its program served by this machine."""
    os.environ.setdefault("RERUN_NOTEBOOK_ASSET", "serve-local")
    with contextlib.redirect_stdout(io.StringIO()):  # it tells of every step
        import rerun_notebook  # type: ignore[import-untyped]
    return rerun_notebook

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
    is_running = _is_listening()
    if is_running and path is None:
        return None
    # Run as a module, rerun_cli exits with 0 whatever has happened.
    program = "import sys, rerun_cli.__main__ as cli; sys.exit(cli.main())"
    words = f"--bind 127.0.0.1 --port {VIEWER_PORT}"
    following = "--memory-limit 2GB --expect-data-soon"
    opened = following.split() if path is None else [str(path.resolve())]
    viewer = subprocess.Popen(
        [sys.executable, "-c", program, *words.split(), *opened],
        # The one variable by which the viewer sends no usage data.
        env=os.environ | {"CI": "1"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # an interrupt ends the run and leaves the window
    )
    started = time.monotonic()
    # Without a screen that it can use it listens for a moment before it gives up.
    while time.monotonic() < started + 1.5 or (
        not _is_listening() and time.monotonic() < started + 20
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
        for child in psutil.Process(program.pid).children(recursive=True):
            child.kill()
    program.kill()
    program.communicate()


def _is_listening() -> bool:
    """Whether a viewer listens on this machine."""
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", VIEWER_PORT)) == 0


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

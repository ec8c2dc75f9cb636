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
import rerun as rr

PORT = 9876  # the viewer's own default
HEIGHT = 640  # px, of a viewer in a notebook
SCREENS = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")  # variables, one of which Linux has then
# Told to kernels by those who show what they say: Jupyter's server, VS Code, Colab.
FRONT_ENDS = ("JPY_SESSION_NAME", "VSCODE_PID", "COLAB_RELEASE_TAG")
# Run as a module, rerun_cli exits with 0 whatever has happened.
VIEWER = "import sys, rerun_cli.__main__ as cli; sys.exit(cli.main())"
# Ends, with all that it has started, when its input does: with the process at the other end.
SERVER = f"""
import os, signal, sys, threading

def watch():
    sys.stdin.read()
    os.killpg(0, signal.SIGKILL)

threading.Thread(target=watch, daemon=True).start()
{VIEWER}
"""
MOST_SERVERS = 4  # of earlier cells too, whose pages may still ask
NO_SCREEN = "the Rerun viewer did not start: it needs a screen; record to a file instead"

_servers: list[subprocess.Popen[bytes]] = []


def viewer_address(port: int | None = None) -> str:
    """Where the native viewer listens, or a server at a port."""
    return f"rerun+http://127.0.0.1:{PORT if port is None else port}/proxy"


def start_viewer(path: Path | None = None, memory: str | None = None) -> subprocess.Popen[bytes] | None:
    """Start the native viewer and return it, or None if there is one; a recording is opened in either.

    One that is started forgets what is oldest when it takes that much `memory`, such as "2GB". Not by
    ``rr.spawn``, which listens to the network. An OSError says that it does not start.
    """
    there = is_listening(PORT)
    if there and path is None:
        return None
    if sys.platform == "linux" and not any(os.environ.get(name) for name in SCREENS):
        raise OSError(NO_SCREEN)
    limit = () if memory is None else ("--memory-limit", memory)
    viewer = _start(PORT, *limit, "--expect-data-soon" if path is None else str(path.resolve()))
    started = time.monotonic()
    # With a screen that it cannot use it listens for a moment before it gives up.
    while time.monotonic() < started + 1.5 or (not is_listening(PORT) and time.monotonic() < started + 20):
        if viewer.poll() is not None:
            if there and viewer.returncode == 0:  # it has passed the recording on
                return None
            raise OSError(NO_SCREEN)
        time.sleep(0.1)
    return viewer


def start_server() -> str:
    """Start a server between a run and the pages that follow it, and return its address.

    A process of its own, which ends with this one, and keeps in memory what it has passed on. It listens on
    127.0.0.1 only, but knows no password: who else works on this machine could find its port and see the
    recording. Rerun's server within a program listens to the network, and ends with the stream, before a
    slow page has asked for it. An OSError says that it does not start.
    """
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    _servers.append(_start(port, "--serve-grpc", program=SERVER, stdin=subprocess.PIPE))
    for old in _servers[:-MOST_SERVERS]:
        end(old)
        _servers.remove(old)
    started = time.monotonic()
    while not is_listening(port):
        if _servers[-1].poll() is not None or time.monotonic() > started + 20:
            end(_servers.pop())
            raise OSError("Rerun's server did not start; record to a file instead")
        time.sleep(0.02)
    return viewer_address(port)


def _start(
    port: int, *arguments: str, program: str = VIEWER, stdin: int = subprocess.DEVNULL
) -> subprocess.Popen[bytes]:
    """Start Rerun's program; for this machine only."""
    return subprocess.Popen(
        [sys.executable, "-c", program, "--bind", "127.0.0.1", "--port", str(port), *arguments],
        env={**os.environ, "CI": "1"},  # the one variable by which the viewer sends no usage data
        stdin=stdin,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # an interrupt ends the run and leaves the window
    )


def end(program: subprocess.Popen[bytes]) -> None:
    """End a viewer or a server, at once."""
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
    return "ipykernel" in sys.modules and any(os.environ.get(name) for name in FRONT_ENDS)


def notebook_viewer() -> Any:
    """Rerun's module for notebooks, with its program served by this machine."""
    os.environ.setdefault("RERUN_NOTEBOOK_ASSET", "serve-local")
    with contextlib.redirect_stdout(io.StringIO()):  # it tells of every step
        import rerun_notebook  # type: ignore[import-untyped]
    return rerun_notebook


def follow(stream: rr.RecordingStream, height: int = HEIGHT) -> None:
    """Show a viewer below the cell that follows what is logged to a stream, while the cell runs.

    An OSError says that nobody looks at the notebook, or that the server does not start.
    """
    if not front_end():
        raise OSError("a viewer that follows a run needs JupyterLab; record to a file instead")
    from IPython.display import display

    address = start_server()
    stream.connect_grpc(address)
    # The page fetches the run from the server: messages through the kernel, which is busy with the
    # run, would arrive when the cell has ended.
    display(notebook_viewer().Viewer(width="auto", height=height, url=address))

"""A process that draws an overview while this one goes on: Matplotlib lets no other thread run meanwhile.

It loads Matplotlib while the frame is read and solved, which takes as long as a small frame, is sent plain
values (`endolab.plots.contents`), and sends a PNG back. It knows no files, and ends when nobody writes to
it. Of endolab it loads nothing that is compiled.
"""

from __future__ import annotations

import gc
import os
import pickle
import subprocess
import sys
from typing import TYPE_CHECKING, Self

if TYPE_CHECKING:
    from endolab.plots.contents import Page

PATIENCE = 60.0  # s that a page may take there
# With this process's own path: neither another endolab is found, nor what lies in the current folder.
CODE = "import sys; sys.path[:] = {path!r}; from endolab.reports.draughtsman import serve; serve()"


def drawn(page: Page) -> bytes:
    """Draw a page here, and return it as PNG."""
    from endolab.io.images import as_png
    from endolab.plots.maps import draw_page

    return as_png(draw_page(page))


class Draughtsman:
    """Draws one page in another process, or in this one if that fails; ended with its context."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        if "matplotlib" in sys.modules:  # drawing here takes less, then
            return
        command = [sys.executable, "-P", "-c", CODE.format(path=sys.path)]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
        try:  # in a session of its own, for Ctrl-C is this process's affair
            self._process = subprocess.Popen(command, **pipes, start_new_session=True)  # type: ignore[call-overload]
        except OSError:
            self._process = None

    def draw(self, page: Page) -> bytes:
        """Draw a page, once, and return it as PNG."""
        if self._process is not None:
            try:
                picture: bytes = self._process.communicate(pickle.dumps(page, protocol=5), PATIENCE)[0]
            except (OSError, ValueError, subprocess.TimeoutExpired):  # it has ended, or hangs
                picture = b""
            if self._process.returncode == 0 and picture:
                return picture
        return drawn(page)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()


def load() -> None:
    """Load all that drawing takes, before there is anything to draw."""
    from endolab.io import images  # noqa: F401
    from endolab.plots import maps  # noqa: F401


def serve() -> None:
    """Be the other process: read a page, draw it, write it."""
    gc.disable()  # it ends soon
    load()
    page = pickle.load(sys.stdin.buffer)
    sys.stdout.buffer.write(drawn(page))
    sys.stdout.flush()
    os._exit(0)  # who waits for the end need not wait until all is cleared away

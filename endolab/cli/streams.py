"""What the command line prints: in any encoding, complaints in one line, and no harm if nobody reads it."""

import errno
import io
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from typing import Any

LONGEST = 600  # characters of a complaint; what was typed may be as long as it likes
COMPILING = "Compiling for this machine, a minute or two"
ONCE = f"{COMPILING}; only the first run does."
EACH_TIME = f"{COMPILING}, in each run: no folder can keep it; let NUMBA_CACHE_DIR name one."
UNREAD = (errno.EPIPE, errno.EINVAL)  # a closed pipe; the second is how Windows calls it


def in_one_line(error: object) -> str:
    """Return what an error says in one printable line, without the middle of what is too long."""
    text = str(error) or "out of memory"
    if isinstance(error, OSError) and error.strerror:  # the system's own words
        where = error.filename or ("the current folder" if error.errno == errno.ENOENT else "")
        text = f"{where}: {error.strerror}" if where else error.strerror
    text = text.replace("overwrite=True", "--overwrite")  # as one says it here
    if len(text) > LONGEST:
        text = f"{text[: LONGEST // 2]} … {text[-LONGEST // 2 :]}"
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


class _Patient:
    """A stream of text that is written on when nobody reads it any more, as after ``| head -1``."""

    def __init__(self, stream: Any, needed: bool) -> None:
        self._stream, self._needed = stream, needed

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write; OSError in one sentence, if it is needed and fails otherwise than that nobody reads."""
        return self._tried(self._stream.write, text) or len(text)

    def flush(self) -> None:
        """Hand over what was written; the same."""
        self._tried(self._stream.flush)

    def _tried(self, do: Any, *arguments: str) -> Any:
        try:
            return do(*arguments)
        except OSError as error:
            # What waits in the buffer would fail again when Python ends.
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())
            os.close(nowhere)
            if error.errno in UNREAD or not self._needed:
                return None
            raise OSError(f"cannot print what was found: {error.strerror or error}") from error


@contextmanager
def patient_streams() -> Iterator[None]:
    """Let stdout and stderr take every character, and be closed by their reader, while a command runs.

    What is left in stdout is handed over at the end: OSError in one sentence, if that fails.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    out = sys.stdout and _Patient(sys.stdout, needed=True)
    complaints = sys.stderr and _Patient(sys.stderr, needed=False)
    with redirect_stdout(out), redirect_stderr(complaints):
        try:
            yield
        finally:
            if out is not None:
                out.flush()


@contextmanager
def compiling_said() -> Iterator[None]:
    """Say on stderr, once, that loops are compiled, if any are in the block."""
    from numba.core import event

    from endolab.numerics.compiled import COMPILED

    class First(event.Listener):
        said = False

        def on_start(self, event: object) -> None:
            if not self.said:
                self.said = True
                print(ONCE if COMPILED["cache"] else EACH_TIME, file=sys.stderr, flush=True)

        def on_end(self, event: object) -> None:
            pass

    with event.install_listener("numba:compile", First()):
        yield

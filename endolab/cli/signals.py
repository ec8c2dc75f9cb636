"""A command that is told to end ends as after Ctrl-C: what is done stays, what is temporary goes."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

ENDS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))


@contextmanager
def ended_like_interrupted(ended: list[int]) -> Iterator[None]:
    """Raise KeyboardInterrupt in the block at the first signal that asks for an end, and note which it was.

    Others are ignored from then on, so that nothing cuts the tidying short. Signals that somebody else
    takes care of, or ignores, as nohup does, are left alone; so are all in a thread, which gets none.
    """

    def end(number: int, _: FrameType | None) -> None:
        if not ended:
            ended.append(number)
            raise KeyboardInterrupt

    mine = []
    if threading.current_thread() is threading.main_thread():
        mine = [number for number in ENDS if signal.getsignal(number) is signal.SIG_DFL]
    for number in mine:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in mine:
            signal.signal(number, signal.SIG_DFL)

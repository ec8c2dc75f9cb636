"""A command that is told to end ends as after Ctrl-C: what is done stays, what is temporary goes."""

import _thread
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

ENDS = tuple(getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name))
AGAIN = 0.05  # s until an interrupt that Python ignored comes again


def _to_main_thread(number: int) -> None:
    if hasattr(signal, "pthread_kill"):  # which wakes it, too
        signal.pthread_kill(threading.main_thread().ident or 0, number)
    else:
        _thread.interrupt_main(signal.Signals(number))


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

    ignoring = sys.unraisablehook

    def ignored(what: Any) -> None:
        # What is raised while Python clears something away is dropped, Ctrl-C too.
        if not issubclass(what.exc_type, KeyboardInterrupt):
            ignoring(what)
            return
        number = ended.pop() if ended else signal.SIGINT
        again = threading.Timer(AGAIN, _to_main_thread, (number,))
        again.daemon = True
        again.start()

    mine = []
    if threading.current_thread() is threading.main_thread():
        mine = [number for number in ENDS if signal.getsignal(number) is signal.SIG_DFL]
        sys.unraisablehook = ignored
    for number in mine:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number in mine:
            signal.signal(number, signal.SIG_DFL)
        if sys.unraisablehook is ignored:
            sys.unraisablehook = ignoring

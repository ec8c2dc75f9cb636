"""Processes that work for another one, and end with it.

It imports little, so that a worker that has only just been started, and has all else to import, knows it too.
"""

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import resource_tracker

import psutil


def end_with(parent: int) -> None:
    """End this process as soon as the one that it works for is gone, however that ended."""

    def watch() -> None:
        while (os.getppid() == parent) if os.name == "posix" else psutil.pid_exists(parent):
            time.sleep(0.2)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def deaf_to_interrupts() -> Iterator[None]:
    """Start processes that a terminal's Ctrl-C does not reach: it goes to all, and each would print its own.

    The one that they work for hears it, and ends them.
    """
    if os.name != "posix":
        yield
        return
    resource_tracker.ensure_running()  # as it lets interrupts in again when it starts
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGINT])
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)

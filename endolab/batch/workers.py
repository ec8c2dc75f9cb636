"""Processes that work for another one, and end with it.

It imports little, so that a worker that has only just been started, and has all else to import, knows it too.
"""

import os
import threading
import time

import psutil


def end_with(parent: int) -> None:
    """End this process as soon as the one that it works for is gone, however that ended."""

    def watch() -> None:
        while (os.getppid() == parent) if os.name == "posix" else psutil.pid_exists(parent):
            time.sleep(0.2)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()

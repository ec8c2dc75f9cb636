"""Silence for what packages print of a damaged file, which is said in one sentence instead."""

import logging
import os
import threading
from contextlib import ExitStack

import cv2

# Looked at when a process opens its first video, and never again: FFmpeg then stays as silent as it says.
FFMPEG_LEVEL = "OPENCV_FFMPEG_LOGLEVEL"


class _Quiet:
    """Silence OpenCV, FFmpeg and Pillow in a ``with``, until the last thread that is in one leaves it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._inside = 0
        self._undo = ExitStack()
        self._nowhere = logging.NullHandler()

    def __enter__(self) -> None:
        with self._lock:
            if self._inside == 0:
                levels = cv2.utils.logging
                pillow = logging.getLogger("PIL")
                self._undo.callback(
                    levels.setLogLevel, levels.setLogLevel(levels.LOG_LEVEL_SILENT)
                )
                pillow.addHandler(self._nowhere)
                self._undo.callback(pillow.removeHandler, self._nowhere)
                if FFMPEG_LEVEL not in os.environ:  # else it is the user's
                    os.environ[FFMPEG_LEVEL] = "-8"
                    self._undo.callback(os.environ.pop, FFMPEG_LEVEL, None)
            self._inside += 1

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._inside -= 1
            if self._inside == 0:
                self._undo.close()


quiet = _Quiet()

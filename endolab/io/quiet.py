"""Quiet decoders: what C libraries would print beside the one sentence that is said."""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager

import cv2

_one_at_a_time = threading.RLock()  # for all threads share what is changed


@contextmanager
def quiet() -> Iterator[None]:
    """Let OpenCV, and the libraries in it, print nothing in a short block that decodes.

    libpng and libjpeg write to the process's standard error whatever OpenCV's own level is, so that it is
    led to nowhere meanwhile.
    """
    with _one_at_a_time:
        level = cv2.utils.logging.setLogLevel(0)
        try:
            kept = os.dup(2)
        except OSError:  # there is no standard error
            kept = -1
        try:
            if kept >= 0:
                nowhere = os.open(os.devnull, os.O_WRONLY)
                os.dup2(nowhere, 2)
                os.close(nowhere)
            yield
        finally:
            if kept >= 0:
                os.dup2(kept, 2)
                os.close(kept)
            cv2.utils.logging.setLogLevel(level)

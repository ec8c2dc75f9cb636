"""What a check says of an answer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import wraps
from typing import Any

import numpy as np

from endolab.numerics.arrays import FloatArray

MISSING = "Nothing here yet. Replace the dots, or the line that raises, and run the cell again."


class Wrong(Exception):
    """What is wrong with an answer, in a sentence that leads on without giving it away."""


@dataclass(frozen=True)
class Verdict:
    """What a check found.

    Attributes
    ----------
    right : bool or None
        None if there is no answer yet. The verdict itself is true only if the answer is right.
    said : str
        What is wrong, or what the answer is good for; Markdown.
    """

    right: bool | None
    said: str

    def __bool__(self) -> bool:
        return self.right is True

    def __repr__(self) -> str:
        mark = {True: "✓", False: "✗", None: "…"}[self.right]
        return f"{mark} {self.said}"

    def _repr_markdown_(self) -> str:
        return repr(self)


def verdict(look: Callable[..., str]) -> Callable[..., Verdict]:
    """Make a check of a function that looks at an answer.

    The function returns what to say of a right answer, and raises `Wrong` with what is wrong. An answer of
    dots (``...``), or one whose function still raises NotImplementedError, is none yet. Any other error
    comes from the student's own line, and is shown as it is.
    """

    @wraps(look)
    def check(*answer: Any) -> Verdict:
        if any(part is ... for part in answer):
            return Verdict(None, MISSING)
        try:
            return Verdict(True, look(*answer))
        except Wrong as wrong:
            return Verdict(False, str(wrong))
        except NotImplementedError:
            return Verdict(None, MISSING)

    return check


def alike(answer: float, wrong: dict[str, float], otherwise: str, rtol: float = 0.02) -> str:
    """What to say of an answer that is like one of those that are known to be wrong, or `otherwise`."""
    told = (told for told, value in wrong.items() if np.isclose(answer, value, rtol=rtol))
    return next(told, otherwise)


def numbers(answer: Any, count: int, asked: str) -> FloatArray:
    """An answer as that many numbers; `Wrong` with what is `asked` if there are others."""
    given = np.array(answer, dtype=float).ravel()
    if given.size != count:
        raise Wrong(f"{asked} You gave {given.size}.")
    return given

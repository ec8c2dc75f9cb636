"""What a caller gave, as a number, a count or an array, or one sentence that says what it was instead."""

import difflib
import functools
import inspect
import math
import os
from collections.abc import Callable, Iterable
from numbers import Integral, Real
from typing import Any, TypeVar

import numpy as np

from endolab.numerics.arrays import BoolArray, FloatArray, freeze


def nearest(given: object, choices: Iterable[str]) -> str:
    """The one of some names that a misspelt one is like, whatever its case; "" if there is none."""
    plain = {name.lower(): name for name in choices}
    like = difflib.get_close_matches(str(given).lower(), list(plain), 1)
    return plain[like[0]] if like else ""


def unknown_name(
    what: str, given: object, choices: Iterable[str], other: str = ""
) -> ValueError:
    """Make the error that names all there is to choose, and the nearest if one is misspelt.

    `other` is what can be given beside the choices, such as a file.
    """
    names = list(choices)
    meant = nearest(given, names)
    *most, last = [*names, other] if other else names
    hint = f"; did you mean {meant}?" if meant else ""
    return ValueError(
        f"unknown {what} {excerpt(given)}; choose {', '.join(most)} or {last}{hint}"
    )


def shorten(text: str, most: int = 80) -> str:
    """Leave out the middle of what is too long, and what cannot be printed in one line."""
    if len(text) > most:
        text = f"{text[: most // 2]} … {text[-most // 2 :]}"
    return "".join(c if c.isprintable() else " " for c in text)


def excerpt(value: object) -> str:
    """Say what was given, in few words."""
    if isinstance(value, np.ndarray):
        return f"an array of {value.dtype} of shape {value.shape}"
    return shorten(repr(value.item() if isinstance(value, np.generic) else value))


Function = TypeVar("Function", bound=Callable[..., Any])
PATH = (str, os.PathLike)


def check_kinds(**kinds: type | tuple[type, ...]) -> Callable[[Function], Function]:
    """Make a function refuse arguments of other types than these in one sentence; None is not looked at."""

    def decorate(function: Function) -> Function:
        signature = inspect.signature(function)

        @functools.wraps(function)
        def checked(*args: Any, **kwargs: Any) -> Any:
            given = signature.bind_partial(*args, **kwargs).arguments
            for name, kind in kinds.items():
                value = given.get(name)
                if value is not None and not isinstance(value, kind):
                    wanted = getattr(kind, "__name__", "a path")
                    raise ValueError(f"{name} must be {wanted}, got {excerpt(value)}")
            return function(*args, **kwargs)

        return checked  # type: ignore[return-value]

    return decorate


def number(
    name: str, value: Any, least: float = -math.inf, most: float = math.inf
) -> float:
    """Return a finite number that lies between two others, which belong to it; else ValueError."""
    if isinstance(value, bool) or not isinstance(value, Real):
        raise ValueError(f"{name} must be a number, got {excerpt(value)}")
    plain = float(value)
    if not (math.isfinite(plain) and least <= plain <= most):
        bounds = f"be finite and lie in [{least:g}, {most:g}]"
        raise ValueError(f"{name} must {bounds}, got {excerpt(value)}")
    return plain


def check_int(name: str, value: Any, least: int = 0) -> int:
    """Return a whole number that is not less than another; else ValueError."""
    if isinstance(value, bool) or not isinstance(value, Integral) or value < least:
        raise ValueError(
            f"{name} must be a whole number of at least {least}, got {excerpt(value)}"
        )
    return int(value)


def list_of(kind: str, name: str, value: Any) -> list[Any]:
    """Return what there is in a list, or in what is iterated over, at least one; else ValueError."""
    listed = [] if isinstance(value, str) or not isinstance(value, Iterable) else [*value]
    if not listed:
        raise ValueError(f"{name} must be a list of {kind}, got {excerpt(value)}")
    return listed


def real_array(name: str, value: Any) -> FloatArray:
    """Return an array of real numbers, as it is if it is one; else ValueError."""
    try:
        array = np.asarray(value)
    except ValueError:  # lists of unequal length
        array = np.array(None)
    if array.dtype.kind not in "fiub":
        raise ValueError(f"{name} must be an array of real numbers, got {excerpt(value)}")
    return array.astype(np.float64, copy=False)


def mask_array(name: str, value: Any) -> BoolArray:
    """Return an array of truth values, for which whole numbers will do, or 0.0 and 1.0; else ValueError."""
    if isinstance(value, np.ndarray) and value.dtype == bool:
        return value
    array = real_array(name, value)
    if np.asarray(value).dtype.kind == "f" and not np.all((array == 0) | (array == 1)):
        raise ValueError(f"{name} must be an array of True and False, got {excerpt(value)}")
    return array != 0


def readonly_copy(array: np.ndarray) -> np.ndarray:
    """Return an array that nobody can write into: the same one if it is so already, else a copy."""
    is_owned = array.base is None and not array.flags.writeable
    return array if is_owned else freeze(array.copy())

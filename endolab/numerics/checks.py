"""What a caller gave, as a number, a count or an array, or one sentence that says what it was instead."""

import difflib
import functools
import inspect
import json
import math
import os
from collections.abc import Callable, Iterable
from typing import Any, TypeVar

import numpy as np

from endolab.numerics.arrays import BoolArray, FloatArray, freeze

LONGEST_VALUE = 80  # characters of a value of a file in a sentence


def nearest(given: object, choices: Iterable[str]) -> str:
    """The one of some names that a misspelt one is like, whatever its case; "" if there is none."""
    plain = {name.lower(): name for name in choices}
    if len(str(given)) > LONGEST_VALUE:
        return ""
    return next(
        (plain[name] for name in difflib.get_close_matches(str(given).lower(), plain, 1)),
        "",
    )


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
        f"unknown {what} {shorten(repr(given))}; choose {', '.join(most)} or {last}{hint}"
    )


def quote(value: object) -> str:
    """Say a value of a file as JSON does, as far as a sentence bears it."""
    return shorten(json.dumps(value))


def shorten(text: str, most: int = LONGEST_VALUE) -> str:
    """Leave out the middle of what is too long, and what cannot be printed in one line."""
    if len(text) > most:
        text = f"{text[: most // 2]} … {text[-most // 2 :]}"
    return "".join(c if c.isprintable() else " " for c in text)


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
                    wanted = kind if isinstance(kind, tuple) else (kind,)
                    names = " or ".join(one.__name__ for one in wanted)
                    raise ValueError(f"{name} must be {names}, got {excerpt(value)}")
            return function(*args, **kwargs)

        return checked  # type: ignore[return-value]

    return decorate


def excerpt(value: object) -> str:
    """Say what was given, in few words."""
    if isinstance(value, np.ndarray) and value.ndim:
        return f"an array of {value.dtype} of shape {value.shape}"
    try:
        text = repr(value.item() if isinstance(value, np.ndarray | np.generic) else value)
    except (ValueError, RecursionError):  # a whole number of thousands of digits
        text = type(value).__name__
    most = 60  # characters
    return text if len(text) <= most else f"{text[:most]}…"


def number(
    name: str, value: Any, least: float = -math.inf, most: float = math.inf
) -> float:
    """Return a finite number that lies between two others, which belong to it; else ValueError."""
    # An array of a list that is ragged is an error to NumPy, and one of a long whole number an object.
    plain = (
        np.asarray(value)
        if isinstance(value, int | float | np.ndarray | np.generic)
        else np.empty(0)
    )
    if plain.ndim or plain.dtype.kind not in "iuf":
        raise ValueError(f"{name} must be a number, got {excerpt(value)}")
    plain_number = float(plain)
    if not (math.isfinite(plain_number) and least <= plain_number <= most):
        bounds = "be finite" if math.isinf(least) else f"be finite and at least {least:g}"
        bounds = bounds if math.isinf(most) else f"lie in [{least:g}, {most:g}]"
        raise ValueError(f"{name} must {bounds}, got {excerpt(value)}")
    return plain_number


def check_int(name: str, value: Any, least: int = 0) -> int:
    """Return a whole number that is not less than another; else ValueError."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < least:
        raise ValueError(
            f"{name} must be a whole number of at least {least}, got {excerpt(value)}"
        )
    return int(value)


def truth_value(name: str, value: Any) -> bool:
    """Return True or False; ValueError for anything else."""
    if not isinstance(value, bool | np.bool_):
        raise ValueError(f"{name} must be True, False or None, got {excerpt(value)}")
    return bool(value)


def real_array(name: str, value: Any) -> FloatArray:
    """Return an array of real numbers, as it is if it is one; else ValueError."""
    try:
        array = np.asarray(value)
    except ValueError as error:  # lists of unequal length
        raise ValueError(
            f"{name} must be an array of real numbers, got {excerpt(value)}"
        ) from error
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
    base: Any = array
    while isinstance(base, np.ndarray):
        if base.flags.writeable:
            return freeze(array.copy())
        base = base.base
    return array

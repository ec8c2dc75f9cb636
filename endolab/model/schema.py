"""JSON files that people write by hand, read key by key: every error names the file and the key."""

from __future__ import annotations

import math
from typing import Any

from endolab.numerics.checks import (
    LONGEST_VALUE,
    nearest,
    quote,
    shorten,
    unknown_name,
)


def _is_finite(value: Any) -> bool:
    """Whether a JSON value is a number that a float can hold."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


class Section:
    """A part of a JSON file that is read key by key; every error names the key."""

    def __init__(self, content: Any, where: str, file: str) -> None:
        self.where = where
        self.file = file
        if not isinstance(content, dict):
            raise self.error("", f"expected an object {{…}}, found {quote(content)}")
        self.content = dict(content)
        self.asked: dict[str, None] = {}  # the keys that this part may have, in order

    def error(self, key: str, what: str) -> ValueError:
        """Make the error that says what is wrong with a key; "" means this part as a whole."""
        name = shorten(".".join(part for part in (self.where, key) if part))
        return ValueError(
            f"{self.file}: {name or 'the file'}: {shorten(what, 5 * LONGEST_VALUE)}"
        )

    def take(self, key: str, default: Any = ...) -> Any:
        """Take out a value of any kind; it must be there unless a default is given."""
        self.asked[key] = None
        if key not in self.content and default is ...:
            like = nearest(key, self.content)
            raise self.error(
                key, f'missing; is "{like}" a misspelling of it?' if like else "missing"
            )
        return self.content.pop(key, default)

    def section(self, key: str) -> Section:
        """Take out an object, to be read key by key."""
        return Section(self.take(key), ".".join(filter(None, (self.where, key))), self.file)

    def number(self, key: str, default: Any = ..., low: float = -math.inf) -> float:
        """Take out a finite number of at least `low`."""
        value = self.take(key, default)
        if not _is_finite(value):
            raise self.error(key, f"expected a finite number, found {quote(value)}")
        if value < low:
            raise self.error(key, f"expected at least {low:g}, found {value:g}")
        return float(value)

    def positive(self, key: str, default: Any = ...) -> float:
        """Take out a positive number."""
        value = self.number(key, default)
        if value <= 0:
            raise self.error(key, f"expected a positive number, found {value:g}")
        return value

    def integer(self, key: str, default: Any = ..., low: int = 0) -> int:
        """Take out a whole number of at least `low`."""
        value = self.number(key, default, low)
        if value != int(value) or value > 2**53:  # a float holds no larger ones
            raise self.error(key, f"expected a whole number, found {value:g}")
        return int(value)

    def numbers(
        self, key: str, count: int | None = None, default: Any = ...
    ) -> tuple[float, ...]:
        """Take out a list of `count` finite numbers, or of any count."""
        value = self.take(key, default)
        good = isinstance(value, list | tuple) and (count is None or len(value) == count)
        if not good or not all(_is_finite(x) for x in value):
            wanted = f"{count} finite numbers" if count else "a list of finite numbers"
            raise self.error(key, f"expected {wanted}, found {quote(value)}")
        return tuple(float(x) for x in value)

    def choice(self, key: str, choices: tuple[str, ...]) -> str:
        """Take out one of a few words."""
        value = self.take(key)
        if value not in choices:
            raise self.error(key, str(unknown_name("value", value, choices)))
        return str(value)

    def end(self) -> None:
        """Complain of keys that nobody took."""
        first, *others = sorted(self.content) or [""]
        if first:
            more = f" (as {', '.join(others)})" if others else ""
            raise self.error(first, f"unknown key{more}; expected {', '.join(self.asked)}")

    def build(self, make: Any, **values: Any) -> Any:
        """Call a constructor whose own complaint names the value; say where it stands."""
        self.end()
        try:
            return make(**values)
        except ValueError as error:
            raise self.error("", str(error)) from error

"""A case: what is run in a folder of its own, and what must hold afterwards."""

import shlex
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace


@dataclass(frozen=True)
class Case:
    """One thing that is done to endolab; paths are relative to the case's folder, where it runs."""

    told: str  # a command line or a call, to be read by people
    run: Callable[[], object]  # returns an exit status, or anything where it is a call
    names: tuple[str, ...] = ()  # a refusal must have one of these words; none: any sentence will do
    new: tuple[str, ...] = ()  # what is there after exit 0, whole, and not after exit 2
    kept: tuple[str, ...] = ()  # what may be there, whole, after either: rows or frames that are done
    safe: tuple[str, ...] = ()  # what nothing may touch, wherever it is
    any: tuple[str, ...] = ()  # those of `kept` whose names do not say what is in them
    status: int | None = None  # the exit status that it must have, where that is known
    loose: bool = (
        False  # a mistake in the program: any exception will do, and only what is left behind counts
    )
    after: Callable[[], None] = lambda: None  # undoes what was set up, before the folder is looked at

    def but(self, **changes):
        """The same with something changed."""
        return replace(self, **changes)


def command(*argv, **expected):
    """A command line."""
    from endolab.cli.main import main

    words = [str(word) for word in argv]
    return Case("endolab " + shlex.join(words), lambda: main(words), **expected)


def call(told, function, **expected):
    """A call in Python, which refuses by an exception."""

    def run():
        from endolab._extras import MissingPackage

        try:
            function()
        except (ValueError, OSError, MemoryError, TypeError, MissingPackage) as error:
            print(f"endolab: {error}", file=sys.stderr)
            return 2
        return 0

    return Case(told, run, **expected)

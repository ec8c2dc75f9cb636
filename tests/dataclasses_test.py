"""Types that hold arrays are compared by identity: `==` of arrays is no truth value."""

import dataclasses
import pkgutil
import typing
from importlib import import_module

import numpy as np

import endolab


def parts_of(hint):
    """An annotation and all that it is made of."""
    yield hint
    for part in (typing.get_origin(hint), *typing.get_args(hint)):
        if part is not None:
            yield from parts_of(part)


def holds_arrays(kind):
    """Whether a dataclass has a field of arrays, or of such a dataclass."""
    hints = typing.get_type_hints(kind)
    names = [one.name for one in dataclasses.fields(kind)]
    parts = [part for name in names for part in parts_of(hints[name])]
    inside = {part for part in parts if dataclasses.is_dataclass(part)} - {kind}
    return np.ndarray in parts or any(map(holds_arrays, inside))


def test_no_type_that_holds_arrays_compares_them():
    places = {one.name for one in pkgutil.walk_packages(endolab.__path__, "endolab.")}
    modules = map(import_module, places - {"endolab.__main__"})
    things = [thing for module in modules for thing in vars(module).values()]
    types = {thing for thing in things if isinstance(thing, type)}
    holding = set(filter(holds_arrays, filter(dataclasses.is_dataclass, types)))
    assert {endolab.Frame, endolab.Result} < holding
    assert {kind for kind in holding if kind.__eq__ is not object.__eq__} == set()

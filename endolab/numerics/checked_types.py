"""Types that check themselves: frozen dataclasses whose annotations are also their ranges (pydantic).

    @checked
    class Light:
        gamma: Annotated[float, Field(gt=0, le=10, description="response exponent")] = 2.2

    Light(2.2), Light(gamma=2.2), replace(light, gamma=2)      # as with any dataclass
    Light(gamma=-1)              # ValueError: gamma must be greater than 0, got -1
    from_content(Light, {"gama": 2}, "light.json")
                                 # ValueError: light.json: gama is unknown; did you mean gamma?

Truth values and text are no numbers; NumPy's numbers, arrays and lists are taken for numbers and tuples.
"""

import dataclasses
import functools
import json
import re
from collections.abc import Sequence
from typing import Annotated, Any, TypeVar, Union, dataclass_transform

import numpy as np
from pydantic import BeforeValidator, ConfigDict, Field, TypeAdapter, ValidationError
from pydantic.dataclasses import dataclass

from endolab.numerics.checks import excerpt, nearest, unknown_name

Kind = TypeVar("Kind")
_RULES = ConfigDict(
    extra="forbid",
    allow_inf_nan=False,
    strict=True,
    arbitrary_types_allowed=True,
    validate_by_name=True,
)


def as_plain(value: Any) -> Any:
    """Make Python's own numbers and tuples of NumPy's, and of lists; leave all else, and pictures, alone."""
    if isinstance(value, np.generic) or (
        isinstance(value, np.ndarray) and value.squeeze().ndim < 2
    ):
        value = np.squeeze(value).tolist()
    return tuple(map(as_plain, value)) if isinstance(value, list | tuple) else value


def _as_whole(value: Any) -> Any:
    return int(value) if isinstance(value, float) and value.is_integer() else value


# A whole number, which JSON may write as 320.0.
Whole = Annotated[int, BeforeValidator(_as_whole)]


@dataclass_transform(frozen_default=True, field_specifiers=(dataclasses.field, Field))
def checked(cls: type[Kind]) -> type[Kind]:
    """Make a frozen dataclass that checks its values; ValueError, in one sentence, for what is wrong."""
    made: Any = dataclass(frozen=True, config=_RULES)(cls)
    names = [part.name for part in dataclasses.fields(made) if not part.kw_only]
    validate = made.__init__

    @functools.wraps(validate)
    def construct(self: Any, *args: Any, **kwargs: Any) -> None:
        try:
            validate(
                self,
                *map(as_plain, args),
                **{name: as_plain(value) for name, value in kwargs.items()},
            )
        except ValidationError as error:
            given = dict(zip(names, args, strict=False)) | kwargs
            raise ValueError(_sentence(error, made, given, names)) from None

    made.__init__ = construct
    return made


class OneOf:
    """In ``Annotated[Base, OneOf(A, B)]``: one of these types, told apart by one of their keys."""

    def __init__(self, *kinds: type, key: str = "model") -> None:
        self.kinds = kinds
        self.key = key

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        union: Any = Union.__getitem__(self.kinds)
        return handler.generate_schema(Annotated[union, Field(discriminator=self.key)])


def from_content(kind: Any, content: Any, name: str) -> Any:
    """Make a value of a checked type of parsed JSON; ValueError names the file (or `name`) and the key."""
    # Half of a pair of surrogates, which JSON may escape, is no text.
    text = json.dumps(content, ensure_ascii=False).encode(errors="replace")
    try:
        return TypeAdapter(kind).validate_json(text)
    except ValidationError as error:
        raise ValueError(f"{name}: {_sentence(error, kind, content)}") from None


def to_content(value: Any) -> dict[str, Any]:
    """Return a value of a checked type as JSON holds it."""
    content: dict[str, Any] = TypeAdapter(type(value)).dump_python(value, by_alias=True)
    return content


# Sentences ------------------------------------------------------------------------------
def _sentence(
    error: ValidationError, kind: Any, content: Any, names: Sequence[str] = ()
) -> str:
    """Say what is wrong: an unknown key, else what lies deepest; `names` are of arguments in their order."""
    complaints = []
    for fault in error.errors():
        path = ""
        inside = content
        missing = fault["loc"][-1] if fault["type"] == "missing" else None
        for step in fault["loc"]:
            if inside is content and isinstance(step, int) and step < len(names):
                step = names[step]
            if isinstance(inside, list | tuple) and isinstance(step, int):
                path += f"[{step}]"
                inside = inside[step] if step < len(inside) else None
            elif isinstance(inside, dict) and (step in inside or step == missing):
                path += f".{step}"
                inside = inside.get(step)
            # Else it is the name of one of several types.
        text = _complaint(fault, kind)
        depth = len(re.findall(r"[.[]", path)) + 99 * text.startswith(" is unknown")
        complaints.append((depth, path + text))
    return max(complaints, key=lambda one: one[0])[1].lstrip(" .:")


def _keys_in(hint: Any) -> list[str]:
    """List the keys of all checked types that an annotation names."""
    inside = hint.kinds if isinstance(hint, OneOf) else getattr(hint, "__args__", ())
    inside = [*inside, *getattr(hint, "__metadata__", ())]
    keys = []
    for name, part in getattr(hint, "__pydantic_fields__", {}).items():
        keys.append(part.alias or name)
        inside += [part.annotation, *part.metadata]
    return [*keys, *(key for one in inside for key in _keys_in(one))]


def _complaint(fault: Any, kind: Any) -> str:
    """Say what is wrong with a value, to stand behind its path."""
    facts = fault.get("ctx", {})
    words = re.findall(r"'([^']*)'", facts.get("expected_tags", facts.get("expected", "")))
    if fault["type"] == "value_error":
        return f": {facts['error']}".replace(": must", " must")
    if fault["type"] == "missing":
        return " is missing"
    if fault["type"] == "unexpected_keyword_argument":
        key = fault["loc"][-1]
        meant = nearest(key, _keys_in(kind))
        is_misspelt = meant not in ("", key)
        return " is unknown" + (f"; did you mean {meant}?" if is_misspelt else "")
    if words:
        what = (facts.get("discriminator") or str(fault["loc"][-1])).strip("'")
        return f": {unknown_name(what, facts.get('tag', fault['input']), words)}"
    text = re.sub(r"^: \w+ should", " must", f": {fault['msg']}")
    if "equal to" in text:
        text = f" must be at {'least' if 'ge' in facts else 'most'} {min(facts.values()):g}"
    return f"{text}, got {excerpt(fault['input'])}"

"""Every option of a reconstruction, once: its name, type, default, range and one line of help.

The keywords of `reconstruct`, `settings.json`, the command line, the tuner's controls and what a report
lists are derived from these fields. A new option is one more field, and the code that uses it.

Importing this loads nothing: the command line's help is made of it.
"""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Callable, Mapping
from dataclasses import Field, dataclass, field, fields
from typing import TYPE_CHECKING, Any, Self, TypeVar

if TYPE_CHECKING:
    from endolab.numerics.arrays import BoolArray

AUTO = "auto"  # what the frame's evidence allows
SEPARATED = "separated"  # the channel that is made of all three, indirect light removed
# One of which may fix the scale.
LENGTHS = (
    "median_distance",
    "known_distance",
    "known_diameter",
)

WORD = "word"  # one of some choices
NUMBER = "number"
COUNT = "count"  # a whole number
SWITCH = "switch"  # yes, no, or None: automatic
DISTANCE = "distance"  # (mm, column, row)
DIAMETER = "diameter"  # (mm, (column, row), (column, row))
MAP = "map"  # an array, which no file and no command line can hold


@dataclass(frozen=True)
class Option:
    """What is known of an option beside its name, type and default."""

    help: str  # one line, for the command line too
    kind: str
    more: str = ""  # what else a programmer wants to know
    choices: tuple[str, ...] = ()
    least: int = 0  # of a count
    form: str = ""  # how the command line writes its value
    group: str = ""  # under which the command line lists it


def option(default: Any, help: str, kind: str, **more: Any) -> Any:
    """Make a field of `Settings`."""
    return field(default=default, metadata={"option": Option(help, kind, **more)})


SURFACE = "surface"
FRAME_AND_LIGHT = "frame and light"
SCALE = "scale, where the gain is unknown"


@dataclass(frozen=True)
class Settings:
    """How a frame is solved; `endolab.reconstruct` says what each option means."""

    width: int | None = option(
        None,
        "shrink the frame to this width first",
        COUNT,
        least=1,
        form="PX",
    )
    lam: float = option(
        1.0,
        "weight of the regulariser; larger is smoother (default 1)",
        NUMBER,
        form="λ",
    )
    channel: str | None = option(
        None,
        "auto (default): all three colours, indirect light removed, if the frame allows it; separated: "
        "always; red, green, blue or grey: this channel as it is (green with the paper's solvers)",
        WORD,
        choices=(AUTO, SEPARATED, "red", "green", "blue", "grey"),
        form="NAME",
        more="`separated` finds how much of each colour's light came by way of other walls, removes it, and "
        "merges the three. It uses the calibration's albedos if there are three, and estimates them "
        "otherwise. `auto` does that with a colour picture and takes a grey one as it is; the notes say "
        "what was done and why",
    )
    regulariser: str = option(
        AUTO,
        "first or second order; auto (default) is second",
        WORD,
        choices=(AUTO, "first", "second"),
        form="ORDER",
        group=SURFACE,
        more="Total variation of ξ or of its gradient",
    )
    contours: bool | None = option(
        None,
        "whether folds may hide what is behind them; auto (default): if that explains the picture better",
        SWITCH,
        group=SURFACE,
        more="None is automatic: `auto` and `separated` cut the surface where colours or energy speak for "
        "it, and single channels do not",
    )
    xi: str = option(
        "1/d",
        "the map that is made smooth: 1/z, d or 1/d (default)",
        WORD,
        choices=("1/z", "d", "1/d"),
        form="ξ",
        group=SURFACE,
    )
    solver: str = option(
        "gauss_newton",
        "facing, fast_marching, gauss_newton (default) or primal_dual",
        WORD,
        choices=("facing", "fast_marching", "gauss_newton", "primal_dual"),
        form="NAME",
        group=SURFACE,
        more="`gauss_newton` minimises the energy, `primal_dual` does so along the paper's path. "
        "`fast_marching` is one pass to the viscosity solution, `facing` the paper's start d₀: they do not "
        "use the regulariser, which counts in the energy that is reported",
    )
    max_iterations: int | None = option(
        None,
        "steps of the solver at most",
        COUNT,
        form="N",
        group=SURFACE,
    )
    epsilon: float = option(
        1e-3,
        "derivative of ξ above which the penalty grows linearly (default 1e-3)",
        NUMBER,
        form="ε",
        group=SURFACE,
    )
    threshold: float = option(
        0.05,
        "error of a stored value above which the penalty grows linearly (default 0.05)",
        NUMBER,
        form="ρ",
        group=SURFACE,
    )
    highlights: str | None = option(
        None,
        "mirrored light (default: ignore with auto and separated, else keep)",
        WORD,
        choices=("keep", "ignore", "inpaint"),
        group=FRAME_AND_LIGHT,
        more="It is kept as it is, ignored as evidence, or the picture is filled in from around it",
    )
    smooth: float | None = option(
        None,
        "blur the light first (default: by the noise)",
        NUMBER,
        form="PX",
        group=FRAME_AND_LIGHT,
        more="Standard deviation of a Gaussian, px; by default 2 √n, n being the noise in grey levels",
    )
    median_distance: float | None = option(
        None,
        "median of the result's distances",
        NUMBER,
        form="MM",
        group=SCALE,
        more="Fix the scale so that the median distance is this, mm",
    )
    known_distance: tuple[float, float, float] | None = option(
        None,
        "distance of the surface at a pixel",
        DISTANCE,
        form="MM,COLUMN,ROW",
        group=SCALE,
        more="Fix it so that the surface at this pixel of the picture is so far away: (mm, column, row)",
    )
    known_diameter: tuple[float, tuple[float, float], tuple[float, float]] | None = option(
        None,
        "between the surface at two pixels: a polyp, the lumen",
        DIAMETER,
        form="MM,COLUMN1,ROW1,COLUMN2,ROW2",
        group=SCALE,
        more="Fix it so that two surface points are so far apart: (mm, (column, row), (column, row))",
    )
    cuts: BoolArray | None = option(
        None,
        "steps between pixels that are cut, where they are known: see `Problem`",
        MAP,
    )
    # The solver's own, such as `inflow`.
    solver_options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        from endolab.reconstruction.scale import check_scale
        from endolab.solvers.solvers import check_solver_options

        for part in option_fields():
            value = getattr(self, part.name)
            if value is not None or part.default is not None:
                object.__setattr__(self, part.name, _check(part, value))
        check_scale(**self.lengths)
        check_solver_options(self.solver, self.solver_options)

    @classmethod
    def of(cls, options: Mapping[str, Any]) -> Self:
        """Take keywords of `reconstruct`; those that are no options of it are the solver's own."""
        names = {part.name for part in option_fields()}
        own = {name: options[name] for name in names.intersection(options)}
        others = {name: value for name, value in options.items() if name not in names}
        return cls(**own, solver_options=others)

    @property
    def uses_colours(self) -> bool:
        """Whether indirect light is looked for, if the picture has colours."""
        return self.used_channel in (AUTO, SEPARATED)

    @property
    def used_channel(self) -> str | None:
        """The channel, or None for green: the paper's solvers take the paper's."""
        if self.channel is None and self.solver == Settings.solver:
            return AUTO
        return self.channel

    @property
    def searches_contours(self) -> bool:
        """Whether contours may be looked for."""
        if self.cuts is not None:  # they are known
            return False
        return self.uses_colours if self.contours is None else bool(self.contours)

    @property
    def used_regulariser(self) -> str:
        """The regulariser."""
        return "second" if self.regulariser == AUTO else self.regulariser

    @property
    def lengths(self) -> dict[str, Any]:
        """What may fix the scale."""
        return {name: getattr(self, name) for name in LENGTHS}

    def as_dict(self) -> dict[str, Any]:
        """All options but arrays, by name."""
        return {
            part.name: getattr(self, part.name)
            for part in option_fields()
            if part.metadata["option"].kind != MAP
        }


def option_fields() -> list[Field[Any]]:
    """Return the fields of `Settings` that are options, in order."""
    return [part for part in fields(Settings) if "option" in part.metadata]


def option_of(name: str) -> Option:
    """Return what is known of an option."""
    facts: Option = Settings.__dataclass_fields__[name].metadata["option"]
    return facts


def _check(part: Field[Any], value: Any) -> Any:
    """Return the value of an option as it is used; ValueError, in one sentence, if it cannot be."""
    from endolab.model.ranges import check_range
    from endolab.model.schema import unknown_name
    from endolab.numerics.checks import check_int, number, truth_value

    facts: Option = part.metadata["option"]
    if part.name == "regulariser" and value == "curvature":
        raise ValueError("regulariser 'curvature' is gone: write 'second'")
    if facts.kind == WORD and (not isinstance(value, str) or value not in facts.choices):
        raise unknown_name(part.name, value, facts.choices)
    if facts.kind == SWITCH:
        return truth_value(part.name, value)
    if facts.kind == COUNT:
        return check_int(part.name, value, facts.least)
    if facts.kind == NUMBER and part.name not in LENGTHS:
        value = number(part.name, value)
        check_range(part.name, value)
    return value


# The keywords of functions that take settings -------------------------------------------

Function = TypeVar("Function", bound=Callable[..., Any])
ANCHOR = "    **options\n"  # of a docstring, before which the options are listed


def takes_settings(function: Function) -> Function:
    """Show the options of `Settings` in the signature and the docstring of a function with ``**options``."""
    signature = inspect.signature(function)
    *own, others = signature.parameters.values()
    keywords = [
        inspect.Parameter(
            part.name, others.KEYWORD_ONLY, default=part.default, annotation=part.type
        )
        for part in option_fields()
    ]
    function.__signature__ = signature.replace(parameters=[*own, *keywords, others])  # type: ignore[attr-defined]
    if function.__doc__ and ANCHOR in function.__doc__:
        function.__doc__ = function.__doc__.replace(ANCHOR, _describe_options() + ANCHOR)
    return function


def _describe_options() -> str:
    """Return what a docstring says of all options."""
    lines = []
    for part in option_fields():
        facts: Option = part.metadata["option"]
        kind = f"{{{', '.join(facts.choices)}}}" if facts.choices else str(part.type)
        text = f"{facts.help[0].upper()}{facts.help[1:]}."
        if facts.more:
            text += f" {facts.more}."
        lines.append(f"    {part.name} : {kind}, by default {part.default!r}")
        lines += textwrap.wrap(text, 100, initial_indent=" " * 8, subsequent_indent=" " * 8)
    return "\n".join(lines) + "\n"

"""Every option of a reconstruction, once: its name, type, range, default and what it means.

The keywords of `reconstruct`, `settings.json`, the command line, the tuner's controls and what a report
lists are derived from these fields. A new option is one more field, and the code that uses it.

Importing this loads no numerics: the command line's help is made of it.
"""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import field, fields
from typing import Annotated, Any, Literal, Self, TypeVar, get_type_hints

from pydantic import Field

from endolab.numerics.checked_types import Whole, checked

AUTO = "auto"  # what the frame's evidence allows
SEPARATED = "separated"  # the channel that is made of all three, indirect light removed
# One of which may fix the scale.
LENGTHS = ("median_distance", "known_distance", "known_diameter")

Length = Annotated[float, Field(ge=1e-3, le=1e6)]  # mm
Pixel = tuple[float, float]  # column, row


@checked
class Settings:
    """How a frame is solved.

    Parameters
    ----------
    width : int, optional
        Shrink the frame to this width first, px; by default, and if narrower, it stays as it is.
    lam : float
        Weight of the regulariser; larger is smoother.
    channel : {"auto", "separated", "red", "green", "blue", "grey"}, optional
        Which colours are solved. `auto` (default): all three, indirect light removed, if the frame allows
        it; `separated`: always; else this channel as it is (green by default with the paper's solvers).
    regulariser : {"auto", "first", "second"}
        Total variation of ξ, or of its gradient; `auto` is second.
    contours : bool, optional
        Whether folds may hide what is behind them, where the surface is cut; by default if colours or
        energy speak for it, and not in a single channel.
    xi : {"1/z", "d", "1/d"}
        The map that is made smooth.
    solver : {"facing", "fast_marching", "gauss_newton", "primal_dual"}
        `gauss_newton` minimises the energy, `primal_dual` does so along the paper's path; `fast_marching` is
        one pass to the viscosity solution, `facing` the paper's start d₀, both without the regulariser.
    max_iterations : int, optional
        Steps of the solver at most; by default its own.
    epsilon : float
        Derivative of ξ above which the penalty grows linearly.
    threshold : float
        Error of a stored value above which the penalty grows linearly.
    highlights : {"keep", "ignore", "inpaint"}, optional
        Mirrored light: kept as it is, ignored as evidence, or filled in from around it. By default ignored
        with `auto` and `separated`, else kept.
    smooth : float, optional
        Blur the light first, by a Gaussian of this standard deviation, px; by default 2 √n, n being the
        noise in grey levels.
    median_distance : float, optional
        Fix the scale so that the median of the distances is this, mm, such as 40.
    known_distance : (float, float, float), optional
        Fix the scale so that the surface at a pixel is so far away: mm, column, row, such as 30,160,120.
    known_diameter : (float, (float, float), (float, float)), optional
        Fix the scale so that the surface at two pixels is so far apart: mm, column and row of one, of the
        other; on the command line 5,100,80,140,80.
    cuts : array of bool, optional
        Links between pixels that are cut, where they are known: see `Problem`.
    solver_options : mapping
        The solver's own, such as `inflow`.
    """

    width: Annotated[Whole, Field(ge=1)] | None = None
    lam: Annotated[float, Field(ge=0, le=1e12)] = 1.0
    channel: Literal["auto", "separated", "red", "green", "blue", "grey"] | None = None
    regulariser: Literal["auto", "first", "second"] = "auto"
    contours: bool | None = None
    xi: Literal["1/z", "d", "1/d"] = "1/d"
    solver: Literal["facing", "fast_marching", "gauss_newton", "primal_dual"] = (
        "gauss_newton"
    )
    max_iterations: Annotated[Whole, Field(ge=1)] | None = None
    epsilon: Annotated[float, Field(ge=1e-12, le=1e6)] = 1e-3
    threshold: Annotated[float, Field(ge=1e-9, le=1e6)] = 0.05
    highlights: Literal["keep", "ignore", "inpaint"] | None = None
    smooth: Annotated[float, Field(ge=0, le=1e6)] | None = None
    median_distance: Length | None = None
    known_distance: tuple[Length, float, float] | None = None
    known_diameter: tuple[Length, Pixel, Pixel] | None = None
    cuts: Any = None
    solver_options: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        from endolab.solvers.solvers import check_solver_options

        given = [name for name, length in self.lengths.items() if length is not None]
        if len(given) > 1:
            raise ValueError(f"{' and '.join(given)} exclude each other; give one")
        check_solver_options(self.solver, self.solver_options)

    @classmethod
    def of(cls, options: Mapping[str, Any]) -> Self:
        """Take keywords of `reconstruct`; those that are no options of it are the solver's own."""
        names = {part.name for part in fields(cls)} - {"solver_options"}
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
        return self.uses_colours if self.contours is None else self.contours

    @property
    def used_regulariser(self) -> str:
        """The regulariser."""
        return "second" if self.regulariser == AUTO else self.regulariser

    @property
    def used_highlights(self) -> str:
        """What is done with highlights."""
        return self.highlights or ("ignore" if self.uses_colours else "keep")

    @property
    def search(self) -> dict[str, Any]:
        """What decides, at a width, which light and contours are found."""
        return {
            "channel": self.used_channel,
            "contours": self.contours,
            "highlights": self.used_highlights,
            "smooth": self.smooth,
        }

    @property
    def energy(self) -> dict[str, Any]:
        """What says which energy is minimised."""
        return {
            "xi": self.xi,
            "regulariser": self.used_regulariser,
            "lam": self.lam,
            "epsilon": self.epsilon,
            "threshold": self.threshold,
        }

    @property
    def lengths(self) -> dict[str, Any]:
        """What may fix the scale."""
        return {name: getattr(self, name) for name in LENGTHS}

    def as_dict(self) -> dict[str, Any]:
        """All that a file can hold, by name."""
        return {name: getattr(self, name) for name in option_types()}


def option_types() -> dict[str, Any]:
    """The types of the options that a file can hold, by name, in order: all but these two."""
    types = get_type_hints(Settings)
    del types["cuts"], types["solver_options"]
    return types


Function = TypeVar("Function", bound=Callable[..., Any])


def takes_settings(function: Function, types: Mapping[str, Any] | None = None) -> Function:
    """Show the fields of `Settings` in signature and docstring of a function with ``**options``.

    `types` are those of the fields that it takes, if these are all that it takes.
    """
    signature = inspect.signature(function)
    *own, others = signature.parameters.values()
    shown = types or option_types() | {"cuts": Any}
    keywords = [
        others.replace(
            name=name,
            kind=others.KEYWORD_ONLY,
            default=getattr(Settings, name),
            annotation=kind,
        )
        for name, kind in shown.items()
    ]
    last = [] if types else [others]
    function.__signature__ = signature.replace(  # type: ignore[attr-defined]
        parameters=[*own, *keywords, *last]
    )
    listed = str(inspect.getdoc(Settings)).partition("----------\n")[2]
    listed = listed.partition("solver_options :")[0]
    own_words = str(inspect.getdoc(function))
    function.__doc__ = own_words.replace("**options", f"{listed}**options", 1)
    return function

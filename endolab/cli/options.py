"""How the command line says how to solve: the options, in one place, and the keywords they stand for."""

import argparse
from collections.abc import Callable
from dataclasses import replace
from typing import Any

CHANNELS = ("red", "green", "blue", "grey", "separated")
CONTOURS = {"auto": None, "yes": True, "no": False}
KNOWN = {"distance": "MM,COLUMN,ROW", "diameter": "MM,COLUMN1,ROW1,COLUMN2,ROW2"}


def _of_a_wall(calibration: Any, albedo: str | None) -> Any:
    """Replace the BRDF by that of a matt wall, as one must after calibrating on a sheet of paper."""
    from endolab.model.brdf import Lambertian

    if albedo is None:
        evidence = calibration.evidence.get("photometry")
        if isinstance(evidence, dict) and evidence.get("brdf_of"):
            print("The BRDF is that of the calibration sheet; --albedo 0.5 takes a matt wall instead.")
        return calibration
    try:
        values = tuple(float(part) for part in albedo.split(","))
        brdf = Lambertian(values[0] if len(values) == 1 else values)  # type: ignore[arg-type]
    except ValueError as error:
        raise ValueError(f"--albedo must be one number in (0, 1] or three (R,G,B), got {albedo}") from error
    return replace(calibration, photometry=replace(calibration.photometry, brdf=brdf))


def calibration_of(arguments: argparse.Namespace) -> Any:
    """Return the calibration that the options name, with the wall that they say."""
    from endolab.datasets.known_endoscopes import load_calibration

    return _of_a_wall(load_calibration(arguments.calibration), arguments.albedo)


def add_solving_options(parser: argparse.ArgumentParser, several: bool = False) -> None:
    """Add what `solving_keywords` and `calibration_of` read; `several`: λ, ξ and order may be lists."""
    add = parser.add_argument
    more = "; several as 1,2,3" if several else ""
    add("--calibration", required=True, metavar="CAL", help="endoscope.json, or a known endoscope's name")
    add("--solver", help="facing, fast_marching, gauss_newton (default) or primal_dual")
    add("--xi", default="1/d", help=f"what the regulariser sees: 1/z, d or 1/d (default){more}")
    add("--regulariser", default="second", help=f"first or second (default){more}")
    weight = f"its weight; larger is smoother (default 1){more}"
    add("--lam", type=str if several else float, default=1.0, metavar="λ", help=weight)
    channels = "red, green (default), blue or grey; separated: all three, light that bounced taken out"
    add("--channel", help=channels)
    add("--albedo", metavar="A", help="of a matt wall, or R,G,B, in place of the calibration's BRDF")
    folds = "whether folds may hide what is behind them"
    add("--contours", choices=tuple(CONTOURS), default="auto", help=folds)
    add("--highlights", choices=("keep", "ignore", "inpaint"), help="what to do with mirrored light")
    add("--median-distance", type=float, metavar="MM", help="fix the scale of the result")
    if not several:
        add("--known-distance", metavar=KNOWN["distance"], help="fix it by the distance at a pixel")
        length = "fix it by the length between the surface at two pixels: a polyp, the lumen"
        add("--known-diameter", metavar=KNOWN["diameter"], help=length)
    add("--width", type=int, metavar="PX", help="shrink the frame to this width first")
    add("--smooth", type=float, metavar="PX", help="blur the light first (default: by the noise)")


def solving_keywords(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the keywords of `endolab.reconstruct` that the options stand for."""
    from endolab.depth.solvers import DEFAULT_SOLVER

    names = ("xi", "regulariser", "lam", "channel", "width", "smooth", "median_distance")
    keywords = {name: getattr(arguments, name) for name in names}
    if arguments.channel not in (None, *CHANNELS):
        choice = f"{', '.join(CHANNELS[:-1])} or {CHANNELS[-1]}"
        raise ValueError(f"unknown channel {arguments.channel!r}; choose {choice}")
    solver = DEFAULT_SOLVER if arguments.solver is None else arguments.solver
    chosen = {"contours": CONTOURS[arguments.contours], "highlights": arguments.highlights}
    return {"solver": solver} | keywords | {key: value for key, value in chosen.items() if value is not None}


def known_length(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the one length that the options know, as `known_distance` or `known_diameter`.

    ValueError in one sentence, if it is none, or if more than one option fixes the scale.
    """
    from endolab.reconstruction.scale import check_scale

    options = {"median-distance": arguments.median_distance}
    options |= {"known-distance": arguments.known_distance, "known-diameter": arguments.known_diameter}
    given = [f"--{name}" for name, value in options.items() if value is not None]
    if len(given) > 1:
        raise ValueError(f"{' and '.join(given)} exclude each other; give one")
    known: dict[str, Any] = {}
    for name, form in KNOWN.items():
        text = options[f"known-{name}"]
        if text is None:
            continue
        try:
            numbers = tuple(float(part) for part in text.split(","))
        except ValueError:
            numbers = ()
        if len(numbers) != form.count(",") + 1:
            example = f"30{',80' * form.count(',')}"
            raise ValueError(f"--known-{name} must be {form}, such as {example}, got {text}")
        length = numbers if name == "distance" else (numbers[0], numbers[1:3], numbers[3:5])
        known[f"known_{name}"] = length
    check_scale(**known)
    return known


def listed(text: object, name: str, kind: Callable[[str], Any]) -> list[Any]:
    """Read several values, ``0.1,1,10``."""
    try:
        return [kind(part.strip()) for part in str(text).split(",")]
    except ValueError as error:
        raise ValueError(f"--{name} must be numbers such as 0.1,1,10, got {text}") from error

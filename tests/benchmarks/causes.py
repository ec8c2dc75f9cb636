"""Where the error is: the default, and then one truth after the other in place of what it finds.

    python -m tests.benchmarks.causes [SET]...

prints a table in Markdown and draws it to notebooks/images/causes.png. The last two are solved on the
picture that the model itself makes of the true surface: nothing is then wrong but the values with which the
surface enters at the picture's border and behind folds, and after these, what the regulariser smooths.
True indirect light is that of the path tracer's layers; published frames have none, and there it is the light
that the three colours tell of the true surface. No test: it takes minutes.
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import endolab as el
from endolab.metrics.depth_errors import depth_cuts
from endolab.numerics.compiled import pad_maps
from endolab.reconstruction.colours import prior_of
from endolab.reconstruction.lamps import Lamps, divide_by_lamps
from endolab.reconstruction.light_and_contours import estimate_indirect, merge
from endolab.reconstruction.problem_of_frame import problem_of_frame
from endolab.reconstruction.settings import Settings
from endolab.solvers.energy import model_image
from endolab.solvers.gauss_newton import gauss_newton
from endolab.solvers.grid import Grid
from tests.benchmarks.frames import cases_of, table

PICTURE = Path(__file__).resolve().parents[2] / "notebooks" / "images" / "causes.png"
SETS = {
    "c3vd_shapes": "phantom's shapes",
    "rendered": "colons, bag, polyps",
    "traced": "path-traced colons",
    "open": "random cavities",
    "c3vd": "C3VD",
    "simcol3d_nominal": "SimCol3D",
}
STAGES = (
    "the default",
    "contours true",
    "indirect light\ntrue, too",
    "no texture or noise,\nlight as modelled",
    "border true, too",
)
COLOURS = ("#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377")


def errors_of(case):
    """Mean errors, %, of the default, and with ever more truths."""

    def error(problem, inflow=None):
        *_, last = gauss_newton(problem, inflow=inflow, settled=1e-2)
        return case.errors_of(last).mean_percent

    cuts = depth_cuts(case.distance)
    lit = with_true_light(case, cuts)
    v = np.log(case.distance)
    v = v + np.median((lit.log_d0 - v)[lit.mask]) * (case.align == "scale")
    v = np.where(lit.mask, v, 0.0)
    image = np.where(lit.mask, model_image(lit, v), 0.0)
    perfect = replace(lit, image=image, evidence=None)
    enters = Grid.of(perfect).inflow_pixels(pad_maps(v))
    return [
        case.percent(),
        case.percent(cuts=cuts),
        error(lit),
        error(perfect),
        error(perfect, np.where(enters, v, np.nan)),
    ]


def with_true_light(case, cuts):
    """The picture without its indirect light, cut at the true contours, where the truth is known."""
    settings = Settings(cuts=cuts if cuts.any() else None)
    colours = problem_of_frame(case.frame, case.calibration, settings).colours
    surface = el.Iterate(colours[1], 0, np.log(case.distance), {})
    lamps = Lamps.of(case.calibration, settings)
    if lamps is not None:
        known = surface.mask & np.isfinite(case.distance)
        seen = replace(surface, problem=replace(surface.problem, mask=known))
        lamp_ratio = lamps.ratio(seen)
        colours = [divide_by_lamps(colour, lamp_ratio) for colour in colours]
    ratio, light = estimate_indirect(colours, surface, prior_of(case.calibration))
    if case.indirect_ratio is not None:
        ratio = case.indirect_ratio
    merged = merge(colours, ratio, light.albedo)
    return replace(merged, mask=merged.mask & np.isfinite(case.distance)).in_units()


def draw(errors):
    """Draw the errors of every set with ever more truths."""
    figure = Figure(figsize=(8, 4), layout="constrained")
    axes = figure.add_subplot()
    for (name, means), colour in zip(errors.items(), COLOURS, strict=False):
        axes.plot(STAGES, means, "o-", color=colour, label=SETS[name])
    axes.set_ylim(0)
    axes.set_ylabel("mean error of the distance [%]")
    axes.grid(axis="y", alpha=0.3)
    axes.legend(frameon=False)
    figure.savefig(PICTURE, dpi=100)


if __name__ == "__main__":
    means = {}
    for name in sys.argv[1:] or SETS:
        errors = [errors_of(case) for case in cases_of(name)]
        if errors:
            means[name] = np.mean(errors, axis=0)
    heads = ["frames", *(stage.replace("\n", " ") for stage in STAGES)]
    rows = [[SETS[name], *(f"{one:.1f}" for one in row)] for name, row in means.items()]
    table("Mean error, %, with ever more truths", heads, rows)
    draw(means)

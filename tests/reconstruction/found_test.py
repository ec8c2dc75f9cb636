"""What was found of a picture: `reconstruct` is find, solve and to scale, and each can be done again."""

from dataclasses import replace

import numpy as np
import pytest

import endolab as el
from endolab.io.found import save_found
from endolab.numerics.iteration import finish
from endolab.reconstruction.pipeline import find, solve, solve_found
from endolab.reconstruction.report import meaning, summary
from endolab.reconstruction.scale import scale_of, to_scale
from endolab.reconstruction.settings import Settings
from endolab.solvers.result import run

SAMPLE = el.load_traced("matt")
FRAME = SAMPLE.frame.resize(160, 120, 2.2)
KNOWN = SAMPLE.calibration.resize(160, 120)
UNKNOWN = replace(KNOWN, photometry=replace(KNOWN.photometry, gain=None))
GREY = el.Frame(FRAME.image[..., 1], FRAME.mask, "grey")


def found_in(calibration, frame=FRAME, **options):
    return finish(find(frame, calibration, Settings.of({"width": 80} | options)))


def same(one, other):
    np.testing.assert_array_equal(one.distance, other.distance)
    assert one.energy == other.energy
    assert replace(one.report, asked={}) == replace(other.report, asked={})
    assert one.metric == other.metric


@pytest.mark.parametrize(
    ("frame", "calibration", "options"),
    [
        (FRAME, KNOWN, {}),
        (FRAME, UNKNOWN, {"known_diameter": (9, (30, 60), (120, 60)), "lam": 0.3}),
        (FRAME, KNOWN, {"channel": "green", "contours": True, "median_distance": 40}),
        (FRAME, KNOWN, {"solver": "primal_dual", "max_iterations": 9, "xi": "d"}),
        (FRAME, UNKNOWN, {"solver": "fast_marching", "snapshots": 3}),
        (GREY, KNOWN, {"known_distance": (30, 80, 60), "regulariser": "first"}),
    ],
)
def test_reconstruct_is_what_is_found_solved_and_scaled(
    frame, calibration, options, tmp_path
):
    settings = Settings.of({"width": 80} | options)
    found = finish(find(frame, calibration, settings))
    steps = solve(found, settings, calibration)
    whole = el.reconstruct(frame, calibration, width=80, **options)
    same(run(steps, last=lambda answer: to_scale(answer, settings)), whole)
    save_found(found, tmp_path / "found.npz")
    same(
        el.solve_found(el.load_found(tmp_path / "found.npz"), calibration, **options),
        whole,
    )


@pytest.mark.parametrize("options", [{}, {"channel": "green"}])
def test_a_gain_that_becomes_known_makes_mm(options):
    later = solve_found(found_in(UNKNOWN, **options), KNOWN)
    first = el.reconstruct(FRAME, KNOWN, width=80, **options)
    assert later.metric
    assert scale_of(later) == "gain"
    assert meaning(later)[0] == meaning(first)[0]
    np.testing.assert_allclose(later.distance, first.distance, rtol=1e-6)
    gone = solve_found(found_in(KNOWN, **options), UNKNOWN)
    assert not gone.metric


@pytest.mark.parametrize("stage", ["bounced light", "contours"])
def test_a_run_that_is_stopped_on_the_way_tells_of_what_it_returns(stage):
    """The surface so far, on all pixels of the frame though it was sought on fewer, and in mm."""
    frame, known = SAMPLE.frame, replace(UNKNOWN, camera=SAMPLE.calibration.camera)
    stop = [lambda step: step.stage == stage and step.k > 0]
    how = {"median_distance": 50.0, "smooth": 1.5, "contours": True}
    result = el.reconstruct(frame, known, observers=stop, **how)
    report = result.report
    assert result.distance.shape == (report.height, report.width) == (240, 320)
    assert np.median(result.distance[result.mask]) == pytest.approx(50)
    assert (report.smooth, report.stage, report.settings["stage"]) == (
        1.5,
        stage,
        stage,
    )
    assert stage in " ".join(summary(result))
    assert el.reconstruct(frame, known, channel="green", width=80).report.stage == ""

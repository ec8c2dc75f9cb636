"""Checks for notebook 04: right answers pass, and each mistake is told by name."""

import json
import sys
import warnings
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import maximum_filter, minimum_filter

import endolab as el
from endolab.course import brightness_to_depth as check
from tests.tools.notebook_solutions import solutions

NOTEBOOK = Path(__file__).resolve().parents[2] / "notebooks" / "04_from_brightness_to_depth.ipynb"
SOLUTION = solutions(json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"])[0].partition("\nassert ")[0]
START = "if all(y0[r, c] <= y0[r + i, c + j] for i, j in around)"
LARGER = "max((y for y in {} if y < np.inf), default=np.inf)"
SIDES = [f"min({pair})" for pair in ("y[p, q - 1], y[p, q + 1]", "y[p - 1, q], y[p + 1, q]")]

# What is changed in the solution's text, and words that only the sentence for it has.
MISTAKES = {
    "nothing returned": ([("return np.sqrt(y[1:-1, 1:-1])", "pass")], "returns nothing"),
    "y in place of d": ([("np.sqrt(y[1:-1, 1:-1])", "y[1:-1, 1:-1]")], "y = d², in mm²"),
    "the frame left": ([("y[1:-1, 1:-1]", "y")], "frame of one pixel"),
    "another shape": ([("y[1:-1, 1:-1]", "y[1:-1, 1:-1].ravel()")], "shape (192,)"),
    "final everywhere": (
        [
            (START, "if True"),
            ("            heappush(heap, (y[r, c], r, c))", "            final[r, c] = True"),
        ],
        "kept d₀",
    ),
    "the lowest start alone": ([(START, "if y0[r, c] == y0.min()")], "every local minimum"),
    "starts at 0": ([("y[r, c] = y0[r, c]", "y[r, c] = 0")], "a start: y = y₀"),
    "no neighbours": ([("if not final[p, q]:", "if False:")], "hardly leaves its starts"),
    "never pushed": ([("heappush(heap, (new, p, q))", "pass")], "hardly leaves its starts"),
    "smaller root": (
        [("(t + inside**0.5)", "(t - inside**0.5)"), (") >= lower[-1]", ") > 0")],
        "runs downhill",
    ),
    "highest first": (
        [("(heap, (y[r, c]", "(heap, (-y[r, c]"), ("(heap, (new", "(heap, (-new")],
        "the lowest comes next",
    ),
    "final no more": (
        [("if not final[p, q]:", "if y0[p, q] < np.inf:"), ("if new < y[p, q]:", "if True:")],
        "A final pixel stays",
    ),
    "no end": (
        [("        if final[r, c]:\n            continue\n", "        heappush(heap, (0, r, c))\n")],
        "not end",
    ),
    "one neighbour": ([("((low, high), (low,))", "((low,),)")], "The lower neighbour alone"),
    "the root of two always": ([(") >= lower[-1]", ") > 0")], "too low"),
    "larger neighbour": (
        [(side, LARGER.format(side[3:])) for side in SIDES],
        "larger neighbour was taken",
    ),
    "no 4": ([("4 * delta**2", "delta**2")], "The 4 is missing"),
    "Δ": ([("4 * delta**2", "4 * delta")], "Δ is not squared"),
    "no y² on the right": ([("len(lower) + 4 * delta**2", "len(lower)")], "y² is missing"),
    "another pixel's Δ": ([("delta[p, q])", "delta[r, c])")], "Δ are those of the pixel"),
    "another pixel's y₀": ([("y0[p, q], delta", "y0[r, c], delta")], "above y₀"),
    "one Δ for all": ([("np.pad(delta, 1)", "np.full(np.add(delta.shape, 2), delta.mean())")], "too high"),
    "only where both lead": (
        [
            ("return np.inf", "return np.nan"),
            ("((low, high), (low,))", "((low, high),) if high < y0 else ((low,),)"),
        ],
        "take the root of the lower one alone",
    ),
}


def march_of(source):
    names = {"np": np}
    exec(source, names)
    return names["march"]


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_march_that_errs_is_told_how(mistake):
    changes, told = MISTAKES[mistake]
    source = SOLUTION
    for old, new in changes:
        assert old in source
        source = source.replace(old, new)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        found = check.march(march_of(source))
    assert found.right is False
    assert told in found.said


def test_a_march_that_is_right_passes_however_it_is_written():
    assert "d₀ errs by 5.79 %, your march by 0.15 %" in check.march(march_of(SOLUTION)).said
    everywhere = march_of(SOLUTION.replace(START, "if True"))
    assert check.march(everywhere), "y₀ is an upper bound, so nothing is wrong with too many starts"
    assert check.march(check.first_order), "nor with another order"


def test_no_march_yet():
    def march(d0, delta):
        raise NotImplementedError

    assert check.march(march).right is None


def test_a_debugger_keeps_its_trace():
    def mine(frame, event, argument):
        return None

    before = sys.gettrace()
    sys.settrace(mine)
    try:
        assert check.march(march_of(SOLUTION))
        assert sys.gettrace() is mine
    finally:
        sys.settrace(before)


@pytest.mark.parametrize("scene", ["curved", "plane", "bump"])
def test_twice_the_pixels_half_the_error(scene):
    """What students are told to get is of first order, and exact in the end."""
    wall, errors = (el.SCENES | {"bump": el.Bump()})[scene], []
    for width in (40, 80, 160):
        height, f = width * 3 // 4, width * 0.625
        lens = el.KannalaBrandt(width, height, f, f, width / 2, height / 2, check.STEREOGRAPHIC)
        uu, uv, vv = np.moveaxis(lens.field.inverse_metric, -1, 0)
        assert max(np.abs(uu / vv - 1).max(), np.abs(uv / uu).max()) < 5e-4, "pixels are as wide as high"
        view = el.render(wall, lens, el.Photometry())
        d0 = view.distance / np.sqrt(-np.einsum("hwi,hwi->hw", view.normals, lens.field.rays))
        errors.append(np.mean(np.abs(check.first_order(d0, check.pixel_angle(lens)) / view.distance - 1)))
    assert errors[2] < 0.003
    np.testing.assert_allclose(np.log2(np.divide(errors[:-1], errors[1:])), 1, atol=0.1)


@pytest.mark.parametrize(
    ("half_angle", "told"),
    [
        (52, None),
        (51.5, None),
        (np.deg2rad(52), "radians"),
        (104, "half of it"),
        (78.6, "border itself"),
        (63.8, "squared"),
        (57.5, "mind the root"),
        (45, "larger than 1 %"),
        (60, "smaller than 1 %"),
    ],
)
def test_how_wide_one_must_see(half_angle, told):
    found = check.exercise_1(half_angle)
    assert found.right is (told is None)
    assert (told or "52.2°") in found.said


@pytest.fixture(scope="module")
def colon():
    simple = el.load_calibration("simple")
    return el.render(el.SCENES["colon"], simple.camera, simple.photometry)


def error_told(seen, where, share=np.log, inflow=np.log, mean=np.mean, unit=100, rim=True):
    """An answer to exercise 2 that may be wrong in one way."""
    border = np.full(seen.mask.shape, rim)
    border[1:-1, 1:-1] = False
    frame, whole = el.Frame(seen.image, seen.mask), el.Calibration(seen.camera, seen.photometry)

    def answer(jump):
        given = np.where(border | where(share(seen.distance), jump), inflow(seen.distance), np.nan)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)
            found = el.reconstruct(frame, whole, inflow=given, smooth=0, solver="fast_marching").distance
        return unit * mean(np.abs(found / seen.distance - 1))

    return answer


def far_side(values, jump):
    return values - minimum_filter(values, 3) > jump


def near_side(values, jump):
    return maximum_filter(values, 3) - values > jump


def nowhere(values, jump):
    return np.zeros(values.shape, dtype=bool)


@pytest.mark.parametrize(
    ("how", "told"),
    [
        ({"where": far_side}, None),
        ({"where": far_side, "unit": 1}, "Per cent"),
        ({"where": far_side, "mean": np.median}, "median"),
        ({"where": far_side, "rim": False}, "border is missing"),
        ({"where": nowhere}, "edges are missing"),
        ({"where": near_side}, "near sides"),
        ({"where": far_side, "share": np.asarray}, "log d, not of d"),
        ({"where": far_side, "inflow": lambda d: np.log(d) / 2}, "not"),
        ({"where": far_side, "inflow": lambda d: d / 10}, "inflow` takes log d"),
    ],
)
def test_what_is_left_at_the_folds(colon, how, told):
    found = check.exercise_2(error_told(colon, **how), colon)
    assert found.right is (told is None)
    assert (told or "From 0.20 % to 0.029 %") in found.said


def test_no_answer_yet(colon):
    def error_told(jump):
        raise NotImplementedError

    assert check.exercise_1(...).right is None
    assert check.exercise_2(error_told, colon).right is None

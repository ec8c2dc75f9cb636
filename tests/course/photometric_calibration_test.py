"""Answers to notebook 03: the right ones pass, each mistake that is known gets its own sentence."""

import re

import numpy as np
import pytest

import endolab as el
from endolab.calibration.simulation.video import PAPER_SHEET, simulate_samples
from endolab.course import photometric_calibration as check

TRUTH = el.Photometry(k=2.5, gamma=2.2, brdf=PAPER_SHEET)
CAMERA = el.load_calibration("paper", width=480).camera


@pytest.fixture(scope="module")
def video():
    """Samples of a flat sheet."""
    return simulate_samples(el.TARGETS["vicalib_small"], CAMERA, TRUTH, 40)[0]


@pytest.fixture(scope="module")
def folded():
    """Samples of a folded sheet, and their fit."""
    sheet, fold = el.TARGETS["vicalib_folded"], np.deg2rad(30)
    samples, _ = simulate_samples(sheet, CAMERA, TRUTH, 60, fold=fold)
    return samples, el.calibrate_light(samples, gamma="free")


def right(k, gamma, gains, nodes, f_r, samples):
    """A residual by hand."""
    return 255 * (modelled(k, gamma, gains, nodes, f_r, samples) - samples.level)


def modelled(k, gamma, gains, nodes, f_r, samples, **instead):
    """A level by hand, of which parts can be replaced."""
    d = np.linalg.norm(samples.points, axis=1)
    cos_alpha = samples.points[:, 2] / d
    cos_theta = -np.sum(samples.points * samples.normals, axis=1) / d
    angles = np.arccos(cos_alpha), np.arccos(cos_theta)
    part = {
        "d": d**-2,
        "alpha": cos_alpha**k,
        "theta": cos_theta,
        "f": np.interp(angles[1], nodes, f_r),
        "g": gains[samples.frame],
        "outside": 1.0,
        "power": 1 / gamma,
    }
    known = {"d": d, "cos_alpha": cos_alpha, "cos_theta": cos_theta, "alpha": angles[0], "theta": angles[1]}
    known |= {"k": k, "gamma": gamma, "gains": gains, "nodes": nodes, "f_r": f_r, "samples": samples}
    part |= {name: new(known) for name, new in instead.items()}
    light = part["d"] * part["alpha"] * part["theta"] * part["f"] * part["g"]
    return light ** part["power"] * part["outside"]


def with_parts(**instead):
    """A residual of which parts are replaced."""
    return lambda *given: 255 * (modelled(*given, **instead) - given[-1].level)


def of_level(change):
    """A residual that is made of the right level, and of what is stored, in another way."""
    return lambda *given: change(modelled(*given), given[-1].level)


def unwritten(*given):
    raise NotImplementedError


def test_a_right_residual_passes(video):
    assert check.residual(right, video)


def test_an_unwritten_residual_is_no_answer_yet(video):
    assert check.residual(unwritten, video).right is None


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (of_level(lambda model, stored: 255 * (stored - model)), "sign"),
        (of_level(lambda model, stored: model - stored), "multiply by 255"),
        (of_level(lambda model, stored: stored - model), "not the reverse"),
        (of_level(lambda model, stored: 255 * model), "model's grey level; take away"),
        (of_level(lambda model, stored: model), "model's level; take away"),
        (of_level(lambda model, stored: 255 * model - stored), "what is taken away is not"),
        (of_level(lambda model, stored: model - 255 * stored), "the model is not"),
        (of_level(lambda model, stored: (model - stored).mean()), "One number a sample"),
        (of_level(lambda model, stored: None), "returns nothing"),
        (of_level(lambda model, stored: np.where(stored > 0.5, np.inf, model)), "not finite"),
        (with_parts(power=lambda _: 1), "light itself"),
        (with_parts(power=lambda x: x["gamma"]), "here it is γ"),
        (with_parts(power=lambda x: 1 / 2.2), r"power 0\.455; with γ = 1\.9"),
        (with_parts(d=lambda x: 1 / x["d"]), r"\*square\* of the distance"),
        (with_parts(d=lambda x: 1), "distance plays no part"),
        (with_parts(d=lambda x: x["d"] ** 2), r"power 2\.00: light thins"),
        (with_parts(d=lambda x: x["samples"].points[:, 2] ** -2.0), "not its part z"),
        (with_parts(d=lambda x: 1 / x["samples"].points[:, 2]), r"1/d\. .* not its part z"),
        (with_parts(alpha=lambda x: 1), "cosᵏα, is missing"),
        (with_parts(alpha=lambda x: x["cos_alpha"]), r"power 1\.00; here k"),
        (with_parts(alpha=lambda x: x["cos_theta"] ** x["k"]), "here it is taken at θ"),
        (with_parts(theta=lambda x: x["cos_alpha"]), "here it is taken at α"),
        (
            with_parts(
                alpha=lambda x: x["cos_theta"] ** x["k"],
                theta=lambda x: x["cos_alpha"],
            ),
            "changed places",
        ),
        (with_parts(theta=lambda x: 1), "cos θ is missing"),
        (with_parts(theta=lambda x: x["cos_theta"] ** 2), "there twice"),
        (with_parts(theta=lambda x: x["cos_theta"] ** 3), r"cos θ enters with the power 3\.00"),
        (with_parts(theta=lambda x: -x["cos_theta"]), "way back"),
        (with_parts(theta=lambda x: np.cos(np.rad2deg(x["theta"]))), "given degrees"),
        (with_parts(alpha=lambda x: np.cos(np.rad2deg(x["alpha"])) ** x["k"]), "given degrees"),
        (with_parts(f=lambda x: np.interp(x["alpha"], x["nodes"], x["f_r"])), "looked up at α"),
        (with_parts(f=lambda x: np.interp(x["cos_theta"], x["nodes"], x["f_r"])), "looked up at cos θ"),
        (with_parts(f=lambda x: np.interp(np.rad2deg(x["theta"]), x["nodes"], x["f_r"])), "in degrees"),
        (
            with_parts(f=lambda x: x["f_r"][np.abs(x["theta"][:, None] - x["nodes"]).argmin(axis=1)]),
            "straight lines",
        ),
        (with_parts(f=lambda x: 1), "BRDF is missing"),
        (with_parts(f=lambda x: np.interp(x["theta"], x["nodes"], x["f_r"]) / np.pi), "π too many"),
        (with_parts(f=lambda x: np.interp(x["theta"], x["nodes"], x["f_r"]) ** 2), r"f_r enters with"),
        (with_parts(g=lambda x: 1), "gain of the frame is missing"),
        (with_parts(g=lambda x: 1, outside=lambda x: x["gains"][x["samples"].frame]), "into the bracket"),
        (with_parts(g=lambda x: 1 / x["gains"][x["samples"].frame]), r"gain enters with the power -1\.00"),
        (with_parts(g=lambda x: x["gains"][::-1][x["samples"].frame]), "gain of its own frame"),
        (with_parts(outside=lambda x: 2 ** (1 / x["gamma"])), "2 times what it should"),
        (with_parts(theta=lambda x: 1, outside=lambda x: 1 + x["theta"]), "first sample"),
    ],
)
def test_a_wrong_residual_hears_what_is_wrong(video, answer, said):
    verdict = check.residual(answer, video)
    assert verdict.right is False
    assert re.search(said, verdict.said), verdict.said


def test_two_mistakes_are_both_named(video):
    answer = with_parts(d=lambda x: 1 / x["d"], power=lambda _: 1)
    said = check.residual(lambda *given: -answer(*given), video).said
    assert all(words in said for words in ("sign", "light itself", "*square*"))


def test_how_far_a_matt_sheet_leads_astray(folded):
    samples, glossy = folded
    matt = el.calibrate_light(samples, gamma="free", brdf="lambertian")
    error, se = matt.photometry.gamma - 2.2, matt.standard_errors["gamma"]
    of_k = (matt.photometry.k - 2.5) / matt.standard_errors["k"]

    def said(off, warned="residuals"):
        return check.exercise_1(off, warned, samples, glossy, TRUTH)

    assert said(error / se)
    assert said(-error / se)
    assert said(..., ...).right is None
    for off, words in (
        (error, "error of γ itself"),
        (100 * error / 2.2, "percent"),
        (error / matt.sigma, "units of σ"),
        (of_k, "what k is off"),
        ((glossy.photometry.gamma - 2.2) / glossy.standard_errors["gamma"], "with a table; take"),
        (error / glossy.standard_errors["gamma"], "of the matt fit, not"),
        (1e6, "`told`"),
    ):
        assert words in said(off).said
    assert "not of a wrong model" in said(error / se, "standard errors").said
    assert "second answer" in said(error / se, "k").said


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (4, "truth"),
        (4**1.1, "other way round"),
        (4 / 1.1, "*power*"),
        (4 ** (-1 / 1.1), "turn it round"),
        (16 ** (1 / 1.1), "between their lights; light"),
        (16, "true lights"),
        (0.118, "by how much"),
        (11.8, "percent"),
        (1, "which power"),
    ],
)
def test_a_wrong_factor_hears_what_is_wrong(factor, said):
    verdict = check.exercise_2(factor)
    assert verdict.right is False
    assert said in verdict.said


def test_a_right_factor_passes():
    assert check.exercise_2(4 ** (1 / 1.1))
    assert check.exercise_2(...).right is None

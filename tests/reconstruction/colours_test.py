"""What three colours tell, asked of colours that the model itself made of a known surface."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal, assert_array_less

import endolab as el
from endolab.model.photometry import CHANNELS
from endolab.reconstruction.colours import (
    AlbedoPrior,
    Light,
    Patches,
    fit_light,
    refine_per_pixel,
    residuals,
)
from endolab.reconstruction.problem_of_frame import make_problem
from endolab.reconstruction.walls import Walls
from endolab.solvers.provenance import LightOutcome

ALBEDO = np.array([0.62, 0.30, 0.22])


def light_of(albedo, factor, lamp):
    return Light(LightOutcome.REMOVED, albedo, factor, lamp)


@pytest.fixture(scope="module")
def known():
    """The surface of a path-traced colon, and its problems, of 80 x 60 px."""
    sample = el.load_traced("diffuse-1")
    problems = [
        make_problem(sample.frame, sample.calibration, channel=name, width=80)
        for name in CHANNELS
    ]
    green = problems[1]
    v = np.log(sample.scene.distance(green.field.rays))
    return problems, Walls.of(v, green.mask, green.field, green.photometry.k)


def pictures(known, light, indirect_ratio, texture=0.0):
    """Three pictures of a wall that bounces so much, its green and blue mottled together."""
    problems, walls = known
    gamma = problems[1].photometry.gamma
    mottle = np.random.default_rng(5).normal(scale=texture, size=walls.direct.shape)[
        ..., None
    ]
    stored = walls.direct[..., None] * light.albedo * (1 + indirect_ratio)
    stored = stored * np.exp(mottle * [0.2, 1.0, 1.0])
    stored = (stored / stored.max()) ** (1 / gamma)
    return [
        replace(one, image=stored[..., i], evidence=None)
        for i, one in enumerate(problems)
    ]


def shown(known, light, texture=0.0):
    """Patches of the picture that a wall in this light would make."""
    problems, walls = known
    made = pictures(
        known, light, light.indirect_ratio(walls, problems[1].photometry.k), texture
    )
    return Patches.of(made, walls)


@pytest.mark.parametrize("lamp", [0.1, 0.6, 1.0])
def test_factor_and_lamp_are_found(known, lamp):
    patches = shown(known, light_of(ALBEDO, 1.1, lamp))
    found = fit_light(patches, AlbedoPrior.of(ALBEDO))
    assert found.factor == pytest.approx(1.1, abs=0.12)
    assert found.lamp == pytest.approx(lamp, abs=0.3)
    assert found.misfit < 0.02
    assert_allclose(found.albedo, ALBEDO, rtol=0.08)
    assert found.outcome is LightOutcome.REMOVED


@pytest.mark.parametrize("given", [ALBEDO, 0.3, None])
def test_no_bounces_are_found_where_there_are_none(known, given):
    found = fit_light(shown(known, light_of(ALBEDO, 0.0, 1.0)), AlbedoPrior.of(given))
    assert found.factor < 0.03
    assert found.outcome is LightOutcome.NONE_BOUNCED


def test_what_ends_at_a_bound_is_refused_and_the_fallback_named(known):
    patches = shown(known, light_of(ALBEDO, 6.0, 1.0))
    found = fit_light(patches, AlbedoPrior.of(ALBEDO))
    assert found.outcome is LightOutcome.COMPUTED
    assert "more light than can have bounced" in found.reason
    before = AlbedoPrior.of(ALBEDO).light
    assert (found.factor, found.lamp) == (before.factor, before.lamp)


@pytest.mark.parametrize("wrong", [0.7, 1.0, 1.4])
def test_tint_tells_where_more_or_less_bounced(known, wrong):
    """What was taken to bounce deep down is off by this factor: some of that is mended, and no more."""
    problems, walls = known
    light = light_of(ALBEDO, 1.0, 1.0)
    true = light.indirect_ratio(walls, problems[1].photometry.k)
    green = true[problems[1].mask, 1]
    deep = problems[1].mask & (true[..., 1] > np.quantile(green, 0.8))
    made = pictures(
        known, light, np.where(deep[..., None], true / wrong, true), texture=0.02
    )
    corrected = refine_per_pixel(made, true, light)
    mended, kept = (
        np.median((corrected / true)[where][:, 0])
        for where in (deep, problems[1].mask & ~deep)
    )
    least, most = sorted(((1 / wrong) ** 0.35, 1 / wrong))
    assert least - 0.02 < mended < most + 0.02
    assert kept == pytest.approx(1, abs=0.02)
    assert_array_equal(refine_per_pixel(made, true, replace(light, reason="why")), true)


@pytest.mark.parametrize("x", [(0.9, 0.7), (2.2, 0.1), (0.3, 0.9)])
@pytest.mark.parametrize("albedo", [ALBEDO, np.array([0.94, 0.5, 0.05])])
def test_derivatives_are_those_of_differences(known, x, albedo):
    patches = shown(known, light_of(ALBEDO, 1.1, 0.6), texture=0.3)
    x = np.array([*x, *np.log(albedo)])

    def at(x):
        return residuals(x, patches, AlbedoPrior.of(0.3))

    differences = [
        (at(x + step)[0] - at(x - step)[0]) / 2e-6 for step in 1e-6 * np.eye(5)
    ]
    most = np.abs(differences).max(axis=1)
    assert_array_less(np.abs(at(x)[1].T - differences).max(axis=1), 2e-5 * most)

"""Random frames: what a seed draws, how a frame is developed, and that nothing is lost in its file."""

import json
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from endolab.datasets.traced import LAYERS
from endolab.model.photometry import Photometry
from endolab.synthetic.path_tracing import Traced
from endolab.synthetic.rendering import VEIL, render
from tests.benchmarks import unseen
from tests.tools import random_frames
from tests.tools.random_frames import KINDS, SETS, _developed, frame_of, make, random_case, read, write

SEEDS = range(len(KINDS))


@pytest.fixture(scope="module")
def cases():
    return [random_case(seed) for seed in SEEDS]


def small(case, **changes):
    """The same case for a picture that is soon made."""
    return replace(case, camera=case.camera.resize(48, 36), **changes)


def lit(case):
    """What path tracing might have returned: direct light of one lamp, a tenth of it as bounced light."""
    one = Photometry(2.5, case.photometry.gamma, 1.0, case.photometry.brdf)
    made = render(case.cavity, case.camera, one)
    direct = made.image**one.gamma
    truth = {name: getattr(made, name) for name in ("distance", "normals", "mask", "camera")}
    layers = {"direct": direct, "indirect": 0.1 * direct, "mirrored": 0.01 * direct[..., 0]}
    return Traced(image=made.image, photometry=one, **truth, **layers)


def test_a_seed_decides_everything(cases):
    assert random_case(3) == cases[3]
    assert random_case(3 + len(KINDS)) != cases[3]
    assert not set(SETS["open"]) & set(SETS["sealed"])


def test_every_kind_takes_its_turn_and_can_be_seen(cases):
    assert [case.kind for case in cases] == list(KINDS)
    for case in cases:
        assert case.cavity.inside(np.zeros(3)) > random_frames.CLEARANCE / 2
        albedo = case.photometry.brdf.albedo
        assert 0.9 > albedo[0] > albedo[1] >= albedo[2] > 0.1
        off = [np.hypot(*lamp.position[:2]) for lamp in case.photometry.lights]
        assert 1 <= len(off) <= 3
        assert max(off) <= 4.0
        simple = case.photometry.simplified()
        assert 1.0 <= simple.k <= 3.5
        json.dumps(case.wall)
    assert {bool(case.cavity.polyps) for case in cases if case.kind == "polyps"} == {True}


def test_the_sensor_takes_the_layers(cases):
    case = small(cases[0], noise=0.0, jpeg=None, fog=0.001, exposure=(0.1, 1.0))
    traced = lit(case)
    made = _developed(case, traced)
    linear = made.direct + made.indirect + made.mirrored[..., None]
    linear += VEIL * (1 - np.exp(-0.001 * made.distance))[..., None]
    stored = np.clip(linear, 0, 1) ** (1 / case.photometry.gamma)
    assert_allclose(255 * made.frame.image, np.round(255 * stored), atol=1e-9)
    assert np.mean(made.frame.image.max(axis=-1) == 1) == pytest.approx(0.1, abs=0.01)
    packed = _developed(replace(case, jpeg=80), traced).frame.image
    off = 255 * np.abs(packed - made.frame.image)
    assert 0 < off.mean() < 6
    noisy = _developed(replace(case, noise=3.0, exposure=(0.01, 0.8)), traced).frame.image
    dim = _developed(replace(case, exposure=(0.01, 0.8)), traced).frame.image
    assert (255 * (noisy - dim)).std() == pytest.approx(3, rel=0.1)
    assert np.percentile(dim.max(axis=-1), 99) == pytest.approx(0.8, abs=0.01)


@pytest.mark.parametrize("known", [True, False])
def test_what_is_known_is_what_a_user_has(cases, known):
    case = small(cases[1], albedo_known=known)
    made = _developed(case, lit(case))
    one, real = made.calibration.photometry, made.facts["made_with"]["photometry"]
    assert not one.lights
    assert one.k == pytest.approx(case.photometry.k + case.photometry.lights[0].exponent)
    assert one.gain == pytest.approx(real["gain"])  # the lamps' weights add up to 1
    albedo = case.photometry.brdf.albedo
    assert one.brdf.albedo == (albedo if known else albedo[1])


def test_round_trip(cases, tmp_path):
    case = small(cases[3])
    old = _developed(case, lit(case))
    write(tmp_path / "a.npz", old)
    new = read(tmp_path / "a.npz")
    assert_array_equal(new.frame.image, old.frame.image)
    assert_array_equal(new.frame.mask, old.frame.mask)
    assert_allclose(new.distance, old.distance, rtol=1e-6)
    assert_allclose(new.normals, old.normals, atol=3e-5)
    for name in LAYERS:
        assert_allclose(getattr(new, name), getattr(old, name), rtol=1e-3, atol=1e-6)
    assert new.calibration == old.calibration
    assert new.kind == old.kind == "bag"
    assert new.facts["wall"] == case.wall


def test_the_bench_scores_both_sets_and_tells_the_gap_and_what_got_worse(
    cases, tmp_path, capsys, monkeypatch
):
    def obeying(seeds, folder):
        folder.mkdir(parents=True)
        for seed in seeds:
            case = small(cases[seed], noise=0.0, jpeg=None, fog=0.0, exposure=(0.01, 0.9))
            write(folder / f"{seed}.npz", _developed(case, lit(case)))

    monkeypatch.setattr(unseen, "SETS", {"open": [1], "sealed": [3]})
    monkeypatch.setattr(unseen, "FOLDER", tmp_path)
    monkeypatch.setattr(unseen, "WORSE", -100.0)  # so that every frame counts as worse
    monkeypatch.setattr(unseen, "make", obeying)
    unseen.main(["open", "sealed"])
    told = capsys.readouterr().out
    for way in ("facing", "best colour", "separated, true contours"):
        rows = [line.split() for line in told.splitlines() if f"  {way}  " in line]
        assert len(rows) == 5  # of a kind and of all, in both sets, and the gap
        here, there, gap = (float(cell) for cell in rows[-1][-3:])
        assert gap == pytest.approx(there - here, abs=0.11)
    assert told.count("green: worse than the best colour by more than -100 point on 1 of 1") == 2
    with pytest.raises(SystemExit, match="holds no frames"):
        unseen.main([str(tmp_path / "none")])


def test_the_bench_finds_the_distance_of_a_frame_that_obeys(cases):
    """Direct light alone, all else known: a bag is then found to a few per cent."""
    case = small(cases[3], noise=0.0, jpeg=None, fog=0.0, exposure=(0.01, 0.9))
    one = Photometry(2.5, case.photometry.gamma, None, case.photometry.brdf)
    traced = lit(case)
    nothing = {"indirect": 0 * traced.indirect, "mirrored": 0 * traced.mirrored}
    made = _developed(replace(case, photometry=one), replace(traced, **nothing))
    how = {"channel": "green", "regulariser": "second"}
    assert unseen.score(made, **how).errors.mean_percent < 6


def test_files_are_made_once_and_usage_is_told(mitsuba, cases, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(random_frames, "random_case", lambda seed: small(cases[seed]))
    make([2], tmp_path, samples=4, mesh_size=60)
    (path,) = tmp_path.glob("*.npz")
    first, written = read(path), path.stat().st_mtime_ns
    make([2], tmp_path, samples=4, mesh_size=60)
    assert path.stat().st_mtime_ns == written
    assert path.stem == "2-blind"
    assert_array_equal(frame_of(small(cases[2]), samples=4, mesh_size=60).frame.image, first.frame.image)
    assert (first.indirect > 0).any()
    lit_part = first.frame.mask & (first.direct[..., 1] > 0)
    assert lit_part.sum() > 0.95 * first.frame.mask.sum()
    assert random_frames.main(["shut", str(tmp_path)]) == 2
    assert "open|sealed FOLDER" in capsys.readouterr().err

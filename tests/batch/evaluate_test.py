"""Depth maps of other programs against the truth: every format, and figures computed on their own."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from skimage.metrics import mean_squared_error

import endolab as el
from endolab.batch.evaluate import evaluate, evaluate_folder
from endolab.io.images import write_image
from endolab.io.surfaces import save_depth

CAMERA = el.load_calibration("paper", width=64).camera
COSINE = CAMERA.field.cos_alpha
SHAPE = COSINE.shape


@pytest.fixture
def truth(tmp_path):
    """A rendered colon: true z, (H, W), mm, and the file that holds it."""
    known = el.load_calibration("paper", width=64)
    scene = el.render(el.SCENES["colon"], known.camera, known.photometry)
    save_depth(tmp_path / "truth.npz", scene, True)
    return scene.z, tmp_path / "truth.npz"


@pytest.fixture
def guess(truth, rng):
    """Another program's z, (H, W), mm: the truth with errors of some percent, none in a corner."""
    z = truth[0] * np.exp(0.15 * rng.standard_normal(SHAPE))
    z[:5, :7] = 0
    return z.astype(np.float32)


def papers(z, true):
    """AbsRel, RMSE and δ₁ to δ₃ as Monodepth2's own evaluation has them."""
    valid = np.isfinite(true) & (z > 0)
    z, true = z[valid].astype(np.float64), true[valid]
    worse = np.maximum(true / z, z / true)
    rmse = np.sqrt(mean_squared_error(true, z))
    below = [(worse < 1.25**n).mean() for n in (1, 2, 3)]
    return np.mean(np.abs(true - z) / true), rmse, *below


def figures(made):
    e = made.errors
    within = (e.within_125, e.within_125_squared, e.within_125_cubed)
    return e.mean_percent / 100, e.rmse_z_mm, *np.divide(within, 100)


# How other programs write z, mm, by a name that says how; and the mm that 1 in it stands for.
HEAD = f"{SHAPE[1]}&{SHAPE[0]}&1&".encode()
WRITERS = {
    "in_m.npy": lambda path, z: np.save(path, z[None, :, :, None] / 1000),
    "three.npy": lambda path, z: np.save(path, np.dstack([z, z, z])),
    "back.npy": lambda path, z: np.save(path, -z),  # behind the camera
    "Depth_Map.npz": lambda path, z: np.savez(path, Depth_Map=z, poses=np.eye(4)),
    "png.png": lambda path, z: cv2.imwrite(path, np.uint16(np.round(256 * z))),
    "xyz.tiff": lambda path, z: cv2.imwrite(path, np.dstack([z, -z, 0 * z])),
    "z.tiff": cv2.imwrite,
    "z.pfm": cv2.imwrite,
    "rows.csv": lambda path, z: np.savetxt(path, z, delimiter=","),
    "a.geometric.bin": lambda path, z: Path(path).write_bytes(HEAD + z.tobytes()),
}
UNITS = {"in_m.npy": 1000.0, "png.png": 1 / 256}


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_gives_the_figures_of_papers(tmp_path, truth, guess, name, caplog):
    path = str(tmp_path / name)
    WRITERS[name](path, np.nan_to_num(guess))
    step = 0.5 / 256 / np.nanmin(truth[0]) if name == "png.png" else 1e-5
    made = evaluate(path, truth[1], unit=UNITS.get(name, 1.0))
    assert (made.kind, made.align) == ("distance", "none")
    expected = papers(guess, truth[0])
    assert figures(made) == pytest.approx(expected, rel=10 * step, abs=2e-3)
    assert made.errors.pixels == np.sum((guess > 0) & np.isfinite(truth[0]))
    assert ("negative" in caplog.text) is (name == "back.npy")


def test_distance_and_z_are_told_apart_and_converted_by_a_camera(
    tmp_path, truth, guess
):
    np.savez(tmp_path / "a.npz", distance=guess / COSINE)
    np.save(tmp_path / "z.npy", guess)
    np.save(tmp_path / "true.npy", truth[0])
    z = evaluate(tmp_path / "z.npy", tmp_path / "true.npy", unit=1)
    how = {"unit": 1, "camera": CAMERA.resize(1440, 1080), "align": "none"}
    far = papers(guess / COSINE, truth[0] / COSINE)[1]
    for name in ("a.npz", "z.npy"):
        made = evaluate(tmp_path / name, tmp_path / "true.npy", **how)
        assert made.kind == "distance"
        assert figures(made) == pytest.approx(figures(z), rel=1e-5)
        assert made.errors.rmse_mm == pytest.approx(far, rel=1e-5)


@pytest.mark.parametrize(
    ("change", "how", "percent"),
    [
        (lambda z: 7 * z, {}, 0),
        (lambda z: 7 * z + 30, {"align": "affine"}, 0),
        (lambda z: 1 / z, {"kind": "disparity"}, 0),
        (lambda z: 1 / z, {"kind": "disparity", "unit": 1}, 0),
        (lambda z: 3 / z + 0.2, {"kind": "disparity", "align": "affine"}, 0),
        (lambda z: 3 / z + 0.2, {"kind": "disparity"}, 20),
        (lambda z: 1 / z, {}, 20),
        (lambda z: z, {"kind": "disparity"}, 20),
        (np.ones_like, {}, 20),
    ],
)
def test_arrays_are_aligned_as_what_they_are(caplog, truth, change, how, percent):
    """With a camera, too: what is affine in z is not in the distance."""
    z, path = truth
    for true in (z, path):
        made = evaluate(change(z), true, camera=CAMERA, **how)
        off = made.errors.mean_percent
        assert off > percent if percent else off == pytest.approx(0, abs=1e-4)
    falls = made.rank_correlation < -0.1
    assert falls is ("falls where the truth rises" in caplog.text)
    assert falls is ((change(9.0) < change(8.0)) is not ("kind" in how))


def test_one_largest_number_of_a_truth_and_what_is_too_far_are_unknown(
    truth, guess, caplog
):
    z = np.nan_to_num(truth[0])
    made = evaluate(guess, np.where(z > 0, z, 1e10), unit=1)
    assert figures(made) == pytest.approx(papers(guess, truth[0]), abs=1e-4)
    assert "one number" in caplog.text
    near = evaluate(guess, z, unit=1, max_depth=30)
    assert near.errors.pixels == np.sum((guess > 0) & (z > 0) & (z <= 30))


def test_a_mask(tmp_path, truth, guess):
    np.save(tmp_path / "z.npy", guess)
    mask = np.zeros(SHAPE)
    mask[10:30, 20:50] = 1
    write_image(tmp_path / "mask.png", mask)
    expected = papers(guess[10:30, 20:50], truth[0][10:30, 20:50])
    for given in (tmp_path / "mask.png", np.uint8(255 * mask), mask, mask > 0):
        part = evaluate(tmp_path / "z.npy", truth[1], unit=1, mask=given)
        assert part.errors.pixels == 600
        assert figures(part) == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize(
    ("prediction", "true"),
    [
        ("{:04d}.npy", "{:04d}.npy"),
        ("frame_{}_depth.npy", "{:04d}_depth.tiff"),
        ("{}/depth.npy", "sub/truth-{:03d}.npy"),
        ("{}.csv", "{:03d}.txt"),
    ],
)
def test_folders_are_paired_by_name_or_number(tmp_path, prediction, true):
    """Frames 2, 9 and 10 are there twice, errors 10, 20 and 30 %; 11 and 12 have no partner."""
    percent = {2: 10, 9: 20, 10: 30}
    ours = {n: tmp_path / "a" / prediction.format(n) for n in (2, 9, 10, 11)}
    theirs = {n: tmp_path / "b" / true.format(n) for n in (12, 10, 9, 2)}
    for path in (*ours.values(), *theirs.values()):
        path.parent.mkdir(parents=True, exist_ok=True)
    z = np.full((40, 50), 20.0)
    for n, path in ours.items():
        save = np.save if path.suffix == ".npy" else np.savetxt
        save(path, z + 0.2 * percent.get(n, 0))
    for path in theirs.values():
        if path.suffix != ".tiff":
            save(path, z)
        else:  # C3VD's, beside its colours
            cv2.imwrite(str(path), np.round(z * 655.35).astype(np.uint16))
            colour = path.name.replace("depth.tiff", "color.png")
            write_image(path.with_name(colour), z / 99)
    made, alone = evaluate_folder(tmp_path / "a", tmp_path / "b", unit=1)
    errors = {one.name: one.errors.mean_percent for one in made}
    assert errors == {
        str(ours[n]): pytest.approx(percent[n], abs=0.01) for n in percent
    }
    assert {*alone} == {str(ours[11]), str(theirs[12])}

"""Files in and out: pictures against other programs, and nothing left half-written."""

import errno
import json
import os
import resource
import signal
import struct
import subprocess
import sys
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

import endolab as el
from endolab.depth.solvers import DEFAULT_SOLVER
from endolab.io.atomic import staged_folder, write_atomically
from endolab.io.images import read_image, read_mask, write_image
from endolab.io.surfaces import write_cloud
from endolab.reconstruction.assumptions import meaning
from endolab.reports import result as result_module

CAMERA = el.Pinhole(40, 30, 20.0, 20.0, 19.5, 14.5)
CALIBRATION = el.Calibration(CAMERA, el.Photometry())


def png(path, stored, bits):
    """Write a PNG of 8 or 16 bits, grey, grey with alpha, RGB or RGBA, by its specification."""
    height, width = stored.shape[:2]
    kind = {1: 0, 2: 4, 3: 2, 4: 6}[1 if stored.ndim == 2 else stored.shape[2]]
    rows = stored.astype(f">u{bits // 8}").reshape(height, -1)

    def chunk(name, content):
        whole = name + content
        return struct.pack(">I", len(content)) + whole + struct.pack(">I", zlib.crc32(whole))

    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, kind, 0, 0, 0))
        + chunk(b"IDAT", zlib.compress(b"".join(b"\0" + row.tobytes() for row in rows)))
        + chunk(b"IEND", b"")
    )


def random_stored(rng, bits, channels):
    stored = rng.integers(0, 2**bits, (5, 7, *channels)).astype(f"u{bits // 8}")
    stored.flat[:2] = 0, 2**bits - 1
    return stored


@pytest.fixture(scope="module")
def result():
    rendered = el.render(el.SCENES["curved"], CAMERA, el.Photometry(brdf=el.Lambertian((0.7, 0.4, 0.3))))
    mask = rendered.mask.copy()
    mask[:5, :7] = False
    calibration = el.Calibration(CAMERA, rendered.photometry)
    return el.reconstruct(el.Frame(rendered.image, mask), calibration)


def contents(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


# Reading pictures ------------------------------------------------------------------------


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("channels", [(), (3,), (4,)], ids=["grey", "rgb", "rgba"])
def test_a_png_is_read_exactly(tmp_path, rng, bits, channels):
    stored = random_stored(rng, bits, channels)
    png(tmp_path / "a.png", stored, bits)
    expected = stored[..., :3] if channels else stored
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), expected / (2**bits - 1))


@pytest.mark.parametrize("bits", [8, 16])
def test_a_grey_png_with_alpha_is_grey(tmp_path, rng, bits):
    stored = random_stored(rng, bits, (2,))
    png(tmp_path / "a.png", stored, bits)
    image = read_image(tmp_path / "a.png")
    for channel in np.moveaxis(image, -1, 0) if image.ndim == 3 else [image]:
        np.testing.assert_array_equal(channel, stored[..., 0] / (2**bits - 1))


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("channels", [(), (3,), (4,)], ids=["grey", "rgb", "rgba"])
def test_a_tiff_is_read_exactly(tmp_path, rng, bits, channels):
    stored = random_stored(rng, bits, channels)
    options = {"photometric": "rgb"} if channels else {}
    if channels == (4,):
        stored[..., 3] = 2**bits - 1
        options["extrasamples"] = ["unassalpha"]
    tifffile.imwrite(tmp_path / "a.tiff", stored, **options)
    expected = stored[..., :3] if channels else stored
    np.testing.assert_array_equal(read_image(tmp_path / "a.tiff"), expected / (2**bits - 1))


@pytest.mark.parametrize("mode", ["L", "RGB"])
def test_a_jpeg_is_read_as_others_read_it(tmp_path, mode):
    row, column = np.indices((48, 64))
    colour = np.stack([row * 5, column * 4, 255 - row - column], axis=-1).astype(np.uint8)
    Image.fromarray(colour).convert(mode).save(tmp_path / "a.jpg", quality=95)
    expected = np.asarray(Image.open(tmp_path / "a.jpg"), dtype=float) / 255
    image = read_image(tmp_path / "a.jpg")
    assert image.shape == expected.shape
    assert np.abs(image - expected).max() <= 2 / 255


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int16])
def test_other_numbers_are_not_a_picture(tmp_path, dtype):
    tifffile.imwrite(tmp_path / "a.tiff", np.ones((4, 4), dtype))
    with pytest.raises(ValueError, match=f"a.tiff: expected 8 or 16 bits a channel, found {dtype.__name__}"):
        read_image(tmp_path / "a.tiff")


@pytest.mark.parametrize("content", [b"", b"hello", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff\xe0" + bytes(50)])
def test_what_is_not_a_picture_is_said_once(tmp_path, capfd, content):
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(ValueError, match=r"a\.png: not a picture that can be read"):
        read_image(tmp_path / "a.png")
    assert capfd.readouterr() == ("", "")


def test_a_missing_file_and_a_folder(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"none\.png: there is no such file"):
        read_image(tmp_path / "none.png")
    with pytest.raises(OSError, match="cannot be read: Is a directory"):
        read_image(tmp_path)


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("channels", [(), (3,)])
def test_a_written_picture_reads_back(tmp_path, rng, bits, channels):
    stored = random_stored(rng, bits, channels)
    write_image(tmp_path / "a.png", stored / (2**bits - 1), bits)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), stored / (2**bits - 1))
    write_image(tmp_path / "b.png", np.where(stored > 9, 1.7, -0.3), bits)
    np.testing.assert_array_equal(read_image(tmp_path / "b.png"), stored > 9)
    if bits == 8:
        np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "a.png")), stored)


# Frames and masks ------------------------------------------------------------------------


def test_a_mask_is_where_it_is_bright(tmp_path):
    write_image(tmp_path / "grey.png", np.array([[0.0, 0.49, 0.51, 1.0]]))
    write_image(tmp_path / "colour.png", np.array([[[0, 0, 0], [0.4, 0.4, 0.4], [0, 0.9, 0]]]))
    np.testing.assert_array_equal(read_mask(tmp_path / "grey.png"), [[False, False, True, True]])
    np.testing.assert_array_equal(read_mask(tmp_path / "colour.png"), [[False, False, True]])


def test_a_frame_with_its_mask(tmp_path, rng):
    image, mask = rng.uniform(size=(30, 40, 3)), rng.uniform(size=(30, 40)) < 0.5
    write_image(tmp_path / "f.png", image, 16)
    write_image(tmp_path / "m.png", mask.astype(float))
    frame = el.read_frame(tmp_path / "f.png", CALIBRATION, tmp_path / "m.png")
    assert frame.name == "f.png"
    np.testing.assert_allclose(frame.image, image, atol=0.51 / 65535)
    np.testing.assert_array_equal(frame.mask, mask)
    assert el.read_frame(str(tmp_path / "f.png")).mask.all()


@pytest.mark.parametrize(
    ("size", "mask", "message"),
    [
        ((30, 41), None, "f.png is 41x30 px, but the calibration is for 40x30 px"),
        ((30, 40), np.ones((40, 30)), "the mask .*m.png is 30x40 px, the frame 40x30 px"),
        ((30, 40), np.zeros((30, 40)), "the mask .*m.png is empty: no pixel in it is brighter than half"),
    ],
)
def test_a_frame_that_does_not_fit(tmp_path, size, mask, message):
    write_image(tmp_path / "f.png", np.full(size, 0.5))
    if mask is not None:
        write_image(tmp_path / "m.png", mask)
    with pytest.raises(ValueError, match=message):
        el.read_frame(tmp_path / "f.png", CALIBRATION, None if mask is None else tmp_path / "m.png")


# Results ---------------------------------------------------------------------------------


def test_a_result_is_saved_whole(tmp_path, result):
    el.save_result(result, tmp_path / "a" / "b")
    assert contents(tmp_path / "a" / "b") == ["cloud.ply", "depth.npz", "overview.png", "report.json"]
    with np.load(tmp_path / "a/b/depth.npz", allow_pickle=False) as depth:
        for name in ("distance", "z", "normals"):
            np.testing.assert_allclose(depth[name], getattr(result, name), rtol=1e-6)
        np.testing.assert_array_equal(depth["mask"], result.mask)
        assert bool(depth["metric"]) is True
    report = json.loads((tmp_path / "a/b/report.json").read_text("utf-8"), parse_constant=pytest.fail)
    assert report["status"] == "CONVERGED"
    assert report["pixels"] == result.mask.sum()
    assert report["energy"] == result.energy == sum(report["terms"].values())
    known = result.distance[result.mask]
    assert list(report["distance"].values()) == pytest.approx([np.median(known), known.min(), known.max()])
    assert report["settings"]["solver"] == DEFAULT_SOLVER
    assert (report["unit"], report["metric"], report["scale"]) == ("mm", True, "gain")
    assert report["ended"] == result.status.value
    assert report["meaning"] == list(meaning(result))
    overview = np.asarray(Image.open(tmp_path / "a/b/overview.png").convert("L"))
    assert min(overview.shape) > 200
    assert overview.std() > 10


def test_relative_units_are_written_down(tmp_path, result):
    relative = replace(result, iterate=replace(result.iterate, problem=replace(result.problem, metric=False)))
    report = result_module.report(relative)
    assert (report["unit"], report["metric"], report["scale"]) == ("relative units", False, "none")
    el.save_result(relative, tmp_path)
    with np.load(tmp_path / "depth.npz", allow_pickle=False) as depth:
        assert bool(depth["metric"]) is False


def test_the_cloud_opens_in_open3d(tmp_path, result, open3d):
    el.save_result(result, tmp_path)
    cloud = open3d.io.read_point_cloud(str(tmp_path / "cloud.ply"))
    np.testing.assert_allclose(np.asarray(cloud.points), result.points[result.mask], rtol=1e-6, atol=1e-5)
    np.testing.assert_allclose(np.asarray(cloud.normals), result.normals[result.mask], atol=1e-6)
    colours = result.problem.picture[result.mask]
    np.testing.assert_allclose(np.asarray(cloud.colors), colours, atol=0.51 / 255)


def test_an_empty_cloud(tmp_path):
    write_cloud(tmp_path / "c.ply", *np.zeros((3, 0, 3)))
    assert b"element vertex 0\n" in (tmp_path / "c.ply").read_bytes()


# Whole or not at all -----------------------------------------------------------------------


def test_a_staged_folder_moves_in_when_the_block_succeeds(tmp_path):
    target = tmp_path / "new" / "deep"
    with staged_folder(target) as folder:
        (folder / "a.txt").write_text("1")
        assert contents(target) != ["a.txt"]
    assert contents(tmp_path) == ["new", "new/deep", "new/deep/a.txt"]


def half_written(folder, error=None):
    for name in ("a.txt", "b.txt"):
        (folder / name).write_text("1")
    if error is not None:
        raise error


@pytest.mark.parametrize("error", [ValueError, OSError, KeyboardInterrupt])
def test_a_staged_folder_leaves_nothing_of_a_failure(tmp_path, error):
    with pytest.raises(error), staged_folder(tmp_path / "new" / "deep") as folder:
        half_written(folder, error)
    assert contents(tmp_path) == []


@pytest.mark.parametrize("fails", [True, False])
def test_a_staged_folder_keeps_what_was_there(tmp_path, fails):
    (tmp_path / "old.txt").write_text("old")
    (tmp_path / "a.txt").write_text("old")
    try:
        with staged_folder(tmp_path) as folder:
            (folder / "a.txt").write_text("new")
            if fails:
                raise ValueError
    except ValueError:
        assert fails
    assert contents(tmp_path) == ["a.txt", "old.txt"]
    assert (tmp_path / "old.txt").read_text() == "old"
    assert (tmp_path / "a.txt").read_text() == ("old" if fails else "new")


@pytest.mark.parametrize("target", ["file", "file/x", "file/x/y", "new/" + 300 * "n"])
def test_a_folder_that_cannot_be_made(tmp_path, target):
    (tmp_path / "file").write_text("mine")
    with (
        pytest.raises(OSError, match=r"cannot write to the folder .*: \w"),
        staged_folder(tmp_path / target),
    ):
        pytest.fail("the block must not run")
    assert contents(tmp_path) == ["file"]


def test_a_name_taken_by_a_folder_leaves_the_others_unwritten(tmp_path):
    (tmp_path / "b.txt").mkdir()
    with pytest.raises(OSError, match=r"b\.txt"), staged_folder(tmp_path) as folder:
        half_written(folder)
    assert contents(tmp_path) == ["b.txt"]


def test_a_file_is_replaced_whole(tmp_path):
    path = tmp_path / "a.bin"
    for content in (b"first", b"2"):
        write_atomically(path, content)
        assert path.read_bytes() == content
    assert contents(tmp_path) == ["a.bin"]
    assert path.stat().st_mode & 0o777 == 0o644


@pytest.mark.parametrize("there", [True, False])
def test_a_full_disk_leaves_the_old_file(tmp_path, monkeypatch, there):
    path = tmp_path / "a.bin"
    if there:
        path.write_bytes(b"old")

    def full(self, content):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(OSError, match=r"cannot write .*a\.bin: No space left on device"):
        write_atomically(path, b"new")
    assert contents(tmp_path) == (["a.bin"] if there else [])
    assert not there or path.read_bytes() == b"old"


@pytest.mark.parametrize("function", ["save_depth", "write_cloud", "write_atomically"])
def test_a_result_on_a_full_disk_leaves_nothing(tmp_path, monkeypatch, result, function):
    def full(path, *content):
        path.write_bytes(b"half")
        raise OSError(f"cannot write {path.name}: No space left on device")

    monkeypatch.setattr(result_module, function, full)
    with pytest.raises(OSError, match="No space left"):
        el.save_result(result, tmp_path / "new")
    assert contents(tmp_path) == []


@pytest.mark.parametrize("limit", [1_000, 30_000])
def test_the_system_refuses_to_write_on(tmp_path, limit):
    """A limit on the size of files: `simulate` ends with one sentence and leaves nothing."""

    def limited():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    command = [sys.executable, "-m", "endolab", "simulate", "curved", "--width", "80", "--out", "new"]
    environment = os.environ | {"PYTHONPATH": str(Path(result_module.__file__).parents[2])}
    done = subprocess.run(
        command, cwd=tmp_path, env=environment, preexec_fn=limited, capture_output=True, text=True, timeout=60
    )
    assert done.returncode == 2
    assert done.stderr.startswith("endolab: cannot write ")
    assert done.stderr.endswith(": File too large\n")
    assert done.stderr.count("\n") == 1
    assert contents(tmp_path) == []

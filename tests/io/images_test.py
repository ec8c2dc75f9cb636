"""Pictures, masks and frames in files, against other programs."""

import struct
import zlib

import numpy as np
import pytest
import tifffile
from PIL import Image

import endolab as el
from endolab.io.images import read_image, read_mask, write_image

CALIBRATION = el.Calibration(el.Pinhole(40, 30, 20.0, 20.0, 19.5, 14.5), el.Photometry())


def png(path, stored, bits, size=None):
    """Write a PNG of 8 or 16 bits, grey, grey with alpha, RGB or RGBA, by its specification."""
    height, width = size or stored.shape[:2]
    kind = {1: 0, 2: 4, 3: 2, 4: 6}[1 if stored.ndim == 2 else stored.shape[2]]
    rows = stored.astype(f">u{bits // 8}").reshape(len(stored), -1)

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


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("channels", [(), (2,), (3,), (4,)], ids=["grey", "grey and alpha", "rgb", "rgba"])
def test_a_png_is_read_exactly(tmp_path, rng, bits, channels):
    stored = random_stored(rng, bits, channels)
    png(tmp_path / "a.png", stored, bits)
    image = read_image(tmp_path / "a.png")
    if channels == (2,):
        stored = stored[..., :1].repeat(3, axis=-1) if image.ndim == 3 else stored[..., 0]
    expected = stored[..., :3] if channels in ((3,), (4,)) else stored
    np.testing.assert_array_equal(image, expected / (2**bits - 1))


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("channels", [(), (3,)])
def test_a_tiff_is_read_exactly_and_a_written_picture_reads_back(tmp_path, rng, bits, channels):
    stored = random_stored(rng, bits, channels)
    tifffile.imwrite(tmp_path / "a.tiff", stored, photometric="rgb" if channels else "minisblack")
    write_image(tmp_path / "a.png", stored / (2**bits - 1), bits)
    for name in ("a.tiff", "a.png"):
        np.testing.assert_array_equal(read_image(tmp_path / name), stored / (2**bits - 1))
    if bits == 8:
        np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "a.png")), stored)
    write_image(tmp_path / "b.png", np.where(stored > 9, 1.7, -0.3), bits)
    np.testing.assert_array_equal(read_image(tmp_path / "b.png"), stored > 9)


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
    with pytest.raises(ValueError, match=r"a\.tiff: .* 8 or 16 bits"):
        read_image(tmp_path / "a.tiff")


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".bmp"])
def test_a_picture_that_is_cut_off_is_refused_and_nothing_is_printed(tmp_path, capfd, rng, suffix):
    path = tmp_path / f"a{suffix}"
    Image.fromarray(rng.integers(0, 256, (60, 80, 3)).astype(np.uint8)).save(path)
    whole = path.read_bytes()
    for count in (0, 8, 50, len(whole) // 2, len(whole) - 99):
        path.write_bytes(whole[:count])
        with pytest.raises(ValueError, match=rf"a\{suffix}: not a picture that can be read"):
            read_image(path)
    assert capfd.readouterr() == ("", "")
    for nothing in (tmp_path, tmp_path / "none.png"):
        with pytest.raises(FileNotFoundError, match="there is no such file"):
            read_image(nothing)


def test_a_bomb_is_refused_before_anything_is_decoded(tmp_path, monkeypatch):
    png(tmp_path / "bomb.png", np.zeros((1, 1), np.uint8), 8, size=(2**30, 2**30))
    with pytest.raises(ValueError, match=r"bomb\.png: not a picture"):
        read_image(tmp_path / "bomb.png")
    monkeypatch.setattr("psutil.virtual_memory", lambda: type("Memory", (), {"available": 10**6}))
    png(tmp_path / "large.png", np.zeros((1, 1), np.uint8), 8, size=(9000, 9000))
    with pytest.raises(MemoryError, match=r"large\.png: a picture of 9000x9000 px"):
        read_image(tmp_path / "large.png")


MASKS = {
    "one bit": Image.new("1", (4, 3), 1),
    "palette": Image.new("RGB", (4, 3), (255, 255, 255)).convert("P"),
    "alpha": Image.new("LA", (4, 3), (255, 0)),
    "colours and alpha": Image.new("RGBA", (4, 3), (255, 255, 255, 0)),
    "16 bits": Image.fromarray(np.full((3, 4), 65535, np.uint16)),
}


@pytest.mark.parametrize("name", MASKS)
def test_a_mask_may_be_stored_as_one_likes(tmp_path, name):
    MASKS[name].save(tmp_path / "m.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "m.png"), np.ones((3, 4), bool))


def test_a_mask_is_where_it_is_bright_and_a_frame_is_read_with_it(tmp_path, rng):
    write_image(tmp_path / "grey.png", np.array([[0.0, 0.49, 0.51, 1.0]]))
    write_image(tmp_path / "colour.png", np.array([[[0, 0, 0], [0.4, 0.4, 0.4], [0, 0.9, 0]]]))
    np.testing.assert_array_equal(read_mask(tmp_path / "grey.png"), [[False, False, True, True]])
    np.testing.assert_array_equal(read_mask(tmp_path / "colour.png"), [[False, False, True]])
    image, mask = rng.uniform(size=(30, 40, 3)), rng.uniform(size=(30, 40)) < 0.5
    write_image(tmp_path / "f.png", image, 16)
    write_image(tmp_path / "m.png", mask.astype(float))
    frame = el.read_frame(tmp_path / "f.png", CALIBRATION, tmp_path / "m.png")
    assert frame.name == "f.png"
    np.testing.assert_allclose(frame.image, image, atol=0.51 / 65535)
    np.testing.assert_array_equal(frame.mask, mask)
    assert el.read_frame(str(tmp_path / "f.png")).mask.all()


@pytest.mark.parametrize(
    ("size", "mask", "named"),
    [
        ((30, 41), None, r"f\.png .*41x30"),
        ((30, 40), np.ones((40, 30)), r"m\.png .*30x40"),
        ((30, 40), np.zeros((30, 40)), r"m\.png is empty"),
    ],
)
def test_a_frame_that_does_not_fit(tmp_path, size, mask, named):
    write_image(tmp_path / "f.png", np.full(size, 0.5))
    if mask is not None:
        write_image(tmp_path / "m.png", mask)
    with pytest.raises(ValueError, match=named):
        el.read_frame(tmp_path / "f.png", CALIBRATION, None if mask is None else tmp_path / "m.png")


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_a_picture_is_read_as_the_sensor_saw_it_however_it_is_marked(tmp_path, caplog, suffix, orientation):
    stored = np.zeros((16, 24), np.uint8)
    stored[:8, :8] = 255
    tags = Image.Exif()
    tags[274] = orientation
    Image.fromarray(stored).save(tmp_path / f"a.{suffix}", exif=tags)
    found = read_image(tmp_path / f"a.{suffix}")
    np.testing.assert_allclose(found, stored / 255, atol=0.1)
    assert (f"a.{suffix}" in caplog.text) is (orientation != 1)

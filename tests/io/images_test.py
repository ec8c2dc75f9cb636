"""Pictures, masks and frames in files, against other programs."""

import struct
import zlib

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image

import endolab as el
from endolab.io.images import read_image, read_mask, write_image

CALIBRATION = el.Calibration(el.Pinhole(40, 30, 20.0, 20.0, 19.5, 14.5), el.Photometry())


def chunk(name, content):
    whole = name + content
    return struct.pack(">I", len(content)) + whole + struct.pack(">I", zlib.crc32(whole))


def png(path, stored, between=b"", size=None, kind=None):
    """Write a PNG, grey, grey with alpha, RGB or RGBA, by its specification.

    `between` are chunks before the pixels; `kind` is a colour type that the channels do not tell.
    """
    height, width = size or stored.shape[:2]
    bits = 8 * stored.itemsize
    rows = stored.astype(f">u{stored.itemsize}").reshape(len(stored), -1)
    if kind is None:
        kind = {1: 0, 2: 4, 3: 2, 4: 6}[stored[0, 0].size]
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, kind, 0, 0, 0))
        + between
        + chunk(b"IDAT", zlib.compress(b"".join(b"\0" + row.tobytes() for row in rows)))
        + chunk(b"IEND", b"")
    )


def random_stored(rng, bits, channels):
    stored = rng.integers(0, 2**bits, (5, 7, *channels)).astype(f"u{bits // 8}")
    stored.flat[:2] = 0, 2**bits - 1
    return stored


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize(
    "channels", [(), (2,), (3,), (4,)], ids=["grey", "grey and alpha", "rgb", "rgba"]
)
def test_a_png_is_read_exactly(tmp_path, rng, bits, channels):
    stored = random_stored(rng, bits, channels)
    expected = {(2,): stored[..., 0], (4,): stored[..., :3]}.get(channels, stored)
    if channels in ((2,), (4,)):
        stored[..., -1] = 2**bits - 1
    png(tmp_path / "a.png", stored)
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), expected / (2**bits - 1))


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("channels", [(), (3,)])
def test_a_tiff_is_read_exactly_and_a_written_picture_reads_back(
    tmp_path, rng, bits, channels
):
    stored = random_stored(rng, bits, channels)
    expected = stored / (2**bits - 1)
    kind = "rgb" if channels else "minisblack"
    tifffile.imwrite(tmp_path / "a.tiff", stored, photometric=kind)
    write_image(tmp_path / "a.png", expected, bits)
    for name in ("a.tiff", "a.png"):
        np.testing.assert_array_equal(read_image(tmp_path / name), expected)
    write_image(tmp_path / "b.png", np.where(stored > 9, 1.7, -0.3), bits)
    np.testing.assert_array_equal(read_image(tmp_path / "b.png"), stored > 9)


@pytest.mark.parametrize("mode", ["L", "RGB"])
def test_a_jpeg_is_read_as_others_read_it(tmp_path, mode):
    row, column = np.indices((48, 64))
    colour = np.stack([row * 5, column * 4, 255 - row - column], axis=-1).astype(np.uint8)
    Image.fromarray(colour).convert(mode).save(tmp_path / "a.jpg", quality=95)
    expected = np.asarray(Image.open(tmp_path / "a.jpg")) / 255
    np.testing.assert_allclose(read_image(tmp_path / "a.jpg"), expected, atol=2 / 255)


@pytest.mark.parametrize("dtype", [np.float32, np.float64, np.int16])
def test_other_numbers_are_not_a_picture(tmp_path, dtype):
    tifffile.imwrite(tmp_path / "a.tiff", np.ones((4, 4), dtype))
    with pytest.raises(ValueError, match=r"a\.tiff: .* 8 or 16 bits"):
        read_image(tmp_path / "a.tiff")


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".bmp"])
def test_a_picture_that_is_cut_off_is_refused_and_nothing_is_printed(
    tmp_path, capfd, rng, suffix
):
    path = tmp_path / f"a{suffix}"
    Image.fromarray(rng.integers(0, 256, (60, 80, 3)).astype(np.uint8)).save(path)
    whole = path.read_bytes()
    least = 2 if suffix in (".png", ".jpg") else len(whole) // 3
    for count in (0, 50, len(whole) // 2, len(whole) - least):
        path.write_bytes(whole[:count])
        with pytest.raises(ValueError, match=rf"a\{suffix}: not a picture"):
            read_image(path)
    assert capfd.readouterr() == ("", "")
    for nothing in (tmp_path, tmp_path / "none.png"):
        with pytest.raises(FileNotFoundError, match="there is no such file"):
            read_image(nothing)


BESIDE = {
    "wrong sum": chunk(b"tEXt", b"Comment\0hello")[:-4] + b"abcd",
    "resolution": chunk(b"pHYs", bytes(9))[:-4] + b"abcd",
    "no animation": chunk(b"acTL", b"\0"),
    "not to be unpacked": chunk(b"zTXt", b"IDAT\0\0IEND"),
    "text": chunk(b"iTXt", b"IDAT\0\0IEND"),
}


@pytest.mark.parametrize("name", BESIDE)
def test_what_is_broken_beside_a_picture_says_nothing(tmp_path, caplog, capfd, rng, name):
    stored = random_stored(rng, 16, (3,))
    png(tmp_path / "a.png", stored, BESIDE[name])
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), stored / 65535)
    assert not caplog.text
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", [b"IDAT", b"tRNS", b"PLTE"])
def test_pixels_and_what_they_depend_on_must_be_whole(tmp_path, name):
    colours = chunk(b"PLTE", bytes(range(60, 90))) + chunk(b"tRNS", bytes(10))
    stored = np.arange(100, dtype=np.uint8).reshape(10, 10) % 10
    png(tmp_path / "a.png", stored, colours, kind=3)
    content = bytearray((tmp_path / "a.png").read_bytes())
    content[content.index(name) + 6] ^= 1
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(ValueError, match=r"a\.png: not a picture"):
        read_image(tmp_path / "a.png")


def test_a_bomb_is_refused_before_anything_is_decoded(tmp_path, monkeypatch):
    pixel = np.zeros((1, 1), np.uint8)
    png(tmp_path / "bomb.png", pixel, size=(2**30, 2**30))
    with pytest.raises(ValueError, match=r"bomb\.png: not a picture"):
        read_image(tmp_path / "bomb.png")
    monkeypatch.setattr(
        "psutil.virtual_memory", lambda: type("Memory", (), {"available": 10**6})
    )
    png(tmp_path / "large.png", pixel, size=(9000, 9000))
    with pytest.raises(MemoryError, match=r"large\.png: a picture of 9000x9000 px"):
        read_image(tmp_path / "large.png")


MASKS = {
    "one bit": Image.new("1", (4, 3), 1),
    "palette": Image.new("RGB", (4, 3), "white").convert("P"),
    "16 bits": Image.fromarray(np.full((3, 4), 65535, np.uint16)),
}


@pytest.mark.parametrize("name", MASKS)
def test_a_mask_may_be_stored_as_one_likes(tmp_path, name):
    MASKS[name].save(tmp_path / "m.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "m.png"), np.ones((3, 4), bool))


def test_a_mask_is_where_it_is_bright_and_a_frame_is_read_with_it(tmp_path, rng):
    write_image(tmp_path / "grey.png", np.array([[0.0, 0.49, 0.51, 1.0]]))
    write_image(tmp_path / "colour.png", np.array([[[0.4, 0.4, 0.4], [0, 0.9, 0]]]))
    assert read_mask(tmp_path / "grey.png").tolist() == [[False, False, True, True]]
    assert read_mask(tmp_path / "colour.png").tolist() == [[False, True]]
    image = rng.uniform(size=(30, 40, 3))
    mask = rng.uniform(size=(30, 40)) < 0.5
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
    given = None if mask is None else tmp_path / "m.png"
    if given is not None:
        write_image(given, mask)
    with pytest.raises(ValueError, match=named):
        el.read_frame(tmp_path / "f.png", CALIBRATION, given)


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif"])
@pytest.mark.parametrize("orientation", [1, 2, 6, 8])
def test_a_picture_is_read_as_the_sensor_saw_it_however_it_is_marked(
    tmp_path, caplog, suffix, orientation
):
    stored = np.zeros((16, 24), np.uint8)
    stored[:8, :8] = 255
    tags = Image.Exif()
    tags[274] = orientation
    path = tmp_path / f"a.{suffix}"
    Image.fromarray(stored).save(path, exif=tags)
    if suffix == "tif" and orientation != 1:
        with pytest.raises(ValueError, match=r"a\.tif is marked to be shown turned"):
            read_image(path)
        return
    np.testing.assert_allclose(read_image(path), stored / 255, atol=0.1)
    assert (f"a.{suffix}" in caplog.text) is (orientation != 1)


# What is transparent ---------------------------------------------------------------------
def with_alpha(path, kind, alpha):
    """Save a picture under an alpha in one of `KINDS`."""
    pixels = np.dstack([np.full((4, 5, 3), 90), alpha]).astype(np.uint8)
    if kind == "rgba png":
        png(path, pixels)
    elif kind == "rgba png 16":
        png(path, pixels.astype(np.uint16) * 257)
    elif kind == "la png":
        png(path, pixels[..., 2:])
    elif kind == "bmp":
        path.write_bytes(cv2.imencode(".bmp", pixels)[1].tobytes())
    else:
        tifffile.imwrite(path, pixels, photometric="rgb", extrasamples=["unassalpha"])


KINDS = ["rgba png", "rgba png 16", "la png", "bmp", "tiff"]


@pytest.mark.parametrize("kind", KINDS)
def test_a_picture_that_is_transparent_in_part_is_refused(tmp_path, kind):
    alpha = np.full((4, 5), 255)
    with_alpha(tmp_path / "a.img", kind, alpha)
    frame = el.read_frame(tmp_path / "a.img")
    assert frame.mask.all()
    np.testing.assert_allclose(frame.image, 90 / 255)
    alpha[1, 2] = 128
    with_alpha(tmp_path / "a.img", kind, alpha)
    for read in (el.read_frame, read_mask):
        with pytest.raises(ValueError, match=r"a\.img is transparent in part"):
            read(tmp_path / "a.img")


def test_a_grey_that_stands_for_nothing_is_refused(tmp_path):
    png(tmp_path / "a.png", np.zeros((4, 5), np.uint8), chunk(b"tRNS", b"\0\7"))
    with pytest.raises(ValueError, match=r"a\.png is transparent in part"):
        read_image(tmp_path / "a.png")


@pytest.mark.parametrize("bits", [9, 12, 16])
@pytest.mark.parametrize("shift", [False, True])
@pytest.mark.parametrize("suffix", ["png", "tiff"])
def test_fewer_bits_than_the_file_has_are_named(tmp_path, caplog, bits, shift, suffix):
    path = tmp_path / f"a.{suffix}"
    ramp = np.linspace(0, 2**bits - 1, 2000).reshape(40, 50).astype(np.uint16)
    cv2.imwrite(str(path), ramp << (16 - bits) if shift else ramp)
    el.read_frame(path)
    assert (f"{bits} of its 16 bits" in caplog.text) is (not shift and bits < 16)

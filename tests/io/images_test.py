"""Pictures, masks and frames in files, against other programs."""

import os
import struct
import zlib

import numpy as np
import pytest
import tifffile
from PIL import Image

import endolab as el
from endolab.io.images import read_image, read_mask, write_image

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


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("channels", [(), (3,), (4,)], ids=["grey", "rgb", "rgba"])
def test_a_png_and_a_tiff_are_read_exactly(tmp_path, rng, bits, channels):
    stored = random_stored(rng, bits, channels)
    options = {"photometric": "rgb"} if channels else {}
    png(tmp_path / "a.png", stored, bits)
    expected = stored[..., :3] if channels else stored
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), expected / (2**bits - 1))
    if channels == (4,):
        stored[..., 3] = 2**bits - 1
        options["extrasamples"] = ["unassalpha"]
    tifffile.imwrite(tmp_path / "a.tiff", stored, **options)
    np.testing.assert_array_equal(read_image(tmp_path / "a.tiff"), expected / (2**bits - 1))


@pytest.mark.parametrize("bits", [8, 16])
def test_a_grey_png_with_alpha_is_grey(tmp_path, rng, bits):
    stored = random_stored(rng, bits, (2,))
    png(tmp_path / "a.png", stored, bits)
    image = read_image(tmp_path / "a.png")
    for channel in np.moveaxis(image, -1, 0) if image.ndim == 3 else [image]:
        np.testing.assert_array_equal(channel, stored[..., 0] / (2**bits - 1))


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
    with pytest.raises(ValueError, match=r"a.tiff: .* 8 or 16 bits"):
        read_image(tmp_path / "a.tiff")


@pytest.mark.parametrize("content", [b"", b"hello", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff\xe0" + bytes(50)])
def test_what_is_not_a_picture_is_said_once(tmp_path, capfd, content):
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(ValueError, match=r"a\.png: not a picture that can be read"):
        read_image(tmp_path / "a.png")
    assert capfd.readouterr() == ("", "")
    with pytest.raises(FileNotFoundError, match=r"none\.png: there is no such file"):
        read_image(tmp_path / "none.png")
    with pytest.raises(OSError, match="cannot be read: Is a directory"):
        read_image(tmp_path)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif"])
def test_a_damaged_picture_is_said_once(tmp_path, capfd, rng, suffix):
    path = tmp_path / f"a{suffix}"
    Image.fromarray(rng.integers(0, 256, (60, 80, 3)).astype(np.uint8)).save(path)
    whole = path.read_bytes()
    for _ in range(100):
        damaged = bytearray(whole)
        place = int(rng.integers(len(damaged)))
        damaged[place : place + 3] = rng.bytes(3)
        path.write_bytes(damaged)
        try:
            assert read_image(path).ndim in (2, 3)
        except (ValueError, OSError, MemoryError) as error:
            assert str(error).startswith(f"{path}: ")  # noqa: PT017
    assert capfd.readouterr() == ("", "")


def huge(path, width, height):
    """Write a PNG that promises a size and holds nothing."""
    png(path, np.zeros((1, 1), np.uint8), 8)
    head = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    content = bytearray(path.read_bytes())
    content[12:33] = head + struct.pack(">I", zlib.crc32(head))
    path.write_bytes(content)


def test_a_size_is_refused_before_anything_is_decoded(tmp_path):
    huge(tmp_path / "huge.png", 20000, 20000)
    write_image(tmp_path / "f.png", np.full((30, 40), 0.5))
    undecodable = tmp_path / "huge.png"
    with pytest.raises(ValueError, match="is 20000x20000 px, but the calibration is for 40x30 px"):
        el.read_frame(undecodable, CALIBRATION)
    with pytest.raises(ValueError, match=r"the mask .*huge\.png is 20000x20000 px, the frame 40x30 px"):
        el.read_frame(tmp_path / "f.png", CALIBRATION, undecodable)
    huge(undecodable, 2**30, 2**30)
    sentence = r"huge\.png: a picture of 1073741824x1073741824 px needs about \d+\.\d GB of memory, .* free$"
    for read in (read_image, read_mask, el.read_frame):
        with pytest.raises(MemoryError, match=sentence):
            read(undecodable)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no pipes with names here")
def test_a_pipe_is_no_picture(tmp_path):
    os.mkfifo(tmp_path / "pipe.png")
    with pytest.raises(ValueError, match=r"pipe\.png: not a file"):
        read_image(tmp_path / "pipe.png")


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

"""Pictures, masks and frames in files, against other programs."""

import zlib

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image

import endolab as el
from endolab.io.images import read_image, read_mask, write_image
from endolab.io.video import is_sequence

WALL = np.add.outer(np.arange(40), np.arange(50)) + 60  # to 148
SHAPE = np.hypot(*np.indices((40, 50)) - np.array([[[20]], [[25]]])) < 18


def by_opencv(path, stored, how=()):
    order = [2, 1, 0, 3][: stored.shape[2]] if stored.ndim == 3 else slice(None)
    path.write_bytes(cv2.imencode(path.suffix, stored[..., order], how)[1].tobytes())


# Each format, layout and pixel type ------------------------------------------------------
@pytest.mark.parametrize(
    "kind",
    [
        *("8 png", "16 png", "8 tiff", "16 tiff", "8 bmp", "8 webp"),
        *("8 jp2", "16 jp2", "8 tga", "8 ppm", "12 ppm", "16 ppm"),
    ],
)
@pytest.mark.parametrize("channels", [(), (3,), (4,)])
def test_a_picture_is_read_as_it_is_stored(tmp_path, rng, kind, channels):
    bits, suffix = kind.split()
    most = 2 ** int(bits) - 1
    path = tmp_path / f"a.{suffix}"
    stored = rng.integers(0, most + 1, (48, 64, *channels))
    stored = stored.astype(np.uint8 if bits == "8" else np.uint16)
    stored[..., 3:] = most if channels else stored[..., 3:]
    if suffix == "tiff":
        tifffile.imwrite(path, stored, photometric="rgb" if channels else "minisblack")
    elif suffix == "ppm":
        stored = stored[..., :3] if channels else stored
        head = f"P{stored.ndim + 3} 64 48 {most}\n".encode()
        path.write_bytes(head + stored.astype(stored.dtype.newbyteorder(">")).tobytes())
    elif suffix in ("webp", "jp2", "tga") and bits == "8":
        how = {"lossless": True} if suffix == "webp" else {}
        Image.fromarray(stored).save(path, **how)
    else:
        by_opencv(path, stored, [cv2.IMWRITE_JPEG2000_COMPRESSION_X1000, 1000])
    assert not is_sequence(path)
    found = read_image(path)
    found = found[..., 0] if found.ndim > stored.ndim else found
    expected = stored[..., :3] if channels else stored
    np.testing.assert_allclose(found, expected / most, atol=1e-5)


@pytest.mark.parametrize("mode", ["L", "RGB", "CMYK"])
def test_a_jpeg_is_read_as_others_read_it(tmp_path, mode):
    Image.fromarray(WALL.astype(np.uint8)).convert(mode).save(tmp_path / "a.jpg")
    image = read_image(tmp_path / "a.jpg")
    first = image if mode == "L" else image[..., 0]
    np.testing.assert_allclose(first * 255, WALL, atol=4)


@pytest.mark.parametrize("bits", [8, 16])
def test_a_written_picture_reads_back(tmp_path, rng, bits):
    stored = rng.integers(0, 2**bits, (5, 7, 3)) / (2**bits - 1)
    for image in (stored, stored[..., 0], np.where(stored > 0.3, 1.7, -0.3)):
        write_image(tmp_path / "a.png", image, bits)
        expected = np.clip(image, 0, 1)
        np.testing.assert_array_equal(read_image(tmp_path / "a.png"), expected)


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif"])
@pytest.mark.parametrize("orientation", [1, 3, 6, 8])
def test_a_picture_is_read_as_the_sensor_saw_it_however_it_is_marked(
    tmp_path, caplog, suffix, orientation
):
    stored = np.zeros((16, 24), np.uint8)
    stored[:8, :8] = 255
    tags = Image.Exif()
    tags[274] = orientation
    Image.fromarray(stored).save(tmp_path / f"a.{suffix}", exif=tags)
    found = read_image(tmp_path / f"a.{suffix}")
    np.testing.assert_allclose(found, stored / 255, atol=0.1)
    assert (f"a.{suffix}" in caplog.text) is (orientation != 1)


# What is damaged is refused --------------------------------------------------------------
HOW_SAVED = {
    "png": {},
    "jpg": {"quality": 95},
    "progressive.jpg": {"progressive": True},
    "restarts.jpg": {"restart_marker_rows": 1},
    "tif": {},
    "lzw.tif": {"compression": "tiff_lzw"},
    "bmp": {},
    "webp": {},
    "gif": {},
    "jp2": {},
    "ppm": {},
}
REFUSED = pytest.raises(ValueError, match=r"^[^\n]*: not a whole picture")


@pytest.mark.parametrize("how", HOW_SAVED)
@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.999])
def test_a_picture_that_is_cut_off_is_refused_and_nothing_is_printed(
    tmp_path, capfd, rng, how, share
):
    path = tmp_path / f"a.{how}"
    noise = rng.integers(0, 256, (60, 80, 3)).astype(np.uint8)
    Image.fromarray(noise).save(path, **HOW_SAVED[how])
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content)) - 5])
    with REFUSED:
        read_image(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", [b"IHDR", b"IDAT", b"tRNS", b"PLTE"])
def test_a_wrong_checksum_is_refused(tmp_path, name):
    path = tmp_path / "a.png"
    Image.fromarray(WALL.astype(np.uint8)).convert("P").save(path, transparency=9)
    content = path.read_bytes()
    path.write_bytes(content.replace(name, name[:3] + b"X", 1))
    with REFUSED:
        read_image(path)


def test_a_bomb_is_refused_before_anything_is_decoded(tmp_path, monkeypatch):
    path = tmp_path / "a.png"
    Image.new("L", (1, 1)).save(path)
    content = path.read_bytes()

    def promise(size):
        head = b"IHDR" + 2 * size.to_bytes(4) + content[24:29]
        path.write_bytes(
            content[:12] + head + zlib.crc32(head).to_bytes(4) + content[33:]
        )

    promise(2**30)
    with REFUSED:
        read_image(path)
    none = type("Memory", (), {"available": 10**6})
    monkeypatch.setattr("psutil.virtual_memory", lambda: none)
    promise(9000)
    with pytest.raises(MemoryError, match=r"a\.png: a picture of 9000x9000 px"):
        read_image(path)


# Masks, and what is transparent ----------------------------------------------------------
MASKS = {
    "one bit": Image.new("1", (4, 3), 1),
    "palette": Image.new("RGB", (4, 3), (255, 255, 255)).convert("P"),
    "16 bits": Image.fromarray(np.full((3, 4), 65535, np.uint16)),
}


@pytest.mark.parametrize("name", MASKS)
def test_a_mask_may_be_stored_as_one_likes(tmp_path, name):
    MASKS[name].save(tmp_path / "m.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "m.png"), np.ones((3, 4), bool))


def save(path, kind, below, alpha):
    """Save the wall under an alpha: of a layout, with something below what is transparent."""
    pixels = np.dstack([np.where(alpha == 255, WALL, below)] * 3 + [alpha])
    pixels = pixels.astype(np.uint8)
    match kind:
        case "rgba":
            by_opencv(path, pixels)
        case "rgba16":
            by_opencv(path, pixels.astype(np.uint16) * 257)
        case "la":
            Image.merge("LA", Image.fromarray(pixels).split()[::3]).save(path)
        case "tiff":
            how = {"photometric": "rgb", "extrasamples": ["unassalpha"]}
            tifffile.imwrite(path, pixels, **how)
        case _:  # one colour, or one of a palette, that is none
            pixels[alpha < 255, :3] = 7
            picture = Image.fromarray(pixels[..., 0])
            if kind == "P":
                picture.putpalette(np.repeat(np.arange(256), 3).tolist())
            picture = picture.convert(kind)
            picture.save(path, transparency=(7, 7, 7) if kind == "RGB" else 7)


@pytest.mark.parametrize("below", [255, 0, 80])
@pytest.mark.parametrize("kind", ["rgba", "rgba16", "la", "tiff", "L", "RGB", "P"])
def test_transparent_pixels_are_no_wall_whatever_is_below(
    tmp_path, caplog, kind, below
):
    """Nor are those that are partly transparent, as they are mixed."""
    alpha = np.where(SHAPE, 255, 0)
    alpha[:3] = 128
    save(tmp_path / "a.png", kind, below, alpha)
    frame = el.read_frame(tmp_path / "a.png")
    np.testing.assert_array_equal(frame.mask, SHAPE & (alpha == 255))
    first = frame.image if frame.image.ndim == 2 else frame.image[..., 0]
    np.testing.assert_allclose(first[frame.mask], WALL[frame.mask] / 255, atol=1e-9)
    assert "transparent" in caplog.text
    assert not read_image(tmp_path / "a.png")[
        alpha == 0
    ].any()  # no white paper, either


DRAWN = np.where(np.indices(SHAPE.shape)[1] < 25, 255, 0)  # the left half
CUT_OUT = {
    "white": (np.full(SHAPE.shape, 255), SHAPE),
    "black": (np.zeros(SHAPE.shape), SHAPE),
    "cut out of a frame": (WALL, SHAPE),
    "drawn": (DRAWN, SHAPE & (DRAWN > 0)),
}


@pytest.mark.parametrize("name", CUT_OUT)
def test_a_mask_that_is_kept_in_alpha(tmp_path, name):
    grey, expected = CUT_OUT[name]
    pixels = np.dstack([grey, grey, grey, np.where(SHAPE, 255, 0)]).astype(np.uint8)
    by_opencv(tmp_path / "m.png", pixels)
    np.testing.assert_array_equal(read_mask(tmp_path / "m.png"), expected)


def test_a_mask_does_not_bring_back_what_is_transparent(tmp_path):
    save(tmp_path / "a.png", "rgba", 255, np.where(SHAPE, 255, 0))
    write_image(tmp_path / "m.png", DRAWN / 255)
    mask = el.read_frame(tmp_path / "a.png", mask=tmp_path / "m.png").mask
    np.testing.assert_array_equal(mask, SHAPE & (DRAWN > 0))

"""Pictures, masks and frames in files, against other programs."""

import io
import struct
import zlib

import numpy as np
import pytest
import tifffile
from PIL import Image

import endolab as el
from endolab.io.images import read_image, read_mask, write_image

WALL = np.add.outer(np.arange(40), np.arange(50))  # + 60: from 60 to 148
SHAPE = np.hypot(*np.indices((40, 50)) - np.array([[[20]], [[25]]])) < 18


def chunk(name, content):
    whole = name + content
    return (
        struct.pack(">I", len(content)) + whole + struct.pack(">I", zlib.crc32(whole))
    )


def png(path, stored, bits, size=None, between=b"", kind=None):
    """Write a PNG of 8 or 16 bits, grey, grey with alpha, RGB or RGBA, by its specification."""
    height, width = size or stored.shape[:2]
    if kind is None:
        kind = {1: 0, 2: 4, 3: 2, 4: 6}[1 if stored.ndim == 2 else stored.shape[2]]
    rows = stored.astype(f">u{bits // 8}").reshape(len(stored), -1)
    path.write_bytes(
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, bits, kind, 0, 0, 0))
        + between
        + chunk(b"IDAT", zlib.compress(b"".join(b"\0" + row.tobytes() for row in rows)))
        + chunk(b"IEND", b"")
    )


# Each format, layout and pixel type ------------------------------------------------------
@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("suffix", ["png", "tiff", "bmp", "jpg"])
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_a_picture_is_read_as_it_is_stored(tmp_path, rng, suffix, bits, channels):
    path = tmp_path / f"a.{suffix}"
    stored = rng.integers(0, 2**bits, (16, 24, channels)).astype(f"u{bits // 8}")
    stored[..., 3:] = 2**bits - 1
    plain = np.squeeze(stored)
    if suffix == "png":
        png(path, plain, bits)
    elif suffix == "tiff":
        tifffile.imwrite(
            path, plain, photometric="minisblack" if channels == 1 else "rgb"
        )
    elif bits == 8 and (suffix, channels) != ("jpg", 4):
        stored[:] = stored[:1, :1]  # which JPEG keeps, but for a level
        Image.fromarray(np.squeeze(stored)).save(path)
    else:
        return
    expected = np.squeeze(stored[..., :3]) / (2**bits - 1)
    np.testing.assert_allclose(
        read_image(path), expected, atol=2 / 255 * (suffix == "jpg")
    )


@pytest.mark.parametrize("bits", [8, 16])
def test_a_written_picture_reads_back(tmp_path, rng, bits):
    stored = rng.integers(0, 2**bits, (5, 7, 3))
    for image in (stored, stored[..., 0]):
        write_image(tmp_path / "a.png", image / (2**bits - 1), bits)
        np.testing.assert_array_equal(
            read_image(tmp_path / "a.png"), image / (2**bits - 1)
        )
    write_image(tmp_path / "b.png", np.where(stored > 9, 1.7, -0.3), bits)
    np.testing.assert_array_equal(read_image(tmp_path / "b.png"), stored > 9)


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif"])
@pytest.mark.parametrize("orientation", range(1, 9))
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


@pytest.mark.parametrize("bits", [10, 12, 16])
def test_fewer_bits_than_the_file_has_are_named(tmp_path, caplog, bits):
    ramp = np.linspace(0, 2**bits - 1, 2000).reshape(40, 50).astype(np.uint16)
    for name, stored in {"low": ramp, "high": ramp << (16 - bits)}.items():
        png(tmp_path / f"{name}.png", stored, 16)
        caplog.clear()
        el.read_frame(tmp_path / f"{name}.png")
        is_low = name == "low" and bits < 16
        assert (f"{bits} of its 16 bits" in caplog.text) is is_low


# What is damaged is refused --------------------------------------------------------------
HOW_SAVED = {
    "png": {},
    "jpg": {"quality": 95},
    "progressive.jpg": {"progressive": True},
    "restarts.jpg": {"restart_marker_rows": 1},
    "tif": {},
    "lzw.tif": {"compression": "tiff_lzw"},
    "bmp": {},
}


@pytest.mark.parametrize("how", HOW_SAVED)
@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.999, None])
def test_a_picture_that_is_cut_off_is_refused_and_nothing_is_printed(
    tmp_path, capfd, rng, how, share
):
    path = tmp_path / f"a.{how}"
    noise = rng.integers(0, 256, (60, 80, 3)).astype(np.uint8)
    Image.fromarray(noise).save(path, **HOW_SAVED[how])
    content = path.read_bytes()
    # None is of a JPEG without its end, whose last rows decoders fill in.
    path.write_bytes(content[: -5 if share is None else int(share * len(content))])
    with pytest.raises(ValueError, match=rf"a\.{how}: not a whole picture"):
        read_image(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", [b"IHDR", b"IDAT", b"tRNS", b"PLTE"])
def test_a_wrong_checksum_is_refused(tmp_path, name):
    between = chunk(b"PLTE", bytes(range(60, 90))) + chunk(b"tRNS", bytes(10))
    stored = np.arange(100, dtype=np.uint8).reshape(10, 10) % 10
    png(tmp_path / "a.png", stored, 8, between=between, kind=3)
    content = bytearray((tmp_path / "a.png").read_bytes())
    content[content.index(name) + 6] ^= 1
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(ValueError, match=r"a\.png: not a whole picture"):
        read_image(tmp_path / "a.png")


def test_a_bomb_is_refused_before_anything_is_decoded(tmp_path, monkeypatch):
    png(tmp_path / "bomb.png", np.zeros((1, 1), np.uint8), 8, size=(2**30, 2**30))
    with pytest.raises(ValueError, match=r"bomb\.png: not a whole picture"):
        read_image(tmp_path / "bomb.png")
    none = type("Memory", (), {"available": 10**6})
    monkeypatch.setattr("psutil.virtual_memory", lambda: none)
    png(tmp_path / "large.png", np.zeros((1, 1), np.uint8), 8, size=(9000, 9000))
    with pytest.raises(MemoryError, match=r"large\.png: a picture of 9000x9000 px"):
        read_image(tmp_path / "large.png")


# Masks, and what is transparent ----------------------------------------------------------
MASKS = {
    "one bit": Image.new("1", (4, 3), 1),
    "palette": Image.new("RGB", (4, 3), (255, 255, 255)).convert("P"),
    "alpha": Image.new("LA", (4, 3), (255, 255)),
    "colours and alpha": Image.new("RGBA", (4, 3), (255, 255, 255, 255)),
    "16 bits": Image.fromarray(np.full((3, 4), 65535, np.uint16)),
}


@pytest.mark.parametrize("name", MASKS)
def test_a_mask_may_be_stored_as_one_likes(tmp_path, name):
    MASKS[name].save(tmp_path / "m.png")
    np.testing.assert_array_equal(read_mask(tmp_path / "m.png"), np.ones((3, 4), bool))


def test_a_frame_is_read_with_its_mask(tmp_path, rng):
    image = rng.uniform(size=(30, 40, 3))
    mask = rng.uniform(size=(30, 40))
    write_image(tmp_path / "f.png", image, 16)
    write_image(tmp_path / "m.png", mask, 16)
    frame = el.read_frame(tmp_path / "f.png", mask=tmp_path / "m.png")
    assert frame.name == "f.png"
    np.testing.assert_allclose(frame.image, image, atol=0.51 / 65535)
    np.testing.assert_array_equal(frame.mask, mask > 0.5)
    assert el.read_frame(str(tmp_path / "f.png")).mask.all()


def save(path, kind, below, alpha):
    """Save the wall under an alpha: of a layout, with something below what is transparent."""
    bits = 16 if "16" in kind else 8
    most = 2**bits - 1
    colours = np.dstack([(WALL + 60 + 10 * c) * (most // 255) for c in range(3)])
    colours[alpha < 255] = {"white": most, "black": 0, "grey": most // 3}[below]
    pixels = np.dstack([colours, alpha * (most // 255)]).astype(f"u{bits // 8}")
    if kind.startswith("rgba"):
        png(path, pixels, bits)
    elif kind.startswith("la"):
        png(path, pixels[..., [0, 3]], bits)
    elif kind.startswith("tiff"):
        kinds = {"photometric": "rgb", "extrasamples": [kind.split()[-1]]}
        tifffile.imwrite(path, pixels, **kinds)
    elif kind == "palette":
        greys = chunk(b"PLTE", np.repeat(np.arange(256), 3).astype(np.uint8).tobytes())
        clear = chunk(b"tRNS", bytes([255] * 255 + [0]))
        stored = np.where(alpha < 255, 255, pixels[..., 0])
        png(path, stored, 8, between=greys + clear, kind=3)
    else:  # one colour that is none
        pixels[alpha < 255] = 7
        stored = pixels[..., 0] if kind == "grey key" else pixels[..., :3]
        count = 1 if kind == "grey key" else 3
        between = chunk(b"tRNS", struct.pack(">H", 7) * count)
        png(path, stored, bits, between=between)


ALPHAS = ["rgba8", "rgba16", "la8", "la16", "tiff unassalpha", "tiff16 unassalpha"]
KEYS = ["grey key", "rgb key", "rgb16 key", "palette", "tiff assocalpha"]


@pytest.mark.parametrize("below", ["white", "black", "grey"])
@pytest.mark.parametrize("kind", ALPHAS + KEYS)
def test_transparent_pixels_are_no_wall_whatever_is_below(
    tmp_path, caplog, kind, below
):
    save(tmp_path / "a.img", kind, below, np.where(SHAPE, 255, 0))
    frame = el.read_frame(tmp_path / "a.img")
    np.testing.assert_array_equal(frame.mask, SHAPE)
    first = frame.image if frame.image.ndim == 2 else frame.image[..., 0]
    np.testing.assert_allclose(first[SHAPE], (WALL[SHAPE] + 60) / 255, atol=1e-9)
    assert "transparent" in caplog.text
    assert not read_image(tmp_path / "a.img")[~SHAPE].any()  # no white paper, either


@pytest.mark.parametrize("kind", ALPHAS)
def test_what_is_partly_transparent_is_left_out_as_it_is_mixed(tmp_path, kind):
    alpha = np.full(WALL.shape, 255)
    alpha[10:20, 10:20] = 128
    save(tmp_path / "a.img", kind, "grey", alpha)
    np.testing.assert_array_equal(el.read_frame(tmp_path / "a.img").mask, alpha == 255)


@pytest.mark.parametrize("opaque", [255, 65280, 65535])
def test_an_alpha_that_is_full_everywhere_says_nothing_whatever_its_unit(
    tmp_path, caplog, opaque
):
    stored = np.dstack([(WALL + 60) * 256] * 3 + [np.full(WALL.shape, opaque)])
    png(tmp_path / "a.png", stored, 16)
    frame = el.read_frame(tmp_path / "a.png")
    assert frame.mask.all()
    np.testing.assert_array_equal(frame.image, stored[..., :3] / 65535)
    assert not caplog.text


DRAWN = np.where(np.indices(SHAPE.shape)[1] < 25, 255, 0)  # the left half
CUT_OUT = {
    "white": (np.full(SHAPE.shape, 255), SHAPE),
    "black": (np.zeros(SHAPE.shape), SHAPE),
    "cut out of a dark frame": (WALL, SHAPE),
    "drawn": (DRAWN, SHAPE & (DRAWN > 0)),
}


@pytest.mark.parametrize("name", CUT_OUT)
def test_a_mask_that_is_kept_in_alpha(tmp_path, name):
    grey, expected = CUT_OUT[name]
    pixels = np.dstack([grey, grey, grey, np.where(SHAPE, 255, 0)]).astype(np.uint8)
    png(tmp_path / "m.png", pixels, 8)
    np.testing.assert_array_equal(read_mask(tmp_path / "m.png"), expected)


def test_a_mask_does_not_bring_back_what_is_transparent(tmp_path):
    save(tmp_path / "a.png", "rgba8", "white", np.where(SHAPE, 255, 0))
    write_image(tmp_path / "m.png", DRAWN / 255)
    mask = el.read_frame(tmp_path / "a.png", mask=tmp_path / "m.png").mask
    np.testing.assert_array_equal(mask, SHAPE & (DRAWN > 0))


def test_numbers_that_are_no_picture(tmp_path):
    for dtype in (np.float32, np.int16, np.int32):
        stream = io.BytesIO()
        tifffile.imwrite(stream, np.ones((4, 4), dtype))
        (tmp_path / "a.tiff").write_bytes(stream.getvalue())
        with pytest.raises(ValueError, match=r"a\.tiff: .* 8 or 16 bits"):
            read_image(tmp_path / "a.tiff")

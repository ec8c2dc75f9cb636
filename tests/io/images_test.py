"""Pictures, masks and frames in files, against other programs."""

import io
import struct
import zlib

import cv2
import numpy as np
import pytest
import tifffile
from PIL import Image

import endolab as el
from endolab.io.images import read_image, read_mask, write_image

CALIBRATION = el.Calibration(
    el.Pinhole(40, 30, 20.0, 20.0, 19.5, 14.5), el.Photometry()
)


def chunk(name, content):
    whole = name + content
    return (
        struct.pack(">I", len(content)) + whole + struct.pack(">I", zlib.crc32(whole))
    )


def png(path, stored, bits, size=None, between=b"", kind=None):
    """Write a PNG of 8 or 16 bits, grey, grey with alpha, RGB or RGBA, by its specification.

    `between` are chunks before the pixels; `kind` is a colour type that the channels do not tell.
    """
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
    expected = stored
    if channels in ((2,), (4,)):
        stored[..., -1] = 2**bits - 1
        expected = stored[..., 0] if channels == (2,) else stored[..., :3]
    png(tmp_path / "a.png", stored, bits)
    np.testing.assert_array_equal(
        read_image(tmp_path / "a.png"), expected / (2**bits - 1)
    )


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("channels", [(), (3,)])
def test_a_tiff_is_read_exactly_and_a_written_picture_reads_back(
    tmp_path, rng, bits, channels
):
    stored = random_stored(rng, bits, channels)
    tifffile.imwrite(
        tmp_path / "a.tiff", stored, photometric="rgb" if channels else "minisblack"
    )
    write_image(tmp_path / "a.png", stored / (2**bits - 1), bits)
    for name in ("a.tiff", "a.png"):
        np.testing.assert_array_equal(
            read_image(tmp_path / name), stored / (2**bits - 1)
        )
    if bits == 8:
        np.testing.assert_array_equal(
            np.asarray(Image.open(tmp_path / "a.png")), stored
        )
    write_image(tmp_path / "b.png", np.where(stored > 9, 1.7, -0.3), bits)
    np.testing.assert_array_equal(read_image(tmp_path / "b.png"), stored > 9)


@pytest.mark.parametrize("mode", ["L", "RGB"])
def test_a_jpeg_is_read_as_others_read_it(tmp_path, mode):
    row, column = np.indices((48, 64))
    colour = np.stack([row * 5, column * 4, 255 - row - column], axis=-1).astype(
        np.uint8
    )
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
def test_a_picture_of_which_too_little_is_there_is_refused_and_nothing_is_printed(
    tmp_path, capfd, rng, suffix
):
    path = tmp_path / f"a{suffix}"
    Image.fromarray(rng.integers(0, 256, (60, 80, 3)).astype(np.uint8)).save(path)
    whole = path.read_bytes()
    for count in (0, 8, 50, len(whole) // 2, int(0.7 * len(whole))):
        path.write_bytes(whole[:count])
        with pytest.raises(
            ValueError,
            match=rf"a\{suffix}( is damaged: only \d+ of its 60 rows|: not a picture)",
        ):
            read_image(path)
    assert capfd.readouterr() == ("", "")
    for nothing in (tmp_path, tmp_path / "none.png"):
        with pytest.raises(FileNotFoundError, match="there is no such file"):
            read_image(nothing)


HOW_SAVED = {
    "png": ("PNG", {}),
    "jpg": ("JPEG", {"quality": 95, "subsampling": 0}),
    "small colours.jpg": ("JPEG", {"quality": 90}),
    "progressive.jpg": ("JPEG", {"progressive": True}),
    "restarts.jpg": ("JPEG", {"restart_marker_rows": 1}),
}


@pytest.mark.parametrize("mode", ["L", "RGB"])
@pytest.mark.parametrize("share", [0.98, 0.999, None], ids=["98 %", "99.9 %", "no end"])
@pytest.mark.parametrize("how", HOW_SAVED)
def test_rows_that_are_cut_off_are_no_wall_and_a_warning_says_so(
    tmp_path, caplog, rng, how, share, mode
):
    row, column = np.indices((240, 320))
    smooth = np.stack(
        [90 + 40 * np.sin(column / 30) + row / 4, 60 + row / 5, 200 - column / 4],
        axis=-1,
    )
    whole = Image.fromarray(
        np.clip(smooth + rng.normal(0, 3, smooth.shape), 0, 255).astype(np.uint8)
    ).convert(mode)
    form, options = HOW_SAVED[how]
    stream = io.BytesIO()
    whole.save(stream, form, **options)
    content = stream.getvalue()
    path = tmp_path / f"a.{how}"
    path.write_bytes(content)
    expected = read_image(path)
    assert not caplog.text
    path.write_bytes(
        content[:-2] if share is None else content[: int(share * len(content))]
    )
    frame = el.read_frame(path)
    assert "is damaged" in caplog.text
    assert frame.mask.mean() > (0.8 if share else 0.99)
    assert frame.mask[-1].all() == (share is None)
    np.testing.assert_array_equal(frame.image[frame.mask], expected[frame.mask])
    if share:
        assert not frame.image[-1].any()  # not the grey that decoders fill in


BESIDE = {
    "wrong sum": chunk(b"tEXt", b"Comment\0hello")[:-4] + b"abcd",
    "too long": struct.pack(">I", 99) + chunk(b"tEXt", b"Comment\0hello")[4:],
    "too short": struct.pack(">I", 3) + chunk(b"tEXt", b"Comment\0hello")[4:],
    "endless": struct.pack(">I", 2**31 + 9) + chunk(b"iTXt", b"Comment\0hello")[4:],
    "resolution": chunk(b"pHYs", bytes(9))[:-4] + b"abcd",
    "no animation": chunk(b"acTL", b"\0"),
}


@pytest.mark.parametrize("name", BESIDE)
def test_a_picture_with_a_broken_chunk_beside_it_is_read_with_a_warning(
    tmp_path, caplog, capfd, rng, name
):
    stored = random_stored(rng, 16, (3,))
    png(tmp_path / "a.png", stored, 16, between=BESIDE[name])
    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), stored / 65535)
    assert "a.png is damaged" in caplog.text
    assert capfd.readouterr() == ("", "")


def test_a_text_that_cannot_be_unpacked_says_nothing(tmp_path, caplog, capfd, rng):
    stored = random_stored(rng, 8, (3,))
    for text in (b"zTXt", b"iTXt", b"tEXt"):
        png(tmp_path / "a.png", stored, 8, between=chunk(text, b"IDAT\0\0IEND"))
        np.testing.assert_array_equal(read_image(tmp_path / "a.png"), stored / 255)
    assert not caplog.text
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", [b"IDAT", b"tRNS", b"PLTE"])
def test_pixels_and_what_they_depend_on_must_be_whole(tmp_path, name):
    colours = chunk(b"PLTE", bytes(range(60, 90))) + chunk(
        b"tRNS", bytes([0] * 5 + [255] * 5)
    )
    png(
        tmp_path / "a.png",
        np.arange(100, dtype=np.uint8).reshape(10, 10) % 10,
        8,
        between=colours,
        kind=3,
    )
    content = bytearray((tmp_path / "a.png").read_bytes())
    content[content.index(name) + 6] ^= 1
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(ValueError, match=r"a\.png: not a picture"):
        read_image(tmp_path / "a.png")


def test_a_bomb_is_refused_before_anything_is_decoded(tmp_path, monkeypatch):
    png(tmp_path / "bomb.png", np.zeros((1, 1), np.uint8), 8, size=(2**30, 2**30))
    with pytest.raises(ValueError, match=r"bomb\.png: not a picture"):
        read_image(tmp_path / "bomb.png")
    monkeypatch.setattr(
        "psutil.virtual_memory", lambda: type("Memory", (), {"available": 10**6})
    )
    png(tmp_path / "large.png", np.zeros((1, 1), np.uint8), 8, size=(9000, 9000))
    with pytest.raises(MemoryError, match=r"large\.png: a picture of 9000x9000 px"):
        read_image(tmp_path / "large.png")


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


def test_a_mask_is_where_it_is_bright_and_a_frame_is_read_with_it(tmp_path, rng):
    write_image(tmp_path / "grey.png", np.array([[0.0, 0.49, 0.51, 1.0]]))
    write_image(
        tmp_path / "colour.png", np.array([[[0, 0, 0], [0.4, 0.4, 0.4], [0, 0.9, 0]]])
    )
    np.testing.assert_array_equal(
        read_mask(tmp_path / "grey.png"), [[False, False, True, True]]
    )
    np.testing.assert_array_equal(
        read_mask(tmp_path / "colour.png"), [[False, False, True]]
    )
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
    if mask is not None:
        write_image(tmp_path / "m.png", mask)
    with pytest.raises(ValueError, match=named):
        el.read_frame(
            tmp_path / "f.png",
            CALIBRATION,
            None if mask is None else tmp_path / "m.png",
        )


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


# What is transparent ---------------------------------------------------------------------
# + 60: from 60 to 148, and nowhere 0 or 255.
WALL = np.add.outer(np.arange(40), np.arange(50))
SHAPE = np.hypot(*np.indices((40, 50)) - np.array([[[20]], [[25]]])) < 18
SHAPE[18:22, 20:28] = False  # within


def with_alpha(bits, channels, below, alpha):
    """Stored values with alpha, white or black or something where that is not full."""
    most = 2**bits - 1
    colours = np.dstack(
        [(WALL + 60 + 10 * c) * (most // 255) for c in range(channels - 1)]
    )
    colours[alpha < 255] = {"white": most, "black": 0, "grey": most // 3}[below]
    return np.dstack([colours, alpha.astype(int) * (most // 255)]).astype(
        f"u{bits // 8}"
    )


def bmp_of_40_bytes(pixels):
    """Write a BMP as most programs do, which says nothing of alpha."""
    content = pixels[::-1, :, [2, 1, 0, 3]].tobytes()
    head = struct.pack("<IiiHHIIiiII", 40, 50, 40, 1, 32, 0, len(content), 0, 0, 0, 0)
    return struct.pack("<2sIII", b"BM", 54 + len(content), 0, 54) + head + content


def save(path, kind, below, alpha):
    """Save the wall under an alpha in one of `KINDS`."""
    eight = with_alpha(8, 4, below, alpha)
    if kind in ("la8", "la16", "rgba8", "rgba16"):
        bits = 16 if kind.endswith("16") else 8
        png(path, with_alpha(bits, 2 if kind[0] == "l" else 4, below, alpha), bits)
    elif kind in ("grey key 8", "grey key 16", "rgb key 8", "rgb key 16"):
        bits = int(kind.split()[-1])
        count = 1 if kind[0] == "g" else 3
        stored = with_alpha(bits, count + 1, below, alpha)[..., :-1]
        stored[alpha < 255] = 7  # else there is none
        between = chunk(b"tRNS", struct.pack(">H", 7) * count)
        png(path, stored[..., 0] if count == 1 else stored, bits, between=between)
    elif kind == "palette":
        colours = chunk(
            b"PLTE", np.repeat(np.arange(256), 3).astype(np.uint8).tobytes()
        )
        clear = chunk(b"tRNS", bytes([255] * 255 + [0]))
        png(
            path,
            np.where(alpha < 255, 255, eight[..., 0]).astype(np.uint8),
            8,
            between=colours + clear,
            kind=3,
        )
    elif kind == "plain bmp":
        path.write_bytes(bmp_of_40_bytes(eight))
    elif kind == "bmp":
        path.write_bytes(cv2.imencode(".bmp", eight[..., [2, 1, 0, 3]])[1].tobytes())
    elif kind == "grey tiff":
        Image.fromarray(with_alpha(8, 2, below, alpha), "LA").save(path, "TIFF")
    else:
        pixels = with_alpha(16 if "16" in kind else 8, 4, below, alpha)
        tifffile.imwrite(
            path, pixels, photometric="rgb", extrasamples=[kind.split()[-1]]
        )


KINDS = [
    "rgba8",
    "rgba16",
    "la8",
    "la16",
    "grey key 8",
    "grey key 16",
    "rgb key 8",
    "rgb key 16",
    "palette",
    "plain bmp",
    "bmp",
    "grey tiff",
    "tiff unassalpha",
    "tiff assocalpha",
    "tiff 16 unassalpha",
]


@pytest.mark.parametrize("below", ["white", "black", "grey"])
@pytest.mark.parametrize("kind", KINDS)
def test_transparent_pixels_are_no_wall_whatever_is_below(
    tmp_path, caplog, kind, below
):
    save(tmp_path / "a.img", kind, below, np.where(SHAPE, 255, 0))
    frame = el.read_frame(tmp_path / "a.img")
    assert not (frame.mask & ~SHAPE).any()
    assert (frame.mask & SHAPE).sum() > 0.7 * SHAPE.sum()
    assert frame.image.ndim == (2 if kind[0] in "lg" else 3)
    grey = frame.image if frame.image.ndim == 2 else frame.image[..., 0]
    np.testing.assert_allclose(
        grey[frame.mask], (WALL[frame.mask] + 60) / 255, atol=1e-9
    )
    assert "transparent" in caplog.text
    assert not read_image(tmp_path / "a.img")[~SHAPE].any()  # no white paper, either


@pytest.mark.parametrize(
    "kind", [kind for kind in KINDS if "key" not in kind and kind != "palette"]
)
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


def test_a_picture_that_is_transparent_everywhere_is_refused_but_not_a_bmp_that_has_no_alpha(
    tmp_path,
):
    for kind in ("rgba8", "la16", "grey tiff", "palette"):
        save(tmp_path / "a.img", kind, "white", np.zeros(WALL.shape))
        with pytest.raises(ValueError, match=r"a\.img is completely transparent"):
            el.read_frame(tmp_path / "a.img")
    for kind in ("bmp", "plain bmp"):
        save(tmp_path / "a.img", kind, "grey", np.zeros(WALL.shape))
        assert el.read_frame(tmp_path / "a.img").mask.all()


def test_black_around_what_is_opaque_is_still_left_out(tmp_path):
    small = with_alpha(8, 4, "white", np.full(WALL.shape, 255))
    stored = np.repeat(np.repeat(small, 6, axis=0), 6, axis=1)
    stored[:, :48, :3] = 0
    stored[:, 204:] = [255, 255, 255, 0]
    png(tmp_path / "a.png", stored, 8)
    seen = el.read_frame(tmp_path / "a.png").pixels_to_use()
    assert not seen[:, :48].any()
    assert not seen[:, 204:].any()
    assert seen[12:-12, 60:190].all()


DRAWN = np.where(np.indices(SHAPE.shape)[1] < 25, 255, 0)  # the left half


@pytest.mark.parametrize(
    ("colours", "expected"),
    [
        (np.full(SHAPE.shape, 255), SHAPE),
        (np.zeros(SHAPE.shape), SHAPE),
        (WALL + 60, SHAPE),
        (WALL, SHAPE),
        (DRAWN, SHAPE & (DRAWN > 0)),
    ],
    ids=["white", "black", "cut out of the frame", "cut out of a dark frame", "drawn"],
)
@pytest.mark.parametrize("suffix", ["png", "tiff", "bmp"])
def test_a_mask_that_is_kept_in_alpha(tmp_path, colours, expected, suffix):
    pixels = np.dstack([colours, colours, colours, np.where(SHAPE, 255, 0)]).astype(
        np.uint8
    )
    (tmp_path / f"m.{suffix}").write_bytes(
        cv2.imencode(f".{suffix}", pixels)[1].tobytes()
    )
    np.testing.assert_array_equal(read_mask(tmp_path / f"m.{suffix}"), expected)
    write_image(tmp_path / "f.png", (WALL + 60) / 255)
    np.testing.assert_array_equal(
        el.read_frame(tmp_path / "f.png", mask=tmp_path / f"m.{suffix}").mask, expected
    )


def test_a_mask_does_not_bring_back_what_is_transparent(tmp_path):
    save(tmp_path / "a.png", "rgba8", "white", np.where(SHAPE, 255, 0))
    write_image(tmp_path / "m.png", DRAWN / 255)
    mask = el.read_frame(tmp_path / "a.png", mask=tmp_path / "m.png").mask
    np.testing.assert_array_equal(mask, SHAPE & (DRAWN > 0))
    write_image(tmp_path / "m.png", ~SHAPE)
    with pytest.raises(ValueError, match=r"a\.png is transparent"):
        el.read_frame(tmp_path / "a.png", mask=tmp_path / "m.png")


@pytest.mark.parametrize("bits", range(9, 17))
@pytest.mark.parametrize("suffix", ["png", "tiff"])
def test_fewer_bits_than_the_file_has_are_named(tmp_path, caplog, bits, suffix):
    ramp = np.linspace(0, 2**bits - 1, 2000).reshape(40, 50).astype(np.uint16)
    for name, stored in {"low": ramp, "high": ramp << (16 - bits)}.items():
        (tmp_path / f"{name}.{suffix}").write_bytes(
            cv2.imencode(f".{suffix}", stored)[1].tobytes()
        )
        caplog.clear()
        el.read_frame(tmp_path / f"{name}.{suffix}")
        assert (f"{bits} of its 16 bits" in caplog.text) is (
            name == "low" and bits < 16
        )

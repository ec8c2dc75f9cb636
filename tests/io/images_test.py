"""Pictures, masks and frames in files, against other programs."""

import struct
import zlib

import cv2
import numpy as np
import pytest
import tifffile
from numpy.testing import assert_allclose, assert_array_equal
from PIL import Image

import endolab as el
from endolab.io.images import read_image, read_mask, write_image
from endolab.io.video import is_sequence, open_frames

WALL = np.add.outer(np.arange(40), np.arange(50)) + 60  # to 148
SHAPE = np.hypot(*np.indices((40, 50)) - np.array([[[20]], [[25]]])) < 18
JP2 = [cv2.IMWRITE_JPEG2000_COMPRESSION_X1000, 1000]


def store(path, stored, most=255):
    """Write a picture by another program."""
    colours = stored.shape[2:]
    if path.suffix == ".ppm":
        head = f"P{stored.ndim + 3} {stored.shape[1]} {stored.shape[0]} {most}\n"
        content = stored.astype(stored.dtype.newbyteorder(">")).tobytes()
        path.write_bytes(head.encode() + content)
    elif path.suffix == ".tiff":
        how = {"extrasamples": ["unassalpha"]} if colours == (4,) else {}
        tifffile.imwrite(path, stored, **how, photometric="rgb" if colours else None)
    elif path.suffix in (".png", ".bmp") or most > 255:
        order = [2, 1, 0, 3][: colours[0]] if colours else slice(None)
        content = cv2.imencode(path.suffix, stored[..., order], JP2)[1]
        path.write_bytes(content.tobytes())
    else:
        Image.fromarray(stored).save(path, lossless=True)


# Each format, layout and pixel type ------------------------------------------------------
@pytest.mark.parametrize(
    "kind",
    [
        *("8 png", "16 png", "8 tiff", "16 tiff", "8 bmp", "8 webp"),
        *("8 jp2", "16 jp2", "8 tga", "8 ppm", "12 ppm", "16 ppm"),
    ],
)
def test_a_picture_is_read_as_it_is_stored(tmp_path, rng, kind):
    bits, suffix = kind.split()
    most = 2 ** int(bits) - 1
    for channels in ((), (3,), (4,))[: 2 if suffix == "ppm" else 3]:
        path = tmp_path / f"{channels}.{suffix}"
        stored = rng.integers(0, most + 1, (48, 64, *channels))
        stored = stored.astype(np.uint8 if bits == "8" else np.uint16)
        stored[..., 3:] = most if channels else stored[..., 3:]
        store(path, stored, most)
        if suffix != "tga":  # which alone does not begin as a picture
            path = path.rename(tmp_path / "IMG0001")
        assert not is_sequence(path)
        ((_, found),) = open_frames(path)
        expected = stored[..., :3] if channels else stored
        found = found[..., 0] if found.ndim > expected.ndim else found
        assert_allclose(found, expected / most, atol=1e-5)


@pytest.mark.parametrize(
    ("suffix", "mode"), [("jpg", "L"), ("jpg", "RGB"), ("jpg", "CMYK"), ("avif", "RGB")]
)
def test_a_picture_with_loss_is_read_as_others_read_it(tmp_path, suffix, mode):
    path = tmp_path / f"a.{suffix}"
    Image.fromarray(WALL.astype(np.uint8)).convert(mode).save(path, quality=90)
    image = read_image(path)
    assert not is_sequence(path)
    first = image if mode == "L" else image[..., 0]
    assert_allclose(first * 255, WALL, atol=6)


@pytest.mark.parametrize("suffix", ["gif", "webp", "avif", "png"])
def test_of_several_pictures_that_are_no_video_the_first_is_taken_and_said(
    tmp_path, caplog, suffix
):
    first, *more = (Image.new("RGB", (40, 30), (30 * n,) * 3) for n in (1, 2, 3))
    path = tmp_path / f"a.{suffix}"
    first.save(path, save_all=True, append_images=more)
    assert not is_sequence(path)
    assert_allclose(read_image(path), 30 / 255, atol=0.01)
    assert "holds 3 pictures" in caplog.text


def profile(curve):
    """An ICC profile that has a curve alone."""
    tag = b"rTRC" + struct.pack(">2I", 144, len(curve))
    return bytes(128) + struct.pack(">I", 1) + tag + curve


def coded(curve):
    return {"cICP": bytes([9, curve, 0, 1])}


GAMMA = {"gAMA": struct.pack(">I", 100_000)}
POWER = profile(b"curv" + bytes(4) + struct.pack(">IH", 1, 563))  # 2.2
STRAIGHT = profile(b"curv" + bytes(4) + struct.pack(">IH", 1, 256))
PARAMETRIC = profile(b"para" + bytes(8) + struct.pack(">I", 65536))


@pytest.mark.parametrize(
    ("chunks", "how", "linear"),
    [
        (GAMMA, {}, True),
        ({"gAMA": struct.pack(">I", 45_455)}, {}, False),
        ({"sRGB": b"\0"} | GAMMA, {}, False),
        (coded(8), {}, True),
        (coded(1) | GAMMA, {}, False),
        (coded(16), {}, False),
        (coded(18), {}, False),
        ({}, {"icc_profile": STRAIGHT}, True),
        ({}, {"icc_profile": POWER}, False),
        (None, {"icc_profile": PARAMETRIC}, True),
        (None, {"icc_profile": POWER}, False),
    ],
)
def test_a_curve_that_is_no_power_is_named_and_a_linear_one_makes_a_nominal_light_so(
    tmp_path, caplog, chunks, how, linear
):
    path = tmp_path / ("a.tif" if chunks is None else "a.png")
    Image.fromarray(WALL.astype(np.uint8)).save(path, **how)
    for name, content in (chunks or {}).items():
        png = path.read_bytes()
        chunk = name.encode() + content
        chunk = struct.pack(">I", len(content)) + chunk + zlib.crc32(chunk).to_bytes(4)
        path.write_bytes(png[:33] + chunk + png[33:])
    frame = el.read_frame(path)
    assert el.nominal_calibration(frame).photometry.gamma == (1 if linear else 1.5)
    named = {str(coded(16)): "coded in PQ", str(coded(18)): "coded in HLG"}
    assert named.get(str(chunks), "") in caplog.text
    assert bool(caplog.text) is (str(chunks) in named)
    el.read_frame(path, el.Calibration(el.Pinhole(50, 40, 30, 30, 25, 20)))
    assert ("says that it is linear" in caplog.text) is linear


def test_of_a_stereo_picture_the_part_that_is_the_calibrations_is_read(tmp_path):
    both = np.hstack([WALL, WALL + 60]).astype(np.uint8)
    write_image(tmp_path / "a.png", both / 255)
    write_image(tmp_path / "m.png", both > 0)
    known = el.Calibration(el.Pinhole(25, 20, 15, 15, 12, 10), part=(50, 0, 50, 40))
    frame = el.read_frame(tmp_path / "a.png", known, tmp_path / "m.png")
    assert_array_equal(frame.image, both[:, 50:] / 255)
    ((_, image),) = open_frames(tmp_path / "a.png", calibration=known)
    assert_array_equal(image, frame.image)


def test_a_written_picture_reads_back(tmp_path, rng):
    for bits in (8, 16):
        stored = rng.integers(0, 2**bits, (5, 7, 3)) / (2**bits - 1)
        for image in (stored, stored[..., 0], np.where(stored > 0.3, 1.7, -0.3)):
            write_image(tmp_path / "a.png", image, bits)
            assert_array_equal(read_image(tmp_path / "a.png"), np.clip(image, 0, 1))


@pytest.mark.parametrize("suffix", ["jpg", "png", "tif"])
def test_it_is_read_as_the_sensor_saw_it_however_it_is_marked(tmp_path, caplog, suffix):
    stored = np.zeros((16, 24), np.uint8)
    stored[:8, :8] = 255
    for orientation in (1, 3, 6, 8):
        tags = Image.Exif()
        tags[274] = orientation
        path = tmp_path / f"{orientation}.{suffix}"
        Image.fromarray(stored).save(path, exif=tags)
        assert_allclose(read_image(path), stored / 255, atol=0.1)
        assert (path.name in caplog.text) is (orientation != 1)


# What is damaged is refused --------------------------------------------------------------
REFUSED = pytest.raises(ValueError, match=r"^[^\n]*: not a whole picture")


@pytest.mark.parametrize(
    ("suffix", "how"),
    [
        ("png", {}),
        ("jpg", {"quality": 95}),
        ("jpg", {"progressive": True}),
        ("jpg", {"restart_marker_rows": 1}),
        ("tif", {}),
        ("tif", {"compression": "tiff_lzw"}),
        *[(suffix, {}) for suffix in ("bmp", "webp", "gif", "jp2", "ppm")],
    ],
)
def test_what_is_cut_off_is_refused_and_nothing_printed(
    tmp_path, capfd, rng, suffix, how
):
    path = tmp_path / f"a.{suffix}"
    noise = rng.integers(0, 256, (60, 80, 3)).astype(np.uint8)
    Image.fromarray(noise).save(path, **how)
    content = path.read_bytes()
    for share in (0.0, 0.01, 0.5, 0.999):
        path.write_bytes(content[: int(share * len(content)) - 5])
        with REFUSED:
            read_image(path)
    assert capfd.readouterr() == ("", "")


def test_a_wrong_checksum_is_refused(tmp_path):
    path = tmp_path / "a.png"
    Image.fromarray(WALL.astype(np.uint8)).convert("P").save(path, transparency=9)
    content = path.read_bytes()
    for name in (b"IHDR", b"IDAT", b"tRNS", b"PLTE"):
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
def test_a_mask_may_be_stored_as_one_likes(tmp_path):
    white = Image.new("RGB", (4, 3), (255, 255, 255))
    deep = Image.fromarray(np.full((3, 4), 65535, np.uint16))
    for picture in (white.convert("1"), white.convert("P"), deep):
        picture.save(tmp_path / "m.png")
        assert read_mask(tmp_path / "m.png").all()


@pytest.mark.parametrize("kind", ["rgba", "rgba16", "la", "tiff", "L", "RGB", "P"])
def test_transparent_pixels_are_no_wall_whatever_is_below(tmp_path, caplog, kind):
    """Nor are those that are partly transparent, as they are mixed."""
    alpha = np.where(SHAPE, 255, 0)
    alpha[:3] = 128
    path = tmp_path / ("a.tiff" if kind == "tiff" else "a.png")
    for below in (255, 0, 80):
        pixels = np.dstack([np.where(alpha == 255, WALL, below)] * 3 + [alpha])
        pixels = pixels.astype(np.uint8)
        if kind in ("rgba", "tiff"):
            store(path, pixels)
        elif kind == "rgba16":
            store(path, pixels.astype(np.uint16) * 257)
        elif kind == "la":
            Image.merge("LA", Image.fromarray(pixels).split()[::3]).save(path)
        else:  # one colour, or one of a palette, that is none
            picture = Image.fromarray(np.where(alpha < 255, 7, pixels[..., 0]))
            if kind == "P":
                picture.putpalette(np.repeat(np.arange(256), 3).tolist())
            none = (7, 7, 7) if kind == "RGB" else 7
            picture.convert(kind).save(path, transparency=none)
        frame = el.read_frame(path)
        assert_array_equal(frame.mask, SHAPE & (alpha == 255))
        first = frame.image if frame.image.ndim == 2 else frame.image[..., 0]
        assert_allclose(first[frame.mask], WALL[frame.mask] / 255, atol=1e-9)
        # No white paper, either.
        assert not read_image(path)[alpha == 0].any()
    assert len(caplog.messages) == 3  # a warning each


DRAWN = np.where(np.indices(SHAPE.shape)[1] < 25, 255, 0)  # the left half


def cut_out(path, grey):
    """Save what is grey, transparent beside the shape."""
    store(path, np.dstack([grey, grey, grey, np.where(SHAPE, 255, 0)]).astype(np.uint8))
    return path


@pytest.mark.parametrize("grey", [255 + 0 * WALL, 0 * WALL, WALL, DRAWN])
def test_a_mask_that_is_kept_in_alpha(tmp_path, grey):
    """It is white, black, cut out of a frame; or drawn inside."""
    expected = SHAPE & (DRAWN > 0) if grey is DRAWN else SHAPE
    assert_array_equal(read_mask(cut_out(tmp_path / "m.png", grey)), expected)


def test_a_mask_does_not_bring_back_what_is_transparent(tmp_path):
    write_image(tmp_path / "m.png", DRAWN / 255)
    picture = cut_out(tmp_path / "a.png", np.where(SHAPE, WALL, 255))
    mask = el.read_frame(picture, mask=tmp_path / "m.png").mask
    assert_array_equal(mask, SHAPE & (DRAWN > 0))

"""The size of a picture, from its file's head alone."""

import io
import struct

import numpy as np
import pytest
import tifffile
from PIL import Image

from endolab.io.picture_size import picture_size

COLOURS = np.random.default_rng(0).integers(0, 256, (30, 41, 3)).astype(np.uint8)


def encoded(form, mode="RGB", **options):
    content = io.BytesIO()
    Image.fromarray(COLOURS).convert(mode).save(content, form, **options)
    return content.getvalue()


def tiff(**options):
    content = io.BytesIO()
    tifffile.imwrite(content, COLOURS, photometric="rgb", **options)
    return content.getvalue()


PICTURES = {
    "png": encoded("PNG"),
    "png of one bit": encoded("PNG", "1"),
    "png of a palette": encoded("PNG", "P"),
    "jpeg": encoded("JPEG"),
    "progressive jpeg": encoded("JPEG", progressive=True),
    "cmyk jpeg": encoded("JPEG", "CMYK"),
    "jpeg with a comment": encoded("JPEG", comment=b"\xff\xc0" * 300, exif=b"Exif\0\0" + bytes(5000)),
    "bmp": encoded("BMP"),
    "tiff": tiff(),
    "tiff, the other byte order": tiff(byteorder=">"),
    "bigtiff": tiff(bigtiff=True),
    "tiff of pages": tiff(description="the first page"),
}


@pytest.mark.parametrize("name", PICTURES)
def test_the_size_is_what_others_find(name):
    content = PICTURES[name]
    assert picture_size(io.BytesIO(content)) == (41, 30)
    with Image.open(io.BytesIO(content)) as picture:
        assert picture.size == (41, 30)


@pytest.mark.parametrize("name", PICTURES)
def test_a_damaged_head_has_a_size_or_none(name, rng):
    content = PICTURES[name]
    for _ in range(300):
        damaged = bytearray(content)
        damaged[int(rng.integers(len(damaged)))] = int(rng.integers(256))
        damaged = damaged[: int(rng.integers(2 * len(damaged)))]
        found = picture_size(io.BytesIO(damaged))
        assert found is None or min(found) > 0
    for end in range(min(len(content), 200)):
        assert picture_size(io.BytesIO(content[:end])) in (None, (41, 30))


def test_a_bmp_may_be_upside_down():
    upside_down = bytearray(PICTURES["bmp"])
    upside_down[22:26] = struct.pack("<i", -30)
    assert picture_size(io.BytesIO(upside_down)) == (41, 30)


@pytest.mark.parametrize("content", [b"", b"GIF89a" + bytes(20), b"RIFF" + bytes(40), b"\xff\xd8\xff" * 9])
def test_other_files_have_none(content):
    assert picture_size(io.BytesIO(content)) is None


def test_a_png_whose_chunk_is_longer_than_the_file_has_none():
    damaged = bytearray(PICTURES["png"])
    damaged[33:37] = struct.pack(">I", 2**31 - 1)  # libpng would make room for 2 GB
    assert picture_size(io.BytesIO(damaged)) is None

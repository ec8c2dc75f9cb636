"""How large a picture is, as the head of its file says, before memory is spent on decoding it."""

from __future__ import annotations

import struct
from typing import BinaryIO

_JPEG_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}  # markers that are followed by the size
_JPEG_ALONE = {0x01, *range(0xD0, 0xD9)}  # markers without content
_TIFF_WIDTH, _TIFF_HEIGHT = 256, 257
_TIFF_WHOLE = {3: "H", 4: "I", 16: "Q"}  # types of numbers that a size may have


def picture_size(stream: BinaryIO) -> tuple[int, int] | None:
    """Columns and rows of a PNG, JPEG, TIFF or BMP; None if it is none of these, or its head is damaged."""
    begins = stream.read(8)
    try:
        if begins == b"\x89PNG\r\n\x1a\n":
            size = _png(stream)
        elif begins[:3] == b"\xff\xd8\xff":
            size = _jpeg(stream)
        elif begins[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+"):
            size = _tiff(stream, "<" if begins[:2] == b"II" else ">", b"+" in begins[:4])
        elif begins[:2] == b"BM":
            size = _bmp(stream)
        else:
            return None
    except EOFError:
        return None
    return size if size is not None and min(size) > 0 else None


def _numbers(stream: BinaryIO, form: str) -> tuple[int, ...]:
    """Read numbers; EOFError if there are not so many."""
    content = stream.read(struct.calcsize(form))
    if len(content) < struct.calcsize(form):
        raise EOFError
    return struct.unpack(form, content)


def _png(stream: BinaryIO) -> tuple[int, int] | None:
    _, kind, width, height = _numbers(stream, ">I4sII")
    if kind != b"IHDR":
        return None
    end, place = stream.seek(0, 2), 8
    while kind != b"IEND":  # libpng makes room for a chunk as long as it says it is
        stream.seek(place)
        length, kind = _numbers(stream, ">I4s")
        place += 12 + length
        if place > end:
            return None
    return width, height


def _jpeg(stream: BinaryIO) -> tuple[int, int] | None:
    stream.seek(2)
    while True:
        (marker,) = _numbers(stream, ">H")
        while marker == 0xFFFF:  # filling
            marker = 0xFF00 | _numbers(stream, "B")[0]
        if marker < 0xFF00:
            return None
        kind = marker & 0xFF
        if kind in _JPEG_ALONE:
            continue
        (length,) = _numbers(stream, ">H")
        if kind in _JPEG_FRAMES:
            _, height, width = _numbers(stream, ">BHH")
            return width, height
        if length < 2 or kind in (0xD9, 0xDA):  # the end, or the picture itself
            return None
        stream.seek(length - 2, 1)


def _tiff(stream: BinaryIO, order: str, big: bool) -> tuple[int, int] | None:
    """Read the first directory; `big` is BigTIFF, whose offsets have 64 bits."""
    if big:
        (offset,) = _numbers(stream, f"{order}Q")
    else:
        stream.seek(4)
        (offset,) = _numbers(stream, f"{order}I")
    if offset >= 1 << 40:  # beyond what any file holds
        return None
    stream.seek(offset)
    (count,) = _numbers(stream, order + ("Q" if big else "H"))
    if count > 0xFFFF:
        return None
    place, content = ("Q", 8) if big else ("I", 4)
    found = {}
    for _ in range(count):
        tag, kind, _ = _numbers(stream, f"{order}HH{place}")
        value = stream.read(content)
        if tag in (_TIFF_WIDTH, _TIFF_HEIGHT) and kind in _TIFF_WHOLE and len(value) == content:
            form = order + _TIFF_WHOLE[kind]
            if struct.calcsize(form) > content:
                return None
            (found[tag],) = struct.unpack_from(form, value)
        if len(found) == 2:
            return found[_TIFF_WIDTH], found[_TIFF_HEIGHT]
    return None


def _bmp(stream: BinaryIO) -> tuple[int, int] | None:
    stream.seek(14)
    (length,) = _numbers(stream, "<I")
    width, height = _numbers(stream, "<HH" if length == 12 else "<ii")  # 12: of OS/2
    return width, abs(height)  # a negative height means from the top

"""What is whole of a PNG or a JPEG that is damaged beside its picture, or cut off at its end."""

import io
import re
import struct
import zlib

import numpy as np

PNG = b"\x89PNG\r\n\x1a\n"
JPEG = b"\xff\xd8"
# Chunks of a PNG, without which it shows something else.
NEEDED_CHUNKS = re.compile(b"IHDR|PLTE|tRNS|IDAT|IEND")
ENOUGH = 0.8  # of the rows
# of a JPEG: before its pixels, and after them
SCAN = b"\xff\xda"
END = b"\xff\xd9"


def mend(content: bytes) -> tuple[bytes, int, int]:
    """Make a whole file of a damaged one; return it, how many of its rows are so, and how many it has.

    Raises any exception if the picture itself is damaged, or there is less than its head. Not to be read,
    if fewer than `ENOUGH` are whole.
    """
    return _mend_png(content) if content.startswith(PNG) else _mend_jpeg(content)


def bare_png(content: bytes) -> bytes:
    """Return the PNG without what is beside its picture, of which libpng would print what is wrong."""
    return _as_png(_chunks(content))


def _chunks(content: bytes) -> dict[bytes, bytearray]:
    """Find the chunks that are needed, in order; the last may be cut off, others beside them damaged."""
    chunks: dict[bytes, bytearray] = {}
    at = len(PNG) + 4  # of a chunk's name, between its length and its data
    while at < len(content) and b"IEND" not in chunks:
        name = content[at : at + 4]
        end = at + 4 + int.from_bytes(content[at - 4 : at])
        is_whole = zlib.crc32(content[at:end]) == int.from_bytes(content[end : end + 4])
        if NEEDED_CHUNKS.fullmatch(name):
            if not is_whole and end + 4 <= len(content):
                raise ValueError
            chunks.setdefault(name, bytearray()).extend(content[at + 4 : end])
        elif not is_whole:  # its length may be wrong, too
            found = NEEDED_CHUNKS.search(content, at)
            end = found.start() - 8 if found else len(content)
        at = end + 8
    return chunks


def _as_png(chunks: dict[bytes, bytearray]) -> bytes:
    chunks.setdefault(b"IEND", bytearray())
    parts = [
        len(data).to_bytes(4) + name + data + zlib.crc32(name + data).to_bytes(4)
        for name, data in chunks.items()
    ]
    return PNG + b"".join(parts)


def _mend_png(content: bytes) -> tuple[bytes, int, int]:
    chunks = _chunks(content)
    columns, rows, bits, kind, interlaced = struct.unpack(">IIBBxxB", chunks[b"IHDR"])
    channels = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}[kind]  # by its colour type
    stride = 1 + (columns * bits * channels + 7) // 8  # bytes of a row
    if rows * stride > 2**31:
        raise ValueError
    unpacking = zlib.decompressobj()
    raw = unpacking.decompress(chunks[b"IDAT"], 2 * rows * stride)  # a bomb has more
    whole = min(rows, len(raw) // stride)
    if interlaced:  # what is missing is missing everywhere
        whole = rows if unpacking.eof else 0
    elif ENOUGH * rows <= whole < rows:
        chunks[b"IDAT"][:] = zlib.compress(
            raw[: whole * stride].ljust(rows * stride, b"\0"), 1
        )
    return _as_png(chunks), whole, rows


def _mend_jpeg(content: bytes) -> tuple[bytes, int, int]:
    """End the file where it is cut off; what is missing would depend on what were filled in."""
    from PIL import Image

    content = content.rstrip(b"\xff")  # half a marker
    something = b"\x55" * 64  # enough to be seen in place of what is cut off
    files = (io.BytesIO(content + filled + END) for filled in (b"", something))
    first, second = (Image.open(file, formats=["JPEG"]) for file in files)
    differ = (
        np.any(np.asarray(first) != np.asarray(second), axis=1)
        .reshape(first.height, -1)
        .any(axis=1)
    )
    whole = int(np.argmax([*differ, True]))
    if (
        whole < first.height
    ):  # the colours of its last row are mixed with those below, however these are filled
        whole = max(whole - 1, 0)
    scan = content[content.rfind(SCAN) + 2 :]
    # How the last scan of a progressive JPEG begins, the finest grey.
    finest = rb"(?s)\x00\x08\x01\x01..\x3f[\x00\x10]"
    if whole < first.height and "progressive" in first.info and not re.match(finest, scan):
        whole = 0  # all of it is coarse
    return content + END, whole, first.height

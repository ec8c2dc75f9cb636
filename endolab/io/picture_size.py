"""How large a picture is, as the head of its file says, before memory is spent on decoding it."""

from __future__ import annotations

import logging
import warnings
from importlib import import_module
from typing import BinaryIO

KINDS = {b"\x89PNG": "Png", b"\xff\xd8\xff": "Jpeg", b"II": "Tiff", b"MM": "Tiff", b"BM": "Bmp"}
logging.getLogger("PIL").addHandler(logging.NullHandler())  # else its complaints are printed


def picture_size(stream: BinaryIO) -> tuple[int, int] | None:
    """Columns and rows of a PNG, JPEG, TIFF or BMP; None if it is none of these, or its head is damaged."""
    begins = stream.read(8)
    kind = next((kind for magic, kind in KINDS.items() if begins.startswith(magic)), None)
    if kind is None:
        return None
    stream.seek(0)
    # Not Image.open, which refuses what it thinks is too large without saying how large that is.
    open_head = getattr(import_module(f"PIL.{kind}ImagePlugin"), f"{kind}ImageFile")
    try:
        with warnings.catch_warnings(action="ignore"):
            picture = open_head(stream)
            if kind == "Png":  # libpng makes room for a chunk as long as it says it is
                picture.verify()
    except Exception:  # Pillow promises nothing about which, if a file is damaged
        return None
    columns, rows = picture.size
    return (columns, rows) if min(columns, rows) > 0 else None

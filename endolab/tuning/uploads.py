"""Files that were dropped on the tuner: a picture, its mask, an endoscope, settings."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

from endolab.io.descriptions import Calibration
from endolab.io.images import read_frame, read_mask
from endolab.io.settings import FORMAT, SolvingSettings, read_settings
from endolab.numerics.arrays import BoolArray
from endolab.preprocessing.frame import Frame
from endolab.tuning.engine import sentence_of

MASK = re.compile(r"(^|[_\-. ])mask$")  # how the name of a mask ends

T = TypeVar("T")


@dataclass(frozen=True)
class Upload:
    """What there was; a `mask` without a frame is that of the one that is looked at."""

    frame: Frame | None = None
    mask: BoolArray | None = None
    calibration: Calibration | None = None
    settings: SolvingSettings | None = None


def read_upload(files: Mapping[str, bytes], calibration: Calibration) -> Upload:
    """Read files by name; a picture without an endoscope must fit this calibration.

    OSError or ValueError in one sentence that names the file.
    """
    kinds: dict[str, list[str]] = {"calibration": [], "picture": [], "mask": [], "file of settings": []}
    for name in files:
        kinds[_kind(name, bytes(files[name]))].append(name)
    for what, names in kinds.items():
        if len(names) > 1:
            raise ValueError(f"expected one {what} at most, found {len(names)}: {', '.join(sorted(names))}")
    pictures, masks = kinds["picture"], kinds["mask"]
    with tempfile.TemporaryDirectory() as folder:
        places = {name: Path(folder) / str(i) for i, name in enumerate(files)}  # a name can be anything

        def read(names: Iterable[str], reader: Callable[[Path], T]) -> T | None:
            for name in names:
                try:
                    return reader(places[name])
                except (OSError, ValueError, MemoryError) as error:
                    said = sentence_of(error)
                    for one, place in places.items():
                        said = said.replace(str(place), one)
                    raise ValueError(said) from error
            return None

        for name, place in places.items():
            place.write_bytes(files[name])
        settings = read(kinds["file of settings"], read_settings)
        known = read(kinds["calibration"], Calibration.load)
        mask_of = places[masks[0]] if masks else None
        frame = read(pictures, lambda path: read_frame(path, known or calibration, mask_of))
        mask = read(masks, read_mask) if frame is None else None
    return Upload(None if frame is None else replace(frame, name=pictures[0]), mask, known, settings)


def _kind(name: str, content: bytes) -> str:
    if name.lower().endswith(".json"):
        return "file of settings" if f'"{FORMAT}"'.encode() in content else "calibration"
    return "mask" if MASK.search(Path(name).stem.lower()) else "picture"

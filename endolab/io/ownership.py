"""What endolab wrote into a folder, and what it must not replace: the files of others, and what it reads."""

import hashlib
import json
import os
from collections.abc import Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

MANIFEST = ".endolab.json"
ASK = "or replace it with overwrite=True"  # the command line says --overwrite


def in_the_way(path: Path) -> FileExistsError:
    """Make the sentence about a file that is not ours to replace."""
    said = "is there already and endolab did not write it; choose another folder"
    return FileExistsError(f"{path} {said}, {ASK}")


def spare_inputs(places: Iterable[Path], inputs: Iterable[str | os.PathLike[str] | None]) -> None:
    """Raise FileExistsError in one sentence, if one of the places is a file that the same call reads.

    None, and the name of what is no file, are no such inputs.
    """
    there = {place: place.stat() for place in places if os.path.exists(place)}
    for path in inputs if there else ():
        try:
            read = os.stat(path or "")
        except (OSError, ValueError):
            continue
        for place, found in there.items():
            if os.path.samestat(read, found):
                raise FileExistsError(f"{place} is read by this very call; write to another place")


def digest(path: Path) -> str:
    """Compute what tells a file's content from any other."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


@dataclass(frozen=True)
class Claim:
    """Where files of results go, and whether what is there may be replaced by them.

    The folder's `MANIFEST` tells, for each name, what content endolab's own file may have.
    """

    folder: Path
    overwrite: bool = False  # what others wrote
    inputs: Collection[str | os.PathLike[str] | None] = ()  # never replaced
    elsewhere: Mapping[str, Path] = field(default_factory=dict)  # places of those that go not into the folder
    _digests: dict[tuple[str, int, int, int], str] = field(default_factory=dict)  # of what was looked at

    def place(self, name: str) -> Path:
        """Where a file goes."""
        return self.elsewhere.get(name, self.folder / name)

    def check(self, names: Iterable[str]) -> set[str]:
        """Return which of these files are to be replaced; OSError in one sentence, if one may not be."""
        places = {name: self.place(name) for name in names}
        places = {name: place for name, place in places.items() if os.path.lexists(place)}
        spare_inputs(places.values(), self.inputs)
        known = self._known()
        for name, place in places.items():
            if place.is_dir():
                raise OSError(f"cannot write {place}: it is a folder")
            if not self.overwrite and not self._is_own(place, known.get(name, ())):
                raise in_the_way(place)
        return set(places)

    def manifest(self, files: Iterable[Path]) -> dict[str, Any]:
        """What the manifest must say before these files move in, so that it is true at any time."""
        known = self._known()
        for path in files:
            place, own = self.place(path.name), known.get(path.name, [])
            kept = [self._digest(place)] if self._is_own(place, own) else []
            known[path.name] = list(dict.fromkeys([*kept, digest(path)]))
        return {"endolab": 1, "files": known}

    def _is_own(self, place: Path, digests: Collection[str]) -> bool:
        with suppress(OSError):  # what cannot be read is nobody's
            return (
                bool(digests)
                and place.is_file()
                and not place.is_symlink()
                and self._digest(place) in digests
            )
        return False

    def _digest(self, place: Path) -> str:
        """The same as `digest`, read again only if the file has been written or replaced meanwhile."""
        found = place.stat()
        key = str(place), found.st_ino, found.st_size, found.st_mtime_ns
        if key not in self._digests:
            self._digests[key] = digest(place)
        return self._digests[key]

    def _known(self) -> dict[str, list[str]]:
        try:
            files = json.loads((self.folder / MANIFEST).read_text(encoding="utf-8"))["files"]
            return {str(name): [str(known) for known in digests] for name, digests in files.items()}
        except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
            return {}  # nothing can be trusted to be ours

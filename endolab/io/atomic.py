"""Files that are whole or not there, and JSON."""

import json
import math
import os
import re
import secrets
import shutil
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

PathLike = str | os.PathLike[str]
REPORT = "report.json"  # by which a folder of results is known: a JSON object with the key "endolab"
FILES_KEY = "files"  # key of a report: names in its folder, which go when another report takes its place
ASK = "or replace it with overwrite=True"  # the command line says --overwrite
_TEMPORARY = ".endolab-"  # how the names of what is on its way begin


# Scheme and host.
_URL = re.compile(r"([A-Za-z][\w+.-]+):/+(?:.*@)?(\[[\da-fA-F:.]*\]|[\w.-]*)\S*")


# Sentences ------------------------------------------------------------------------------
def is_url(name: str) -> bool:
    """Whether this is a URL, of which a path may have lost a slash; C:/folder is none."""
    return _URL.match(name) is not None


def without_secrets(text: str) -> str:
    """Leave of each URL in a text its scheme and host: users, passwords and keys may be all the rest."""
    return _URL.sub(r"\1://\2", text)


def as_path(path: PathLike) -> Path:
    """Take a path; ValueError in one sentence, if it is a stream's URL, or nothing can be called so."""
    name = str(os.fspath(path))
    if is_url(name):
        raise ValueError(
            f"{without_secrets(name)} is a stream, where a file or a folder is expected"
        )
    if not name or "\0" in name:  # an empty one would be the folder where one is
        raise ValueError(f"no file or folder can be called {name!r}")
    return Path(name)


@contextmanager
def one_sentence(what: str) -> Iterator[None]:
    """Make one sentence, which begins so, of an OSError of the system."""
    try:
        yield
    except OSError as error:
        if error.errno is None:  # it is a sentence already
            raise
        raise OSError(f"{what}: {error.strerror}") from error


@contextmanager
def name_damage(path: PathLike, what: str) -> Iterator[None]:
    """Say in one sentence that a file is not `what` it should be, whatever its reader raises."""
    try:
        yield
    except Exception as error:  # packages promise nothing about which, if a file is damaged
        raise ValueError(f"{os.fspath(path)}: not {what}") from error


@contextmanager
def _name_target(temporary: Path, target: Path) -> Iterator[None]:
    """Make one sentence of an OSError, in which `target` stands for what is temporary."""
    try:
        yield
    except OSError as error:
        message = str(error)
        if error.errno is not None:  # what is without a file's name failed in writing
            message = f"{error.filename or temporary}: {error.strerror}"
        raise type(error)(message.replace(str(temporary), str(target))) from error


# Folders and files ----------------------------------------------------------------------
def _is_read(place: Path, inputs: Iterable[PathLike | None]) -> bool:
    """Whether a place is a file that the same call reads."""
    read = [path for path in inputs if path is not None and os.path.exists(path)]
    return place.exists() and any(place.samefile(path) for path in read)


def spare_inputs(places: Iterable[Path], inputs: Iterable[PathLike | None]) -> None:
    """Raise FileExistsError in one sentence, if one of the places is a file that the same call reads."""
    for place in places:
        if _is_read(place, inputs):
            raise FileExistsError(
                f"{place} is read by this very call; write to another place"
            )


def read_report(folder: Path, name: str = REPORT) -> dict[str, Any]:
    """Read the report of a folder of endolab's results; an empty one, if it holds none of endolab's."""
    with suppress(OSError, ValueError):
        report = read_json(folder / name, "report")
        if isinstance(report, dict) and "endolab" in report:
            return report
    return {}


def files_of_report(folder: Path, report: str = REPORT) -> list[Path]:
    """Find the files that an earlier run wrote into a folder, by its report; all others are the user's."""
    names = read_report(folder, report).get(FILES_KEY)
    files: list[Path] = []
    if isinstance(names, list):
        for path in folder.iterdir():
            if path.name in names:
                # A folder is that of a video's frames, in which there may be more.
                files += path.glob("*/depth.npz") if path.is_dir() else [path]
    return files


def check_folder(folder: Path) -> None:
    """Raise OSError in one sentence, unless a folder is new, empty or endolab's own."""
    with one_sentence(f"cannot write to the folder {folder}"):
        names = [path.name for path in folder.iterdir()] if folder.exists() else []
    # Which a killed run may leave.
    others = [name for name in names if not name.startswith(_TEMPORARY)]
    if others and not read_report(folder):
        content = f"holds {min(others)} and no results of endolab's; choose another folder"
        raise FileExistsError(f"{folder} {content}, {ASK}")


@contextmanager
def stage_folder(
    folder: PathLike,
    *,
    overwrite: bool = False,
    inputs: Collection[PathLike | None] = (),
    report: str = REPORT,
) -> Iterator[Path]:
    """Give a temporary folder whose files move into `folder`, one after the other, if the block succeeds.

    `folder` is made if need be, and removed again if it was made here and nothing came of it. It must be
    new, empty, or hold a `REPORT` of endolab's; else it needs `overwrite`. A new `report` moves in last. It
    lists the files, unless it has a list, and takes away what the one before it lists. One of `inputs` is
    never replaced or taken away. OSError in one sentence, if it cannot be written.
    """
    target = as_path(folder)
    if not overwrite:
        check_folder(target)
    staging = target / f"{_TEMPORARY}{secrets.token_hex(4)}"
    made: list[Path] = []
    try:
        with _name_target(staging, target):
            made = [path for path in (target, *target.parents) if not path.exists()]
            staging.mkdir(parents=True)
            yield staging
            _move_in(staging, target, inputs, report)
    finally:
        shutil.rmtree(staging, ignore_errors=True)
        for path in made:
            with suppress(OSError):  # there is something in it
                path.rmdir()


def _move_in(
    staging: Path, target: Path, inputs: Collection[PathLike | None], report: str
) -> None:
    """Move all files to their places, the report last, after all that can go wrong has been tried."""
    files = sorted(staging.iterdir(), key=lambda path: (path.name == report, path.name))
    places = [target / path.name for path in files]
    spare_inputs(places, inputs)
    for place in places:
        if place.is_dir():
            raise OSError(f"cannot write {place}: it is a folder")
    for path, place in zip(files, places, strict=True):
        if path.name == report:  # the one before stays until all that it lists has gone
            content = json.loads(path.read_bytes())
            content.setdefault(FILES_KEY, [path.name for path in files])
            path.write_bytes(as_json(content))
            for old in {*files_of_report(target, report)}.difference(places):
                if not _is_read(old, inputs):
                    _remove(old)
        path.replace(place)


def _remove(path: Path) -> None:
    """Remove a file, and the folders of a frame and of all frames that are empty then."""
    path.unlink()
    with suppress(OSError):  # there is something in it
        path.parent.rmdir()
        path.parent.parent.rmdir()


def check_file(
    path: PathLike, *, overwrite: bool = True, inputs: Collection[PathLike | None] = ()
) -> None:
    """Raise OSError in one sentence, if a file must not be written; parameters as of `stage_file`."""
    target = as_path(path)
    with one_sentence(f"cannot write {target}"):
        if target.exists() and not target.is_file():
            raise OSError(f"cannot write {target}: it is a folder, or no plain file")
        spare_inputs([target], inputs)
        if target.exists() and not overwrite:
            raise FileExistsError(f"{target} is there already; choose another name, {ASK}")


@contextmanager
def stage_file(
    path: PathLike, *, overwrite: bool = True, inputs: Collection[PathLike | None] = ()
) -> Iterator[Path]:
    """Give a temporary file of the same suffix, which becomes `path` only if the block succeeds.

    One of `inputs` is never replaced; without `overwrite` nothing is. OSError in one sentence, if it
    cannot be written; then there is nothing, or what was there before.
    """
    check_file(path, overwrite=overwrite, inputs=inputs)
    target = as_path(path)
    temporary = target.parent / f"{_TEMPORARY}{secrets.token_hex(4)}{target.suffix}"
    try:
        with _name_target(temporary, target):
            temporary.touch(exist_ok=False)
            yield temporary
            temporary.replace(target)
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def write_atomically(path: PathLike, content: bytes) -> None:
    """Write a file so that it is either whole or not there."""
    with stage_file(path) as temporary:
        temporary.write_bytes(content)


def read_bytes(path: PathLike, what: str = "file", most: float = math.inf) -> bytes:
    """Read a file; OSError in one sentence, which calls it `what` if there is none.

    ValueError, if it has more than `most` bytes, before it is read.
    """
    source = as_path(path)
    with one_sentence(f"{source}: cannot be read"):
        if not source.is_file():  # a pipe might never end
            raise FileNotFoundError(f"{source}: there is no such {what}")
        if source.stat().st_size > most:
            raise ValueError(f"{source}: expected a {what} of at most {most / 1e6:g} MB")
        return source.read_bytes()


# JSON -----------------------------------------------------------------------------------
def as_json(content: dict[str, Any]) -> bytes:
    """Encode as strict, indented JSON: a value that is not finite is an error."""
    text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    # a file's name may be any bytes: \udc80, in JSON as here.
    return text.encode(errors="backslashreplace")


def read_json(path: PathLike, what: str) -> Any:
    """Read a JSON file; OSError or ValueError in one sentence, which calls it `what` if there is none."""
    most = 10_000_000  # bytes; a calibration with its evidence has some kB
    content = read_bytes(path, what, most)
    try:
        # Whatever byte order mark it has.
        return json.loads(content.decode(json.detect_encoding(content)))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{Path(path)}: not valid JSON: {error}") from error

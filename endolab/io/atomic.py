"""Files and folders that are whole or not there, and JSON."""

import json
import logging
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from secrets import token_hex
from shutil import rmtree
from tempfile import TemporaryFile
from typing import Any

from endolab.numerics.checks import shorten

PathLike = str | os.PathLike[str]
log = logging.getLogger("endolab")


# Sentences ------------------------------------------------------------------------------
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
def say_undrawn(path: PathLike, undrawn: list[str]) -> Iterator[Path]:
    """Give a path for what only shows numbers: if it cannot be drawn, the numbers are not lost.

    Whatever the block raises becomes a sentence, logged and added to `undrawn`, and there is no such file,
    nor an older one. A disk that is full, no memory and an interrupt are no picture's fault, and passed on.
    """
    target = Path(path)
    try:
        yield target
    except (OSError, MemoryError):
        raise
    except Exception as error:
        target.unlink(missing_ok=True)
        why = f"{type(error).__name__}: {error}"
        undrawn.append(shorten(f"{target.name} could not be drawn, {why}", 300))
        log.warning("%s", undrawn[-1])


# Written beside, then renamed -----------------------------------------------------------
def check_new(
    path: PathLike, overwrite: bool = False, read: Sequence[PathLike | None] = ()
) -> None:
    """Raise FileExistsError in one sentence, if there is a file, or a folder that holds one.

    With `overwrite` that is replaced, but for one of the files that are `read`.
    """
    target = Path(path)
    with one_sentence(f"cannot write {target}"):
        is_there = target.is_file() or any(target.glob("[!.]*"))
        found = [one for one in read if one is not None and os.path.exists(one)]
        if is_there and any(target.samefile(one) for one in found):
            raise FileExistsError(f"{target} is read, too; choose another name to write")
    if is_there and not overwrite:
        text = "is there already; choose another name, or replace it with overwrite=True"
        raise FileExistsError(f"{target} {text}")


def check_writable(path: PathLike) -> None:
    """Raise OSError in one sentence, if no file can be written there: before a long run, not after it."""
    target = Path(path)
    with one_sentence(f"cannot write {target}"):
        if target.is_dir():
            raise OSError(f"cannot write {target}: it is a folder")
        TemporaryFile(dir=target.parent).close()


@contextmanager
def _stage(home: Path, target: Path) -> Iterator[Path]:
    """Give a place for the target in a temporary folder, in whose stead errors name the target."""
    # Its name is known before it is there, so that Ctrl-C leaves none.
    folder = home / f".endolab-{token_hex(6)}"
    staging = folder / target.name
    try:
        try:
            folder.mkdir(0o700)
            yield staging
        finally:
            rmtree(folder, ignore_errors=True)
    except OSError as error:
        message = f"cannot write {target}: {error.strerror}" if error.errno else str(error)
        raise type(error)(message.replace(str(staging), str(target))) from error
    finally:
        rmtree(folder, ignore_errors=True)  # as an interrupt may have ended the first


@contextmanager
def stage_file(path: PathLike) -> Iterator[Path]:
    """Give a temporary file's name, which becomes `path`, whatever is there, only if the block succeeds.

    OSError in one sentence, if it cannot be written; then there is nothing, or what was there before.
    """
    target = Path(path)
    with _stage(target.parent, target) as temporary:
        yield temporary
        temporary.replace(target)


@contextmanager
def stage_folder(
    folder: PathLike,
    *,
    overwrite: bool = False,
    read: Sequence[PathLike | None] = (),
) -> Iterator[Path]:
    """Give a temporary folder, which becomes `folder` only if the block succeeds.

    Into one that is there, its files move by their names, `report.json` last; unless that is empty, only with
    `overwrite`, and none that is `read`. OSError in one sentence, if it cannot be written.
    """
    target = Path(folder)
    check_new(target, overwrite)
    places = (target, *target.absolute().parents)
    home = next(place for place in places if os.path.exists(place))
    with _stage(home, target) as staging:
        staging.mkdir(exist_ok=True)
        yield staging
        if target.exists():
            made = sorted(staging.iterdir(), key=lambda path: path.name == "report.json")
            for path in made:
                check_new(target / path.name, True, read)
            for path in made:
                path.replace(target / path.name)
        else:
            target.parent.mkdir(parents=True, exist_ok=True)
            staging.rename(target)


def write_atomically(path: PathLike, content: bytes) -> None:
    """Write a file so that it is either whole or not there."""
    with stage_file(path) as temporary:
        temporary.write_bytes(content)


# Read -----------------------------------------------------------------------------------
def read_bytes(path: PathLike, what: str = "file") -> bytes:
    """Read a file; OSError in one sentence, which calls it `what` if there is none."""
    source = Path(path)
    with one_sentence(f"{source}: cannot be read"):
        if not source.is_file():  # a pipe might never end
            raise FileNotFoundError(f"{source}: there is no such {what}")
        return source.read_bytes()


def as_json(content: dict[str, Any]) -> bytes:
    """Encode as strict, indented JSON: a value that is not finite is an error."""
    text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    # a file's name may be any bytes: \udc80, in JSON as here.
    return text.encode(errors="backslashreplace")


def read_json(path: PathLike, what: str) -> Any:
    """Read a JSON file; OSError or ValueError in one sentence, which calls it `what` if there is none."""
    content = read_bytes(path, what)
    try:
        # Whatever byte order mark it has.
        return json.loads(content.decode(json.detect_encoding(content)))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{Path(path)}: not valid JSON: {error}") from error

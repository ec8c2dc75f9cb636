"""Files that are whole or not there, and JSON."""

import json
import math
import os
import shutil
import stat
import sys
from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

from endolab.io.leftovers import clear_leftovers, is_temporary, temporary_name
from endolab.io.ownership import ASK, MANIFEST, Claim, spare_inputs

PathLike = str | os.PathLike[str]
MOST_JSON = 10_000_000  # bytes; a calibration with its evidence has some kB


# Sentences ------------------------------------------------------------------------------
def as_path(path: PathLike) -> Path:
    """Take a path; ValueError in one sentence, if nothing can be called so."""
    name = os.fspath(path)
    with suppress(UnicodeEncodeError):
        if name and b"\0" not in os.fsencode(name):
            return Path(name)
    raise ValueError(f"no file or folder can be called {name!r}")


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
def _hidden(temporary: Path, target: Path) -> Iterator[None]:
    """Make one sentence of an error, in which `target` stands for what is temporary."""
    try:
        yield
    except (OSError, ValueError) as error:
        kind, said = OSError if isinstance(error, OSError) else ValueError, str(error)
        if isinstance(error, OSError) and error.errno is not None:
            # Only what opens a file knows its name: what is without one failed in writing.
            name = str(temporary if error.filename is None else error.filename)
            doing = "cannot write " * name.startswith(str(temporary))
            said = f"{doing}{name}: {error.strerror}"
        if said == str(error) and str(temporary) not in said:
            raise
        raise kind(said.replace(str(temporary), str(target))) from error


# Folders and files ----------------------------------------------------------------------
@contextmanager
def staged_folder(
    folder: PathLike,
    names: Iterable[str] = (),
    *,
    overwrite: bool = False,
    inputs: Collection[PathLike | None] = (),
    elsewhere: Mapping[str, Path] | None = None,
) -> Iterator[Path]:
    """Give a temporary folder whose files move into `folder`, all or none, if the block succeeds.

    `folder` is made if need be, and removed again if it was made here and nothing came of it. What is
    there already is replaced only if endolab wrote it, or if `overwrite`; one of `inputs` never. `names`,
    of files that are to come, are looked for before the block. `elsewhere` has the places of files that go
    to another folder. OSError in one sentence, if it cannot be written.
    """
    target = as_path(folder)
    claim = Claim(target, overwrite, inputs, elsewhere or {})
    staging = target / temporary_name()
    made: list[Path] = []
    try:
        with one_sentence(f"cannot write to the folder {target}"):
            claim.check(names)
            for path in reversed([target, *target.parents]):
                if not path.exists():
                    with suppress(FileExistsError):  # another run was quicker
                        path.mkdir()
                        made.append(path)
            clear_leftovers(target)
            staging.mkdir(0o700)
        with _hidden(staging, target):
            yield staging
            files = sorted(staging.iterdir())
            with _alone_in(target):
                replaced = claim.check([path.name for path in files])
                if not is_temporary(target):
                    write_atomically(target / MANIFEST, as_json(claim.manifest(files)))
                _move_in(files, claim, replaced, staging / temporary_name())
        made.clear()
    finally:
        shutil.rmtree(staging, ignore_errors=True)
        for path in reversed(made):
            with suppress(OSError):  # another run has taken to the folder, or no name in it is short enough
                (path / MANIFEST).unlink(missing_ok=True)
            with suppress(OSError):
                path.rmdir()


@contextmanager
def _alone_in(folder: Path) -> Iterator[None]:
    """Keep other runs from moving files in meanwhile, where the system can."""
    if sys.platform == "win32":
        yield
        return
    import fcntl

    held = None
    try:
        with suppress(OSError):  # a folder that cannot be read, or a network's that cannot be locked
            held = os.open(folder, os.O_RDONLY)
            fcntl.flock(held, fcntl.LOCK_EX)
        yield
    finally:
        if held is not None:
            os.close(held)


def _move_in(files: Iterable[Path], claim: Claim, replaced: Collection[str], aside: Path) -> None:
    """Move files to their places, or none: after a failure what was there is there again."""
    aside.mkdir()
    done: list[tuple[Path, Path | None]] = []
    try:
        for path in files:
            place = claim.place(path.name)
            with one_sentence(f"cannot write {place}"):
                if path.name in replaced:
                    done.append((place, aside / path.name))  # before, so that no interrupt loses it
                    _move_new(place, aside / path.name)
                    _replace(path, place)
                else:
                    _move_new(path, place)
                    done.append((place, None))
    except BaseException:
        for place, before in reversed(done):
            with suppress(OSError):
                place.unlink() if before is None else before.replace(place)
        raise


def _move_new(path: Path, place: Path) -> None:
    """Give a file another place, where there must be none; it may stay at the old one, too."""
    try:
        os.link(path, place)  # which, unlike a rename, replaces nothing
    except FileExistsError:
        raise
    except OSError:  # no links here, as on some network folders
        if os.path.lexists(place):
            raise FileExistsError(f"cannot write {place}: it has just been written by another") from None
        path.rename(place)


def _replace(path: Path, place: Path) -> None:
    """Move a file to a place where there may be one, whose mode it takes over."""
    with suppress(FileNotFoundError):
        mode = stat.S_IMODE(place.stat().st_mode)
        if mode != stat.S_IMODE(path.stat().st_mode):
            path.chmod(mode)
    path.replace(place)


@lru_cache(maxsize=256)
def _clear_once(folder: Path) -> None:
    clear_leftovers(folder)


@contextmanager
def staged_file(
    path: PathLike, *, overwrite: bool = True, inputs: Collection[PathLike | None] = ()
) -> Iterator[Path]:
    """Give a temporary file of the same suffix, which becomes `path` only if the block succeeds.

    One of `inputs` is never replaced; without `overwrite` nothing is, but for a file with the same content.
    OSError in one sentence, if it cannot be written; then there is nothing, or what was there before.
    """
    target = as_path(path)
    temporary = target.parent / temporary_name(target.suffix)
    try:
        with one_sentence(f"cannot write {target}"):
            there = _is_there(target)
            spare_inputs([target], inputs)
            if not is_temporary(target.parent):
                _clear_once(target.parent.absolute())
            os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))
        with _hidden(temporary, target):
            yield temporary
        with one_sentence(f"cannot write {target}"):
            if overwrite:
                _replace(temporary, target)
            elif not there and not os.path.lexists(target):
                _move_new(temporary, target)
            elif temporary.read_bytes() != target.read_bytes():
                raise FileExistsError(f"{target} is there already; choose another name, {ASK}")
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def _is_there(target: Path) -> bool:
    """Whether there is a file; OSError if there can be none."""
    try:
        mode = target.stat().st_mode
    except FileNotFoundError:
        return False
    if not stat.S_ISREG(mode):
        what = "a folder" if stat.S_ISDIR(mode) else "no plain file"
        raise OSError(f"cannot write {target}: it is {what}")
    return True


def write_atomically(path: PathLike, content: bytes) -> None:
    """Write a file so that it is either whole or not there."""
    with staged_file(path) as temporary:
        temporary.write_bytes(content)


def read_bytes(path: PathLike, what: str = "file", most: float = math.inf) -> bytes:
    """Read a file; OSError in one sentence, which calls it `what` if there is none.

    ValueError, if it has more than `most` bytes, before it is read.
    """
    source = as_path(path)
    with one_sentence(f"{source}: cannot be read"):
        try:
            found = source.stat()
        except (FileNotFoundError, NotADirectoryError):
            raise FileNotFoundError(f"{source}: there is no such {what}") from None
        if not stat.S_ISREG(found.st_mode):  # a pipe might never end
            raise FileNotFoundError(f"{source}: there is no such {what}, but something else of that name")
        if found.st_size > most:
            size = f"{most / 1e6:g} MB, found {found.st_size / 1e6:.7g} MB"
            raise ValueError(f"{source}: expected a {what} of at most {size}")
        return source.read_bytes()


# JSON -----------------------------------------------------------------------------------
def as_json(content: dict[str, Any]) -> bytes:
    """Encode as strict, indented JSON: a value that is not finite is an error."""
    text = json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n"
    return text.encode(errors="backslashreplace")  # a file's name may be any bytes: \udc80, in JSON as here


def read_json(path: PathLike, what: str) -> Any:
    """Read a JSON file; OSError or ValueError in one sentence, which calls it `what` if there is none."""
    source = Path(path)
    content = read_bytes(source, what, MOST_JSON)
    try:
        return json.loads(content.decode())
    except UnicodeDecodeError as error:
        raise ValueError(f"{source}: not UTF-8 text") from error
    except RecursionError as error:
        raise ValueError(f"{source}: not valid JSON: it is nested too deeply") from error
    except ValueError as error:
        raise ValueError(f"{source}: not valid JSON: {error}") from error

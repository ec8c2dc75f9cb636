"""Files that are whole or not there, and JSON."""

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

PathLike = str | os.PathLike[str]


@contextmanager
def staged_folder(folder: PathLike) -> Iterator[Path]:
    """Give a temporary folder whose files move into `folder` only if the block succeeds.

    `folder` is made if need be, and removed again if it was made here and nothing came of it.
    OSError in one sentence, if it cannot be written.
    """
    target = Path(folder)
    made: list[Path] = []
    staging = None
    try:
        try:
            for path in reversed([target, *target.parents]):
                if not path.exists():
                    path.mkdir()
                    made.append(path)
            staging = Path(tempfile.mkdtemp(prefix=".endolab-", dir=target))
        except OSError as error:
            raise OSError(f"cannot write to the folder {target}: {error.strerror or error}") from error
        yield staging
        written = sorted(staging.iterdir())
        for path in written:
            if (target / path.name).is_dir():
                raise OSError(f"cannot write {target / path.name}: it is a folder")
        for path in written:
            os.replace(path, target / path.name)
        made.clear()
    except OSError as error:  # the reader knows nothing of the temporary folder
        if staging is None or str(staging) not in str(error):
            raise
        raise OSError(str(error).replace(str(staging), str(target))) from error
    finally:
        if staging is not None:
            shutil.rmtree(staging, ignore_errors=True)
        for path in reversed(made):
            path.rmdir()


@contextmanager
def staged_file(path: PathLike) -> Iterator[Path]:
    """Give a temporary file of the same suffix, which becomes `path` only if the block succeeds.

    OSError in one sentence, if it cannot be written; then there is nothing, or what was there before.
    """
    target, temporary = Path(path), None
    try:
        handle, name = tempfile.mkstemp(target.suffix, f".{target.stem}-", target.parent)
        temporary = Path(name)
        os.close(handle)
        yield temporary
        temporary.chmod(0o644)
        temporary.replace(target)
    except OSError as error:
        if error.strerror is None:  # it is a sentence already
            raise
        raise OSError(f"cannot write {target}: {error.strerror}") from error
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


def write_atomically(path: PathLike, content: bytes) -> None:
    """Write a file so that it is either whole or not there."""
    with staged_file(path) as temporary:
        temporary.write_bytes(content)


def as_json(content: dict[str, Any]) -> bytes:
    """Encode as strict, indented JSON: a value that is not finite is an error."""
    return (json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n").encode()


def read_json(path: PathLike, what: str) -> Any:
    """Read a JSON file; OSError or ValueError in one sentence, which calls it `what` if there is none."""
    source = Path(path)
    if not source.is_file():
        raise FileNotFoundError(f"{source}: there is no such {what}")
    try:
        return json.loads(source.read_text(encoding="utf-8"))
    except OSError as error:
        raise OSError(f"{source}: cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise ValueError(f"{source}: not UTF-8 text") from error
    except RecursionError as error:
        raise ValueError(f"{source}: not valid JSON: it is nested too deeply") from error
    except ValueError as error:
        raise ValueError(f"{source}: not valid JSON: {error}") from error

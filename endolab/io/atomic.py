"""Files that are whole or not there, and JSON."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

PathLike = str | os.PathLike[str]


# Writing --------------------------------------------------------------------------------
@contextmanager
def staged_folder(folder: PathLike) -> Iterator[Path]:
    """Give a temporary folder whose files move into `folder` only if the block succeeds.

    Parameters
    ----------
    folder : path
        Made if it does not exist; removed again if it was made here and nothing came of it.

    Yields
    ------
    Path
        Where to write.

    Raises
    ------
    OSError
        In one sentence, if the folder cannot be written.
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


def write_atomically(path: PathLike, content: bytes) -> None:
    """Write a file so that it is either whole or not there."""
    target = Path(path)
    try:
        handle, temporary = tempfile.mkstemp(prefix=f".{target.name}-", dir=target.parent)
    except OSError as error:
        raise OSError(f"cannot write {target}: {error.strerror or error}") from error
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
        os.chmod(temporary, 0o644)
        os.replace(temporary, target)
    except OSError as error:
        raise OSError(f"cannot write {target}: {error.strerror or error}") from error
    finally:
        Path(temporary).unlink(missing_ok=True)


def as_json(content: dict[str, Any]) -> bytes:
    """Encode as strict, indented JSON: a value that is not finite is an error."""
    return (json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n").encode()


def read_json(path: PathLike, what: str) -> Any:
    """Read a JSON file.

    Parameters
    ----------
    path : path
    what : str
        Kind of file, for the complaint that there is none.

    Raises
    ------
    OSError, ValueError
        In one sentence, if the file cannot be read or is not JSON.
    """
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

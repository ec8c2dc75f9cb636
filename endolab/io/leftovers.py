"""Temporary names that tell whose they are, and an end to what killed runs have left under them."""

import os
import platform
import re
import secrets
import shutil
import time
import zlib
from contextlib import suppress
from functools import cache
from pathlib import Path

TEMPORARY = re.compile(r"\.endolab-([0-9a-f]{8})-([0-9]{1,9})-[0-9a-f]{8}(\..*)?", re.DOTALL)
LONG_AGO = 7 * 24 * 3600.0  # s; older than that is what another computer's run has left, too


@cache
def _computer() -> str:
    """Eight digits for where a process's number means something."""
    try:
        numbers = os.readlink("/proc/self/ns/pid")  # a container counts its processes anew
    except OSError:  # not Linux
        numbers = ""
    return f"{zlib.crc32(f'{platform.node()} {numbers}'.encode()):08x}"


def temporary_name(suffix: str = "") -> str:
    """Give a new name for a file or folder of this process, in which others can read that it is one."""
    return f".endolab-{_computer()}-{os.getpid()}-{secrets.token_hex(4)}{suffix}"


def is_temporary(path: Path) -> bool:
    """Whether a file or folder has such a name."""
    return TEMPORARY.fullmatch(path.name) is not None


def clear_leftovers(folder: Path) -> None:
    """Remove what runs that live no more have left in a folder; what cannot be removed stays."""
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            owner = TEMPORARY.fullmatch(entry.name)
            if owner is None or not _is_left(entry, owner[1], int(owner[2])):
                continue
            if entry.is_dir(follow_symlinks=False):
                shutil.rmtree(entry.path, ignore_errors=True)
            else:
                with suppress(OSError):
                    os.unlink(entry.path)


def _is_left(entry: os.DirEntry[str], computer: str, process: int) -> bool:
    if computer == _computer() and not _lives(process):
        return True
    with suppress(OSError):  # it has gone by itself
        return time.time() - entry.stat(follow_symlinks=False).st_mtime > LONG_AGO
    return False


def _lives(process: int) -> bool:
    """Whether there is a process of this number here; it may be another one, which took over a number."""
    import psutil

    try:
        return psutil.pid_exists(process) and psutil.Process(process).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False
    except psutil.AccessDenied:
        return True

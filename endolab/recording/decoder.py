"""Decodes a recording in a process of its own: Rerun's reader ends the process where a file is damaged.

The program that this file is, run by its path, writes what a recording holds to its standard output,
as Arrow's streams one after the other. It is given at most so many seconds and so much memory, and
imports nothing of endolab and not all of Rerun, which would take ten times as long.
"""

import faulthandler
import os
import re
import sys
import zlib
from pathlib import Path
from typing import Any

CHECKSUM = "__properties/checksum"  # the entity whose text is that of the file around it
UNKNOWN = b"~|!#$%&*|~"  # in its place while it is summed up; stored as it is, for nothing is like it
TRUNCATED, OTHER_VERSION, DAMAGED, CHANGED = 3, 4, 5, 6  # how the program exits; a killed one is DAMAGED too
PATIENCE = 60  # seconds, and one more for each megabyte


def stamped(content: bytes) -> bytes:
    """A recording with its checksum, in the place that was left for it."""
    return content.replace(UNKNOWN, b"~%08x~" % zlib.crc32(content), 1)


def _is_whole(content: bytes, stamp: str) -> bool:
    """Whether a recording is what was stamped; one without a stamp may be."""
    # Looked for everywhere, for what is damaged may be the way to it.
    found = set(re.findall(rb"~[0-9a-f]{8}~", content)) | {stamp.encode()} - {b"", UNKNOWN}
    return not found or (
        found == {stamp.encode()} and stamped(content.replace(stamp.encode(), UNKNOWN)) == content
    )


def _limit(size: int) -> None:
    """Give this process an end for a file of so many bytes, and on Linux a limit of its memory."""
    faulthandler.dump_traceback_later(PATIENCE + size // 1_000_000, exit=True)
    if sys.platform == "linux":
        import resource

        most = 4 * 2**30 + 20 * size
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def main(path: str) -> int:
    """Decode a file; return how the program exits."""
    sys.modules["numpy"] = None  # type: ignore[assignment]  # pyarrow does without; it takes longest
    import pyarrow as pa  # type: ignore[import-untyped]
    from rerun_bindings import RrdReaderInternal

    content = Path(path).read_bytes()
    _limit(len(content))
    try:
        chunks = RrdReaderInternal(path).stream(store=None).to_chunks()
        batches = [chunk.to_record_batch() for chunk in chunks]
        for batch in batches:
            batch.validate(full=True)
    except ImportError:  # Rerun warns that there is no end, and for that needs all of itself
        return TRUNCATED
    except (RuntimeError, ValueError) as error:
        said = str(error)
        if "incompatible" in said:
            return OTHER_VERSION
        return TRUNCATED if "size" in said or "too small" in said else DAMAGED
    if not _is_whole(content, _stamp(batches)):
        return CHANGED
    for batch in batches:
        with pa.ipc.new_stream(sys.stdout.buffer, batch.schema) as stream:
            stream.write_batch(batch)
    return 0


def _stamp(batches: list[Any]) -> str:
    """The text of the checksum; empty if there is none."""
    for batch in batches:
        if (batch.schema.metadata or {}).get(b"rerun:entity_path") == f"/{CHECKSUM}".encode():
            for name in batch.schema.names:
                if name.endswith(":text"):
                    return str(batch.column(name)[0].as_py()[0])
    return ""


if __name__ == "__main__":
    status = main(sys.argv[1])
    sys.stdout.flush()
    os._exit(status)  # at once, whatever Rerun's threads do

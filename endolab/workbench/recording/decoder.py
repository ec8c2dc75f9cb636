"""Decodes a recording in a process of its own: Rerun's reader ends the process where a file is damaged.

The program that this file is, run by its path, writes what a recording holds to its standard output,
as Arrow's streams one after the other. It takes at most so much memory, and imports nothing of endolab and
not all of Rerun, which would take ten times as long.
"""

import os
import sys


def _limit(size: int) -> None:
    """Give this process, on Linux, a limit of its memory for a file of so many bytes."""
    if sys.platform == "linux":
        import resource

        most = 4 * 2**30 + 20 * size
        resource.setrlimit(resource.RLIMIT_AS, (most, most))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def main(path: str) -> None:
    """Decode a file; any error ends the program with another code than 0."""
    sys.modules["numpy"] = None  # type: ignore[assignment]  # pyarrow does without; it takes longest
    import pyarrow as pa  # type: ignore[import-untyped]
    from rerun_bindings import RrdReaderInternal

    _limit(os.path.getsize(path))
    batches = [
        chunk.to_record_batch()
        for chunk in RrdReaderInternal(path).stream(store=None).to_chunks()
    ]
    for batch in batches:
        batch.validate(full=True)
        with pa.ipc.new_stream(sys.stdout.buffer, batch.schema) as stream:
            stream.write_batch(batch)


if __name__ == "__main__":
    main(sys.argv[1])
    sys.stdout.flush()
    os._exit(0)  # at once, whatever Rerun's threads do

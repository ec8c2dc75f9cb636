"""What was detected in a video, kept in a file as it comes, so that nothing is looked for twice."""

import json
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

import numpy as np

from endolab.calibration.detection.detect import Detection
from endolab.calibration.detection.dots import no_features
from endolab.calibration.session import LEFT_OUT_REASON, Progress, detect_all, silent
from endolab.calibration.targets import Target
from endolab.io.atomic import (
    PathLike,
    check_file,
    one_sentence,
    read_bytes,
    write_atomically,
)
from endolab.io.video import Frames
from endolab.model.cameras import KannalaBrandt

Found = dict[str, Detection]  # by the name of the frame


def read_detections(
    path: Path, head: str, leave_out: Collection[str] = ()
) -> tuple[Found, tuple[int, int] | None]:
    """Read the detections of a file that begins with a `head`, and the frames' width and height.

    A line of JSON is a frame; what is cut off or damaged, or in `leave_out`, is left out. Nothing, and None,
    if the head is another.
    """
    known: Found = {}
    size = None
    first, *lines = read_bytes(path).decode(errors="replace").split("\n")
    for line in lines if first == head else ():
        with suppress(ValueError, TypeError, RecursionError):
            name, (width, height), ids, pixels, reason = json.loads(line)
            if name in leave_out:
                continue
            places = np.array(pixels, dtype=np.float64).reshape(len(ids), 2)
            size = int(width), int(height)
            known[str(name)] = Detection(np.array(ids, dtype=np.int64), places, str(reason))
    return known, size


def _line(name: str, detection: Detection, size: tuple[int, int]) -> str:
    fields = [
        name,
        size,
        detection.ids.tolist(),
        detection.pixels.tolist(),
        detection.reason,
    ]
    return json.dumps(fields) + "\n"


def detect_cached(
    frames: Frames,
    target: Target,
    cache: PathLike,
    *,
    camera: KannalaBrandt | None = None,
    leave_out: Collection[str] = (),
    overwrite: bool = False,
    progress: Progress = silent,
    say: Callable[[str], None] | None = None,
) -> tuple[Found, tuple[int, int] | None]:
    """Find the target in the frames, going on from what a file holds of an earlier call.

    The file's first line says of which frames and which target it is; one that says otherwise is begun
    again. FileExistsError, if it is no such file, unless `overwrite`. `camera` and `leave_out` are as for
    `detect_all`; `say` is told, in a sentence, how many frames were searched before. An interrupt says
    what is kept.
    """
    path = Path(cache)
    sheet = {"kind": target.kind, **asdict(target)}
    # The version of the file, and of the detector: another one detects again.
    head = json.dumps({"endolab_detections": 4, "target": sheet, "files": frames.stamp})
    known: Found = {}
    size = None
    if path.exists():
        begin = b'{"endolab_detections": '
        check_file(path, overwrite=overwrite or read_bytes(path).startswith(begin))
        known, size = read_detections(path, head, leave_out)
    if known and say is not None:
        say(
            f"{len(known)} of {len(frames)} frames were searched before; going on from there"
        )
    # What was read is written again: a line that was cut off must not be gone on with.
    before = [_line(name, entry, size) for name, entry in known.items() if size is not None]
    write_atomically(path, "".join([head, "\n", *before]).encode())

    def keep(name: str, detection: Detection, size: tuple[int, int]) -> None:
        with (
            one_sentence(f"cannot write {path}"),
            path.open("a", encoding="utf-8") as stream,
        ):
            stream.write(_line(name, detection, size))
        known[name] = detection

    rest = [name for name in frames.names if name not in known and name not in leave_out]
    reading = {
        "count": len(rest),
        "progress": progress,
        "keep": keep,
        "size": size,
        "camera": camera,
    }
    try:
        detections, size = detect_all(frames.read(rest), target, **reading)  # type: ignore[arg-type]
    except KeyboardInterrupt:
        progress_so_far = (
            f"interrupted; {len(known)} of {len(frames)} frames are searched and kept"
        )
        raise KeyboardInterrupt(progress_so_far) from None
    finally:
        if not known:  # nothing to go on from
            path.unlink(missing_ok=True)
    everything = known | detections
    everything |= {name: Detection(*no_features(LEFT_OUT_REASON)) for name in leave_out}
    return {name: everything[name] for name in frames.names}, size

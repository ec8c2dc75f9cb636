"""A video as a folder of results: each frame starts from the last, and the same call goes on."""

import csv
import itertools
import json
import math
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from endolab._extras import lacking
from endolab.batch.table import MEASURED, Row, measure_result, write_rows
from endolab.frames.frame import Frame, check_size
from endolab.io.atomic import (
    PathLike,
    as_json,
    check_new,
    name_damage,
    read_bytes,
    read_json,
    say_undrawn,
    write_atomically,
)
from endolab.io.descriptions import write_calibration
from endolab.io.images import read_mask
from endolab.io.surfaces import read_depth, save_depth
from endolab.io.video import Frames, open_frames
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import BoolArray
from endolab.numerics.checks import check_int
from endolab.numerics.iteration import Status
from endolab.reconstruction.light_and_contours import min_steepness_of
from endolab.reconstruction.sequence import (
    Picture,
    State,
    Step,
    as_frame,
    reconstruct_sequence,
)

FRAME_COLUMNS = (
    "index",
    "frame",
    "time",
    "status",
    "warm",
    "min_steepness",
    "unit",
    *MEASURED,
    "gain",
    "median_distance",
    "pixels",
    "error",
)


@dataclass(frozen=True)
class VideoSummary:
    """What `reconstruct_video` leaves in its folder."""

    rows: list[Row]  # of ``frames.csv``, one for each frame that was asked for, in order
    done_before: int  # how many of these an earlier call had done
    paths: tuple[Path, ...]  # what was written


def reconstruct_video(
    source: PathLike,
    calibration: Calibration,
    out: PathLike,
    *,
    mask: PathLike | None = None,
    every: int = 1,
    limit: int | None = None,
    overwrite: bool = False,
    progress: Callable[[int, int, Row], object] | None = None,
    **options: Any,
) -> VideoSummary:
    """Reconstruct the frames of a folder or a video, each from the last, from the first not done on.

    Parameters
    ----------
    source : path
        A folder of pictures, or a video.
    calibration : Calibration
        For pictures of that size.
    out : path
        Becomes a folder with ``frames/NAME/depth.npz``, ``frames.csv``, ``endoscope.json`` as it is used,
        ``report.json`` and at the end, where Rerun is installed, ``recording.rrd``; nothing is written before
        the first frame is done.
    mask : path, optional
        A picture, bright where the frames are to be used.
    every, limit : int
        Of the frames every `every`-th is taken, `limit` at most.
    overwrite : bool
        Begin anew in a folder that holds something, whose files of the same names are replaced.
    progress : callable, optional
        ``progress(done, total, row)`` is called after each frame.
    **options
        Those of `endolab.reconstruct_sequence`, such as JSON can hold.

    Returns
    -------
    VideoSummary
        A row for each frame, and the files that were written.

    Raises
    ------
    ValueError, OSError
        In one sentence, if the folder holds results of another video or of other settings, if no
        frame could be reconstructed, or if something cannot be read or written. After that, an
        interruption or a MemoryError, what is done stays, and the same call goes on.
    """
    check_int("every", every, 1)
    if limit is not None:
        check_int("limit", limit, 1)
    inside = None if mask is None else calibration.cut(read_mask(mask))
    if inside is not None:
        check_size("the mask", inside.shape[::-1], calibration.camera)
    frames = open_frames(source, calibration=calibration)
    wanted = frames.names[::every][:limit]
    if len({Path(name).stem for name in wanted}) < len(wanted):
        raise ValueError(f"{source}: the names of two frames differ in their suffix alone")
    made_with = options | {
        "sequence": str(frames.path.resolve()),
        "mask": None if mask is None else str(mask),
        "calibration": replace(calibration, evidence={}).to_dict(),
        "part": calibration.part,
    }
    folder = _Folder(Path(out), frames, json.loads(json.dumps(made_with)))
    if not overwrite:
        folder.read_done()
    before = list(itertools.takewhile(folder.is_done, wanted))
    done = len(before)
    state = None
    good = [name for name in before if not folder.rows[name]["error"]]
    if good and done < len(wanted):
        (seen,) = _read(frames, good[-1:], inside)
        state = State.restore(
            folder.maps(good[-1])["distance"],
            folder.rows[good[-1]],
            as_frame(*seen),
            calibration,
        )
    pictures = _read(frames, wanted[done:], inside)
    steps = reconstruct_sequence(pictures, calibration, before=state, **options)
    try:
        for step in steps:
            if step.result is not None and step.result.status is Status.STOPPED:
                raise KeyboardInterrupt  # the user's, which ends more than this frame
            folder.add(step)
            done += 1
            if progress is not None:
                progress(done, len(wanted), folder.rows[step.name])
    except KeyboardInterrupt as stop:
        text = f"{done} of {len(wanted)} frames are done and stay, the same command goes on"
        raise KeyboardInterrupt(text) from stop
    rows = [folder.rows[name] for name in wanted]
    made = [row for row in rows if not row["error"]]
    if not made:
        raise ValueError(f"no frame could be reconstructed; the first: {rows[0]['error']}")
    write_calibration(calibration, folder.path / "endoscope.json")
    folder.write()
    names = ("endoscope.json", "frames", "frames.csv", "report.json", "recording.rrd")
    *_, recording = paths = [folder.path / name for name in names]
    if not lacking("rerun") and (len(before) < len(wanted) or not recording.exists()):
        from endolab.workbench.recording.recorder import record_sequence

        shown = (
            (folder.rows[name], as_frame(name, image).image, folder.maps(name))
            for name, image in frames.read([row["frame"] for row in made])
        )
        with say_undrawn(recording, folder.undrawn):
            record_sequence(recording, made[0]["unit"], calibration, shown)
        folder.write()
    return VideoSummary(rows, len(before), tuple(path for path in paths if path.exists()))


def _read(
    frames: Frames, names: Collection[str], mask: BoolArray | None
) -> Iterator[tuple[str, Picture]]:
    """Give names and pictures, within the mask; one of another size is left to be refused."""
    for name, image in frames.read(names):
        if isinstance(image, ValueError) or mask is None or mask.shape != image.shape[:2]:
            yield name, image
        else:
            yield name, Frame(image, mask, name)


@dataclass
class _Folder:
    """Holds ``frames/NAME/depth.npz``, ``frames.csv`` and ``report.json``."""

    path: Path
    frames: Frames
    settings: dict[str, Any]  # of frames made with others nothing is taken
    rows: dict[str, Row] = field(default_factory=dict)  # of the table, by the frame's name
    undrawn: list[str] = field(default_factory=list)  # why there is no recording
    seen: Mapping[str, Any] = field(default_factory=dict)  # the first frame's field of view

    def read_done(self) -> None:
        """Read the table of an earlier call; ValueError in one sentence, if it is of something else."""
        table = self.path / "frames.csv"
        if not table.is_file():
            check_new(self.path)
            return
        expected = (
            "a folder of this video's frames made with these settings; "
            "choose another, or begin anew with overwrite=True"
        )
        with name_damage(self.path, expected):
            report = read_json(self.path / "report.json", "report")
            if report["settings"] != self.settings:
                raise ValueError("other settings")
            self.seen = report["field"]
            lines = read_bytes(table).decode(errors="surrogateescape").splitlines()
            texts = ("frame", "status", "unit", "error")
            for line in csv.DictReader(lines):
                row = {
                    name: line[name] if name in texts else json.loads(line[name] or "NaN")
                    for name in FRAME_COLUMNS
                }
                self.rows[row["frame"]] = row

    def _depth(self, name: str) -> Path:
        return self.path / "frames" / Path(name).stem / "depth.npz"

    def is_done(self, name: str) -> bool:
        """Whether a frame needs not be done again; one that could not be used stays so."""
        row = self.rows.get(name)
        return row is not None and (bool(row["error"]) or self._depth(name).is_file())

    def maps(self, name: str) -> dict[str, np.ndarray]:
        """Read the surface of a frame that is done."""
        return read_depth(self._depth(name), ("distance", "normals"))

    def add(self, step: Step) -> None:
        """Write what became of a frame; a broken one is in the table when the next is written."""
        row = dict.fromkeys(FRAME_COLUMNS, math.nan) | {
            "status": "",
            "unit": "",
            "index": self.frames.names.index(step.name),
            "frame": step.name,
            "time": self.frames.times.get(step.name, math.nan),
            "warm": int(step.warm),
            "seconds": step.seconds,
            "error": " ".join(step.error.split()),
        }
        self.rows[step.name] = row
        result = step.result
        if result is None:
            return
        self.seen = self.seen or result.report.field_seen
        known = result.distance[result.mask]
        row |= measure_result(result) | {
            "unit": result.problem.unit,
            "gain": result.problem.photometry.gain,
            "min_steepness": min_steepness_of(result) or 0,
            "pixels": known.size,
            "median_distance": float(np.median(known)),
        }
        self._depth(step.name).parent.mkdir(parents=True, exist_ok=True)
        save_depth(self._depth(step.name), result, result.metric)
        self.write()

    def write(self) -> None:
        """Write the table and the report."""
        rows = sorted(self.rows.values(), key=lambda row: row["index"])
        write_rows(self.path / "frames.csv", FRAME_COLUMNS, rows)
        units = [row["unit"] for row in rows if not row["error"]]
        report = {
            "endolab": 1,
            "frames": len(self.frames),
            "done": len(units),
            "unit": units[0],
            "field": self.seen,
            "warnings": self.undrawn,
            "settings": self.settings,
        }
        write_atomically(self.path / "report.json", as_json(report))

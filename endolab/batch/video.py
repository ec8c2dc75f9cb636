"""A video's frames as a folder of results: what is done stays, and the next call leaves it out."""

from __future__ import annotations

import json
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from endolab._extras import lacking
from endolab.batch.table import (
    FRAME_COLUMNS,
    TEXT_COLUMNS,
    Row,
    read_rows,
    step_row,
    write_rows,
)
from endolab.frames.frame import Frame
from endolab.io.atomic import (
    PathLike,
    as_json,
    check_new,
    read_json,
    write_atomically,
)
from endolab.io.images import read_mask
from endolab.io.surfaces import read_depth, save_depth
from endolab.io.video import Frames, open_frames
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.checks import check_int
from endolab.numerics.iteration import Status
from endolab.numerics.side_by_side import one_ahead
from endolab.reconstruction.channels import ReadyFrame, prepare_channels
from endolab.reconstruction.sequence import (
    Carried,
    Step,
    Surface,
    as_frame,
    reconstruct_sequence,
)
from endolab.reconstruction.settings import Settings

if TYPE_CHECKING:
    from endolab.workbench.recording.sequence import SequenceRecorder

TABLE = "frames.csv"
REPORT = "report.json"
VIDEO_FILES = ("frames", TABLE, "recording.rrd", REPORT)

# After which what is done stays.
ENDINGS = (KeyboardInterrupt, OSError, MemoryError)

Maps = dict[str, np.ndarray]


@dataclass(frozen=True)
class VideoSummary:
    """What `reconstruct_video` leaves in its folder."""

    rows: list[Row]  # of ``frames.csv``, one for each frame that was asked for, in order
    done_before: int  # how many of these an earlier call had done
    paths: tuple[Path, ...]  # those of `VIDEO_FILES` that are there


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
    """Reconstruct the frames of a folder or a video that are not done yet, each from the last.

    Parameters
    ----------
    source : path
        A folder of pictures, or a video.
    calibration : Calibration
        For pictures of that size.
    out : path
        Becomes a folder with ``frames/NAME/depth.npz``, ``frames.csv``, ``report.json`` and, where Rerun
        is installed, ``recording.rrd``; nothing is written before the first frame is done.
    mask : path, optional
        A picture, bright where the frames are to be used.
    every, limit : int
        Of the frames every `every`-th is taken, `limit` at most.
    overwrite : bool
        Begin anew in a folder that holds something else, whose files of the same names are replaced.
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
    check_int("limit", 1 if limit is None else limit, 1)
    inside = None if mask is None else read_mask(mask)
    frames = open_frames(source)
    wanted = list(frames.names[::every][:limit])
    made_with = {
        **options,
        "sequence": str(frames.path.resolve()),
        "mask": None if mask is None else str(mask),
        "calibration": replace(calibration, evidence={}).to_dict(),
    }
    folder = _Folder(Path(out), frames, calibration, made_with, overwrite)
    folder.find_done()
    before = [name for name in wanted if folder.is_done(name)]
    complete = len(before) == len(wanted) and folder.recording.exists()
    done = len(before)
    last = before[0] if before else None  # of those that are done, the one before
    carried = None
    try:
        pictures = _pictures(frames, [] if complete else wanted, inside)
        make_ready = partial(_make_ready, calibration, options)
        goes_ahead = options.get("threads") != 1  # who allows one core gets one
        coming = (
            (name, picture, make_ready(name, picture))
            if goes_ahead and name not in before
            else (name, picture, None)
            for name, picture in pictures
        )
        for name, picture, ready in one_ahead(coming) if goes_ahead else coming:
            if name in before:
                folder.record(name, picture, folder.maps(name))
                last = name
                carried = None
                continue
            if carried is None and last is not None:
                ((_, seen),) = _pictures(frames, [last], inside)
                carried = folder.take_up(last, as_frame(last, seen))
            (step,) = reconstruct_sequence(
                [(name, ready or picture)], calibration, before=carried, **options
            )
            result = step.result
            if result is not None and result.status is Status.STOPPED:
                raise KeyboardInterrupt  # the user's, which ends more than this frame
            folder.add(step)
            if result is not None:
                carried = step.carried
                maps = {
                    "distance": result.distance,
                    "normals": result.normals,
                }
                folder.record(name, picture, maps)
            done += 1
            if progress is not None:
                progress(done, len(wanted), folder.rows[name])
        rows = [folder.rows[name] for name in wanted]
        if all(row["error"] for row in rows):
            raise ValueError(
                f"no frame could be reconstructed; the first: {rows[0]['error']}"
            )
        folder.close()
    except ENDINGS as failure:
        count = sum(map(folder.is_done, wanted))
        if count == 0:
            raise
        with suppress(OSError):  # there is a failure to tell already
            folder.close_recording()
        reason = str(failure) or "stopped"
        stay = f"{count} of {len(wanted)} frames are done and stay"
        kind = next(kind for kind in ENDINGS if isinstance(failure, kind))
        raise kind(f"{reason}; {stay}, the same command goes on") from failure
    paths = (folder.path / name for name in VIDEO_FILES)
    return VideoSummary(rows, len(before), tuple(path for path in paths if path.exists()))


def _pictures(
    frames: Frames, names: Collection[str], mask: BoolArray | None
) -> Iterator[tuple[str, Frame | FloatArray | None]]:
    """Give names and pictures, within the mask; one of another size is left to be refused."""
    for name, image in frames.read(set(names)):
        if image is not None and mask is not None and mask.shape == image.shape[:2]:
            yield name, Frame(image, mask, name)
        else:
            yield name, image


def _make_ready(
    calibration: Calibration,
    options: dict[str, Any],
    name: str,
    picture: Frame | FloatArray | None,
) -> ReadyFrame | None:
    """Prepare a picture; None if it cannot be: who solves it says why."""
    try:
        frame = as_frame(name, picture)
        channels = prepare_channels(frame, calibration, Settings.of(options))
        _ = channels.full  # else prepared when it is asked for
        return ReadyFrame(frame, channels)
    except (ValueError, OSError, MemoryError):
        return None


@dataclass
class _Folder:
    """Holds ``frames/NAME/depth.npz``, ``frames.csv``, ``report.json`` and, with Rerun, a recording."""

    path: Path
    frames: Frames
    calibration: Calibration
    made_with: dict[str, Any]  # of another folder's frames nothing is taken
    overwrite: bool
    rows: dict[str, Row] = field(default_factory=dict)  # of the table, by the frame's name
    recorder: SequenceRecorder | None = None

    def find_done(self) -> None:
        """Find the frames that an earlier call has done, and whose results can be read.

        ValueError in one sentence, if they were made with anything else, OSError, if the folder is somebody
        else's, and this is not to be replaced.
        """
        try:
            if (self.path / TABLE).is_file():
                self._check_settings()
                self._read_done()
        except ValueError:
            if not self.overwrite:
                raise
        if not self.rows and not self.overwrite:
            check_new(self.path)

    def _check_settings(self) -> None:
        now = json.loads(json.dumps(self.made_with))
        if read_json(self.path / REPORT, "report").get("settings") != now:
            raise ValueError(
                f"{self.path} holds frames of another video, or made with other settings; "
                "choose another folder, or begin anew with overwrite=True"
            )

    def _read_done(self) -> None:
        for row in read_rows(self.path / TABLE, FRAME_COLUMNS, TEXT_COLUMNS):
            name = row["frame"]
            if name in self.frames.names and not row["error"]:
                with suppress(ValueError, OSError):  # it is done again
                    self.maps(name)
                    self.rows[name] = row

    @property
    def recording(self) -> Path:
        """The recording's file."""
        return self.path / "recording.rrd"

    @cached_property
    def _is_stem_enough(self) -> bool:
        stems = {Path(name).stem for name in self.frames.names}
        return len(stems) == len(self.frames)

    def _depth(self, name: str) -> Path:
        own = Path(name).stem if self._is_stem_enough else name
        return self.path / "frames" / own / "depth.npz"

    def maps(self, name: str) -> Maps:
        """Read the surface of a frame that is done."""
        return read_depth(self._depth(name), ("distance", "normals"))

    def is_done(self, name: str) -> bool:
        """Whether a frame needs not be done again."""
        return name in self.rows and not self.rows[name]["error"]

    def take_up(self, name: str, frame: Frame) -> Carried:
        """Return what a frame that is done hands to the next."""
        row = self.rows[name]
        distance = self.maps(name)["distance"].astype(np.float64)
        surface = Surface(distance, row["gain"], row["unit"] == "mm")
        steepness = float(row["min_steepness"])
        return Carried.take_up(surface, frame, self.calibration, steepness, row["energy"])

    def add(self, step: Step) -> None:
        """Write what became of a frame; OSError in one sentence, and what was there stays."""
        row = step_row(step, self.frames.names.index(step.name))
        rows = self.rows | {step.name: row}
        result = step.result
        # That of a broken frame is in the table when the next is written.
        if result is not None:
            if not any(map(self.is_done, self.rows)):
                self.path.mkdir(parents=True, exist_ok=True)
                self._write(self.path, {})
            self._depth(step.name).parent.mkdir(parents=True, exist_ok=True)
            save_depth(self._depth(step.name), result, result.metric)
            self._write(self.path, rows)
        self.rows = rows

    def close(self) -> None:
        """Write the table, with the broken frames, the recording and the report."""
        self.close_recording()
        self._write(self.path, self.rows)

    def _write(self, folder: Path, rows: dict[str, Row]) -> None:
        """Write the table and the report."""
        in_order = sorted(rows.values(), key=lambda row: row["index"])
        write_rows(folder / TABLE, FRAME_COLUMNS, in_order)
        done = [row for row in in_order if not row["error"]]
        content = {
            "endolab": 1,
            "frames": len(self.frames),
            "done": len(done),
            "unit": done[0]["unit"] if done else None,
            "settings": self.made_with,
        }
        write_atomically(folder / REPORT, as_json(content))

    def record(self, name: str, picture: Frame | FloatArray | None, maps: Maps) -> None:
        """Log a frame that is done, where Rerun is installed."""
        if lacking("rerun"):
            return
        from endolab.workbench.recording.sequence import SequenceRecorder

        row = self.rows[name]
        height, width = maps["distance"].shape
        if self.recorder is None:
            self.recorder = SequenceRecorder(self.recording, row["unit"])
            # Once, as its rays take their time.
            self.camera = self.calibration.camera.resize(width, height)
        plotted = ("energy", "iterations", "seconds", "gain", "median_distance")
        self.recorder.log(
            row["index"],
            as_frame(name, picture).image,
            maps["distance"],
            maps["normals"],
            self.camera,
            {key: row[key] for key in plotted},
        )

    def close_recording(self) -> None:
        """Write the recording, if there is something new in it."""
        if self.recorder is not None:
            self.recorder.close()

"""A video's frames as a folder of results: what is done stays, and the next call goes on from there."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import groupby
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
    REPORT,
    PathLike,
    as_json,
    read_json,
    stage_folder,
    write_atomically,
)
from endolab.io.images import read_mask
from endolab.io.surfaces import read_depth, save_depth
from endolab.io.video import Frames, open_frames
from endolab.model.cameras import Camera
from endolab.model.endoscope import Calibration
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.checks import check_int
from endolab.numerics.iteration import Status
from endolab.reconstruction.sentences import meaning
from endolab.reconstruction.sequence import (
    Carried,
    Step,
    Surface,
    as_frame,
    reconstruct_sequence,
)

if TYPE_CHECKING:
    from endolab.workbench.recording.sequence import SequenceRecorder

VIDEO_FILES = ("frames", "frames.csv", "recording.rrd", REPORT)

Pictures = Iterator[tuple[str, Frame | FloatArray | None]]


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
    inputs: tuple[PathLike | None, ...] = (),
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
    inputs : tuple of path
        Files that were read for this, and are never replaced; the source and the mask are not either.
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
    known = replace(calibration, evidence={}).to_dict()
    settings = {
        **options,
        "mask": None if mask is None else str(mask),
        "calibration": known,
    }
    folder = _Folder(Path(out), frames, settings, overwrite, [source, mask, *inputs])
    before = [name for name in wanted if folder.is_done(name)]
    last = next(iter(before), None)
    done = len(before)
    try:
        if before and (done < len(wanted) or not folder.recording.exists()):
            folder.record_again(_pictures(frames, before, inside), calibration.camera)
        for is_done, group in groupby(wanted, key=set(before).__contains__):
            names = list(group)
            if is_done:
                last = names[-1]
                continue
            start = None
            if last is not None:
                ((_, picture),) = _pictures(frames, [last], inside)
                start = folder.take_up(as_frame(last, picture), last, calibration)
            pictures = _pictures(frames, names, inside)
            for step in reconstruct_sequence(
                pictures, calibration, before=start, **options
            ):
                if step.result is not None and step.result.status is Status.STOPPED:
                    raise KeyboardInterrupt  # the user's, which ends more than this frame
                folder.add(step)
                last = step.name if step.result is not None else last
                done += 1
                if progress is not None:
                    progress(done, len(wanted), folder.rows[step.name])
        rows = [folder.rows[name] for name in wanted]
        if all(row["error"] for row in rows):
            raise ValueError(
                f"no frame could be reconstructed; the first: {rows[0]['error']}"
            )
        folder.close()
    except (KeyboardInterrupt, OSError, MemoryError) as failure:
        count = sum(folder.is_done(name) for name in wanted)
        if not count:
            raise
        with suppress(OSError):  # there is a failure to tell already
            folder.close_recording()
        reason = str(failure) or (
            "interrupted" if isinstance(failure, KeyboardInterrupt) else "out of memory"
        )
        kind = OSError if isinstance(failure, OSError) else type(failure)
        stay = f"{count} of {len(wanted)} frames are done and stay"
        raise kind(f"{reason}; {stay}, the same command goes on") from failure
    paths = (folder.path / name for name in VIDEO_FILES)
    return VideoSummary(rows, len(before), tuple(path for path in paths if path.exists()))


def _pictures(frames: Frames, names: list[str], mask: BoolArray | None) -> Pictures:
    """Give names and pictures, within the mask; one of another size is left to be refused."""
    for name, image in frames.read(names):
        if image is not None and mask is not None and mask.shape == image.shape[:2]:
            yield name, Frame(image, mask, name)
        else:
            yield name, image


class _Folder:
    """Holds ``frames/NAME/depth.npz``, ``frames.csv``, ``report.json`` and, with Rerun, a recording.

    Of an earlier call's results, those that can be read are done. ValueError in one sentence, if they are of
    another video or of other settings, OSError, if they are somebody else's, and this is not to `overwrite`.
    """

    def __init__(
        self,
        path: Path,
        frames: Frames,
        settings: dict[str, Any],
        overwrite: bool,
        inputs: list[PathLike | None],
    ) -> None:
        self.path = path
        self.table = path / "frames.csv"
        self.recording = path / "recording.rrd"
        self.rows: dict[str, Row] = {}
        self._settings = json.loads(json.dumps(settings))
        self._overwrite = overwrite
        self._inputs = inputs
        self._source = str(frames.path.resolve())
        self._meaning = list[str]()
        self._index = {name: index for index, name in enumerate(frames.names)}
        self._unique = len({Path(name).stem for name in frames.names}) == len(frames.names)
        self._recorder: SequenceRecorder | None = None
        try:
            if self.table.is_file():
                self._resume()
        except ValueError:
            if not overwrite:
                raise
        if not self.rows:
            with stage_folder(path, overwrite=overwrite):
                pass  # what speaks against it is told before a frame is solved

    def _resume(self) -> None:
        elsewhere = "choose another folder, or begin anew with overwrite=True"
        report = read_json(self.path / REPORT, "report")
        if not (isinstance(report, dict) and isinstance(report.get("settings"), dict)):
            raise ValueError(f"{self.path} holds other results; {elsewhere}")
        if report.get("sequence") != self._source:
            raise ValueError(
                f"{self.path} holds the frames of {report.get('sequence')}; {elsewhere}"
            )
        before = report["settings"]
        for name in sorted({*before, *self._settings}):
            if before.get(name) != self._settings.get(name):
                raise ValueError(
                    f"{self.path} holds frames made with another {name}; {elsewhere}"
                )
        for row in read_rows(self.table, FRAME_COLUMNS, TEXT_COLUMNS):
            if row["frame"] in self._index and not row["error"]:
                with suppress(ValueError, OSError):  # it is done again
                    self._maps(row["frame"])
                    self.rows[row["frame"]] = row
        self._meaning = report.get("meaning", [])

    def _depth(self, name: str) -> Path:
        return (
            self.path / "frames" / (Path(name).stem if self._unique else name) / "depth.npz"
        )

    def _maps(self, name: str) -> dict[str, np.ndarray]:
        return read_depth(self._depth(name), ("distance", "normals"))

    def is_done(self, name: str) -> bool:
        """Whether a frame needs not be done again."""
        return name in self.rows and not self.rows[name]["error"]

    def take_up(self, frame: Frame, name: str, calibration: Calibration) -> Carried:
        """Return what a frame that is done hands to the next."""
        row = self.rows[name]
        distance = self._maps(name)["distance"].astype(np.float64)
        surface = Surface(distance, row["gain"], row["unit"] == "mm")
        return Carried.take_up(
            surface, frame, calibration, float(row["min_steepness"]), row["energy"]
        )

    def add(self, step: Step) -> None:
        """Write what became of a frame; OSError in one sentence, and what was there stays."""
        result = step.result
        row = step_row(step, self._index[step.name])
        if result is not None:
            if not any(map(self.is_done, self.rows)):
                self._begin(list(meaning(result)))
            self._depth(step.name).parent.mkdir(parents=True, exist_ok=True)
            save_depth(self._depth(step.name), result, result.metric)
            self._write_table(self.path, self.rows | {step.name: row})
        # That of a broken frame is in the table when the next is written.
        self.rows[step.name] = row
        if result is not None:
            maps = {"distance": result.distance, "normals": result.normals}
            self._record(step.name, result.problem.shown, maps, result.problem.camera)

    def _begin(self, first: list[str]) -> None:
        """Make it ours, with no frame."""
        self._meaning = first
        with stage_folder(
            self.path, overwrite=self._overwrite, inputs=self._inputs
        ) as staging:
            self._write_table(staging, {})
            self._write_report(staging)

    def close(self) -> None:
        """Write the table, with the broken frames, the recording and the report."""
        self.close_recording()
        self._write_table(self.path, self.rows)
        self._write_report(self.path)

    def _write_table(self, folder: Path, rows: dict[str, Row]) -> None:
        write_rows(
            folder / self.table.name,
            FRAME_COLUMNS,
            sorted(rows.values(), key=lambda row: row["index"]),
        )

    def _write_report(self, folder: Path) -> None:
        done = [row for row in self.rows.values() if not row["error"]]
        content = {
            "endolab": 1,
            "sequence": self._source,
            "frames": len(self._index),
            "done": len(done),
            "unit": done[0]["unit"] if done else None,
            "meaning": self._meaning,
            "broken": {
                name: row["error"] for name, row in self.rows.items() if row["error"]
            },
            "settings": self._settings,
            "files": VIDEO_FILES,
        }
        write_atomically(folder / REPORT, as_json(content))

    def _record(
        self, name: str, picture: FloatArray, maps: dict[str, np.ndarray], camera: Camera
    ) -> None:
        if lacking("rerun"):
            return
        from endolab.workbench.recording.sequence import SequenceRecorder

        row = self.rows[name]
        if self._recorder is None:
            self._recorder = SequenceRecorder(self.recording, row["unit"])
        plotted = ("energy", "iterations", "seconds", "gain", "median_distance")
        scalars = {key: row[key] for key in plotted}
        self._recorder.log(
            row["index"], picture, maps["distance"], maps["normals"], camera, scalars
        )

    def record_again(self, pictures: Pictures, camera: Camera) -> None:
        """Record frames that an earlier call has done."""
        for name, picture in pictures:
            maps = self._maps(name)
            height, width = maps["distance"].shape
            if (camera.width, camera.height) != (
                width,
                height,
            ):  # once: its rays take their time
                camera = camera.resize(width, height)
            self._record(name, as_frame(name, picture).image, maps, camera)

    def close_recording(self) -> None:
        """Write the recording, if there is something new in it."""
        if self._recorder is not None:
            self._recorder.close()

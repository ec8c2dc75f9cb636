"""A video's frames as a folder of results: what is done stays, and the next call goes on from there."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from endolab._extras import lacking
from endolab.batch.table import Row, measured, read_numbers, write_rows
from endolab.io.atomic import PathLike, as_json, staged_folder, write_atomically
from endolab.io.images import read_mask
from endolab.io.surfaces import read_depth, save_depth
from endolab.io.video import Frames, open_frames
from endolab.model.endoscope import Endoscope
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.iteration import Status
from endolab.preprocessing.frame import Frame
from endolab.reconstruction.assumptions import meaning
from endolab.reconstruction.sequence import Step, Surface, reconstruct_sequence

if TYPE_CHECKING:
    from endolab.depth.result import Result
    from endolab.model.cameras import Camera
    from endolab.recording.sequence import SequenceRecorder

ENERGIES = ("energy", "data", "regulariser_energy")
NUMBERS = ("iterations", *ENERGIES, "seconds", "gain", "median_distance", "pixels")
COLUMNS = ("index", "frame", "status", "warm", "unit", *NUMBERS, "error")
PLOTTED = ("energy", "iterations", "seconds", "gain", "median_distance")
FILES = ("frames", "frames.csv", "recording.rrd", "report.json")


@dataclass(frozen=True)
class VideoSummary:
    """What `reconstruct_video` leaves in its folder."""

    rows: list[Row]  # of ``frames.csv``, one for each frame that was asked for, in order
    done_before: int  # how many of these an earlier call had done
    paths: tuple[Path, ...]  # those of `FILES` that are there


def reconstruct_video(
    source: PathLike,
    calibration: Endoscope,
    out: PathLike,
    *,
    mask: PathLike | None = None,
    every: int = 1,
    limit: int | None = None,
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
    progress : callable, optional
        ``progress(done, total, row)`` is called after each frame.
    **options
        Those of `endolab.reconstruct_sequence`, such as JSON can hold.

    Raises
    ------
    ValueError, OSError
        In one sentence, if the folder holds results of another video or of other settings, if no
        frame could be reconstructed, or if something cannot be read or written. After that, an
        interruption or a MemoryError, what is done stays, and the same call goes on.
    """
    for name, value in (("every", every), ("limit", limit)):
        if value is not None and value < 1:
            raise ValueError(f"{name} must be at least 1, got {value}")
    inside = None if mask is None else read_mask(mask)
    frames = open_frames(source)
    wanted = list(frames.names[::every][:limit])
    known = {key: value for key, value in calibration.to_dict().items() if key != "evidence"}
    settings = {**options, "mask": None if mask is None else str(mask), "calibration": known}
    folder = SequenceFolder(out, str(frames.path.resolve()), frames.names, settings)
    recording = _Recording(folder, frames, calibration.camera)
    before = [name for name in wanted if folder.done(name)]
    done = len(before)
    try:
        if recording.possible and before and (done < len(wanted) or not recording.path.exists()):
            recording.begin_again(before)
        for neighbour, names in folder.gaps(wanted):
            surface = None if neighbour is None else folder.surface(neighbour)
            pictures = _pictures(frames, names, inside)
            for step in reconstruct_sequence(pictures, calibration, before=surface, **options):
                if step.result is not None and step.result.status is Status.STOPPED:
                    raise KeyboardInterrupt("interrupted")
                folder.add(step)
                if step.result is not None:
                    recording.add(step.name, step.result)
                done += 1
                if progress is not None:
                    progress(done, len(wanted), folder.rows[step.name])
    except (KeyboardInterrupt, OSError, MemoryError) as failure:
        count = sum(folder.done(name) for name in wanted)
        if not count:
            raise
        with suppress(OSError):  # there is a failure to tell already
            folder.report(wanted)
        with suppress(OSError):
            recording.close()
        said = str(failure) or ("interrupted" if isinstance(failure, KeyboardInterrupt) else "out of memory")
        kind = OSError if isinstance(failure, OSError) else type(failure)
        stay = f"{count} of {len(wanted)} frames are done and stay"
        raise kind(f"{said}; {stay}, the same command goes on") from failure
    rows = [folder.rows[name] for name in wanted]
    if all(row["error"] for row in rows):
        raise ValueError(f"no frame could be reconstructed; the first: {rows[0]['error']}")
    folder.report(wanted)
    recording.close()
    paths = (folder.folder / name for name in FILES)
    return VideoSummary(rows, len(before), tuple(path for path in paths if path.exists()))


class SequenceFolder:
    """Holds ``frames/NAME/depth.npz``, the table ``frames.csv`` and ``report.json``.

    `source` says what the frames are of, `names` are all that it has, and `settings`, JSON, all that a
    frame's result depends on. ValueError or OSError in one sentence, if the folder holds something
    else. Nothing is written before the first frame is done.
    """

    def __init__(self, folder: PathLike, source: str, names: Iterable[str], settings: dict[str, Any]) -> None:
        self.folder, self.source = Path(folder), source
        self.settings = json.loads(as_json(settings))
        self.index = {name: index for index, name in enumerate(names)}  # each frame's place in the source
        self.rows: dict[str, Row] = {}  # what is known of each frame, by its name
        self.meaning: list[str] = []  # of the first frame's numbers, from which the others take their scale
        stems = [Path(name).stem for name in self.index]
        alone = len(set(stems)) == len(stems)
        self._places = dict(zip(self.index, stems if alone else self.index, strict=True))
        if (self.folder / "report.json").exists():
            self._resume()

    def _resume(self) -> None:
        try:
            report = json.loads((self.folder / "report.json").read_text(encoding="utf-8"))
            source, settings = report["sequence"], report["settings"]
            table = self.folder / "frames.csv"
            self.meaning = list(report.get("meaning", ()))
            text = table.read_text(encoding="utf-8") if table.exists() else ""  # stopped just before it
            for cells in csv.DictReader(io.StringIO(text)):
                places = {name: int(cells[name]) for name in ("index", "warm")}
                self.rows[cells["frame"]] = {**cells, **read_numbers(cells, NUMBERS), **places}
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"{self.folder} holds other results; choose another folder") from error
        if source != self.source:
            raise ValueError(f"{self.folder} holds the frames of {source}; choose another folder")
        for name in sorted({*settings, *self.settings}):
            old, new = settings.get(name), self.settings.get(name)
            if old != new:
                told = "" if isinstance(old, dict) or isinstance(new, dict) else f" ({old}, not {new})"
                other = f"another {name}{told}"
                raise ValueError(f"{self.folder} holds frames made with {other}; choose another folder")

    def depth(self, name: str) -> Path:
        """Where a frame's depth map is."""
        return self.folder / "frames" / self._places[name] / "depth.npz"

    def done(self, name: str) -> bool:
        """Whether a frame needs not be done again."""
        return name in self.rows and not self.rows[name]["error"] and self.depth(name).is_file()

    def gaps(self, wanted: list[str]) -> Iterator[tuple[str | None, list[str]]]:
        """Give each row of frames that are still to do, and a neighbour whose scale they take up."""
        there = [name for name in wanted if self.done(name)]  # now: they are done while one goes through this
        before = there[0] if there else None
        for done, names in groupby(wanted, key=set(there).__contains__):
            if done:
                before = list(names)[-1]
            else:
                yield before, list(names)

    def surface(self, name: str) -> Surface:
        """Read what a frame that is done came to."""
        row, path = self.rows[name], self.depth(name)
        try:
            maps = read_depth(path, ("distance", "normals"))
        except (ValueError, OSError) as error:
            raise ValueError(f"{path}: not a depth.npz that endolab wrote; remove it") from error
        distance, normals = (maps[name].astype(np.float64) for name in ("distance", "normals"))
        return Surface(distance, normals, row["gain"], row["unit"] == "mm")

    def add(self, step: Step) -> None:
        """Write what became of a frame; OSError in one sentence, and what was there stays."""
        row: Row = dict.fromkeys(NUMBERS, math.nan)
        row |= {"index": self.index[step.name], "frame": step.name, "status": "", "warm": int(step.warm)}
        row |= {"unit": "", "seconds": step.seconds, "error": " ".join(step.error.split())}
        result = step.result
        if result is not None:
            with staged_folder(self.depth(step.name).parent) as staging:
                save_depth(staging / "depth.npz", result, result.metric)
            known = result.distance[result.mask]
            row |= measured(result) | {"unit": result.problem.unit, "gain": result.problem.photometry.gain}
            row |= {"median_distance": float(np.median(known)), "pixels": known.size}
        first = all(known["error"] for known in self.rows.values())
        self.rows[step.name] = row
        if result is not None and first:
            self.meaning = list(meaning(result))
            self.report([])
        if result is not None or not first:
            rows = sorted(self.rows.values(), key=lambda row: row["index"])
            write_rows(self.folder / "frames.csv", COLUMNS, rows)

    def report(self, wanted: Iterable[str]) -> None:
        """Write ``report.json``; `wanted` are the frames that were asked for."""
        wanted = list(wanted)
        done = [name for name in self.index if self.done(name)]
        broken = {name: row["error"] for name, row in self.rows.items() if row["error"]}
        content = {
            "sequence": self.source,
            "complete": bool(wanted) and all(name in broken or self.done(name) for name in wanted),
            "frames": len(self.index),
            "done": len(done),
            "unit": next((self.rows[name]["unit"] for name in done), None),
            "meaning": self.meaning,
            "broken": broken,
            "settings": self.settings,
        }
        write_atomically(self.folder / "report.json", as_json(content))


def _pictures(
    frames: Frames, names: list[str], mask: BoolArray | None
) -> Iterator[tuple[str, Frame | FloatArray | None]]:
    """Give names and pictures, within the mask; one of another size is left to be refused."""
    for name, image in frames.read(names):
        if image is not None and mask is not None and mask.shape == image.shape[:2]:
            yield name, Frame(image, mask, name)
        else:
            yield name, image


class _Recording:
    """The recording of a folder's frames, begun once there is one; none without Rerun."""

    def __init__(self, folder: SequenceFolder, frames: Frames, camera: Camera) -> None:
        self.folder, self.frames, self.camera = folder, frames, camera
        self.path = folder.folder / "recording.rrd"
        self.possible = not lacking("rerun")
        self.recorder: SequenceRecorder | None = None

    def begin_again(self, names: list[str]) -> None:
        """Log frames that an earlier call has done."""
        for name, picture in self.frames.read(names):
            surface = self.folder.surface(name)
            if picture is not None:
                height, width = surface.distance.shape
                if (self.camera.height, self.camera.width) != (height, width):
                    self.camera = self.camera.resize(width, height)
                self._log(name, picture, surface.distance, surface.normals, self.camera)

    def add(self, name: str, result: Result) -> None:
        """Log a frame."""
        problem = result.problem
        if self.possible:
            self._log(name, problem.shown, result.distance, result.normals, problem.camera)

    def _log(
        self, name: str, picture: FloatArray, distance: FloatArray, normals: FloatArray, camera: Camera
    ) -> None:
        from endolab.recording.sequence import SequenceRecorder

        row = self.folder.rows[name]
        if self.recorder is None:
            self.recorder = SequenceRecorder(self.path, row["unit"])
        scalars = {key: row[key] for key in PLOTTED}
        self.recorder.log(self.folder.index[name], picture, distance, normals, camera, scalars)

    def close(self) -> None:
        """Write it, if there is something new in it."""
        if self.recorder is not None:
            self.recorder.close()

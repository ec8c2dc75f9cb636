"""A video's frames as a folder of results: what is done stays, and the next call goes on from there."""

from __future__ import annotations

import io
import json
import math
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from endolab._extras import lacking
from endolab.batch.table import Row, measured, read_numbers, read_rows, write_rows
from endolab.io.archives import read_arrays
from endolab.io.atomic import ASK, PathLike, as_json, one_sentence, read_json, spare_inputs, write_atomically
from endolab.io.images import read_mask
from endolab.io.surfaces import MAPS, read_depth, save_depth
from endolab.io.video import Frames, open_frames
from endolab.model.endoscope import Endoscope
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.checks import number
from endolab.numerics.iteration import Status
from endolab.preprocessing.frame import Frame
from endolab.reconstruction.assumptions import meaning
from endolab.reconstruction.sequence import HANDED, Carried, Step, Surface, framed, reconstruct_sequence

if TYPE_CHECKING:
    from endolab.depth.result import Result
    from endolab.model.cameras import Camera
    from endolab.recording.sequence import SequenceRecorder

ENERGIES = ("energy", "data", "regulariser_energy")
NUMBERS = ("iterations", *ENERGIES, "seconds", "gain", "median_distance", "pixels")
COLUMNS = ("index", "frame", "status", "warm", "unit", *NUMBERS, "error")
UNITS = ("mm", "relative units")
PLOTTED = ("energy", "iterations", "seconds", "gain", "median_distance")
FILES = ("frames", "frames.csv", "recording.rrd", "report.json")
ELSEWHERE = f"choose another folder, {ASK}"


@dataclass(frozen=True)
class VideoSummary:
    """What `reconstruct_video` leaves in its folder."""

    rows: list[Row]  # of ``frames.csv``, one for each frame that was asked for, in order
    done_before: int  # how many of these an earlier call had done
    doubts: list[str]  # why others that an earlier call had done were done again, a sentence each
    paths: tuple[Path, ...]  # those of `FILES` that are there


def reconstruct_video(
    source: PathLike,
    calibration: Endoscope,
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
    for name, value in options.items():
        if isinstance(value, float):
            number(name, value)
    inside = None if mask is None else read_mask(mask)
    frames = open_frames(source)
    wanted = list(frames.names[::every][:limit])
    known = {key: value for key, value in calibration.to_dict().items() if key != "evidence"}
    settings = {**options, "mask": None if mask is None else str(mask), "calibration": known}
    folder = SequenceFolder(out, str(frames.path.resolve()), frames.names, settings, overwrite)
    spare_inputs([folder.folder / name for name in FILES], [source, mask])
    recording = _Recording(folder, frames, calibration, inside)
    before, gaps = [name for name in wanted if folder.done(name)], folder.gaps(wanted)
    done, ends = len(before), {gap.before for gap in gaps}
    for name in before:
        if name not in ends and (
            name != before[-1] or name == frames.names[-1]
        ):  # else more may be asked for
            folder.forget(name)
    try:
        if recording.possible and before and (gaps or not folder.complete or not recording.path.exists()):
            recording.begin_again(before)
        for gap in gaps:
            last = gap.before
            pictures = _pictures(frames, gap.names, inside)
            start = folder.carried(last, calibration) or folder.surface(last or gap.after)
            for step in reconstruct_sequence(pictures, calibration, before=start, **options):
                if step.result is not None and step.result.status is Status.STOPPED:
                    raise KeyboardInterrupt("interrupted")
                folder.add(step)
                if step.result is not None:
                    recording.add(step.name, step.result)
                    folder.forget(last)
                    last = step.name
                done += 1
                if progress is not None:
                    progress(done, len(wanted), folder.rows[step.name])
            if last in gap.names and (gap.after is not None or last == frames.names[-1]):
                folder.forget(last)  # nothing follows
        rows = [folder.rows[name] for name in wanted]
        if all(row["error"] for row in rows):
            raise ValueError(f"no frame could be reconstructed; the first: {rows[0]['error']}")
        recording.close()
        folder.close(wanted)  # last, so that what is said to be complete is
    except (KeyboardInterrupt, OSError, MemoryError) as failure:
        count = sum(folder.done(name) for name in wanted)
        if not count:
            raise
        with suppress(OSError):  # there is a failure to tell already
            folder.close([])
        with suppress(OSError):
            recording.close()
        said = str(failure) or ("interrupted" if isinstance(failure, KeyboardInterrupt) else "out of memory")
        kind = OSError if isinstance(failure, OSError) else type(failure)
        stay = f"{count} of {len(wanted)} frames are done and stay"
        raise kind(f"{said}; {stay}, the same command goes on") from failure
    doubts = [folder.doubts[name] for name in wanted if name in folder.doubts]
    paths = (folder.folder / name for name in FILES)
    return VideoSummary(rows, len(before), doubts, tuple(path for path in paths if path.exists()))


@dataclass(frozen=True)
class Gap:
    """Frames that are to do, between two that are done."""

    names: list[str]
    before: str | None
    after: str | None


class SequenceFolder:
    """Holds ``frames/NAME/depth.npz``, the table ``frames.csv`` and ``report.json``.

    Beside the depth map of the last frame is what the next one takes up, in ``state.npz``. `source` says
    what the frames are of, `names` are all that it has, and `settings`, JSON, all that a frame's result
    depends on. ValueError or OSError in one sentence, if the folder holds something else and this is not to
    `overwrite` it; what is ours but damaged counts as not done. Nothing is written before the first frame
    is done.
    """

    def __init__(
        self,
        folder: PathLike,
        source: str,
        names: Iterable[str],
        settings: dict[str, Any],
        overwrite: bool = False,
    ) -> None:
        self.folder, self.source = Path(folder), source
        self.settings = json.loads(as_json(settings))
        self.index = {name: index for index, name in enumerate(names)}  # each frame's place in the source
        self.rows: dict[str, Row] = {}  # what is known of each frame, by its name
        self.doubts: dict[str, str] = {}  # why a frame that was done must be done again
        self.complete = False  # whether nothing was left to do when the report was written
        self.meaning: list[str] = []  # of the first frame's numbers, from which the others take their scale
        self._begun = False  # whether the report says that there is something to do
        stems = [Path(name).stem for name in self.index]
        alone = len(set(stems)) == len(stems)
        self._places = dict(zip(self.index, stems if alone else self.index, strict=True))
        self._anew = False  # whether what is there goes when the first frame is done
        try:
            self._resume()
        except (ValueError, FileExistsError):
            if not overwrite:
                raise
            self._anew = True

    def _files(self) -> Iterator[Path]:
        """Give every file that may be there, but for the report."""
        yield from (self.folder / name for name in ("frames.csv", "recording.rrd"))
        yield from (path for name in self.index for path in (self.depth(name), self._state(name)))

    def _resume(self) -> None:
        """Take what is certain of an earlier call's results; ValueError or OSError if there are others."""
        if not os.path.lexists(self.folder / "report.json"):
            for path in self._files():
                if os.path.lexists(path):
                    raise FileExistsError(f"{path} is there already; {ELSEWHERE}")
            return
        try:
            report = read_json(self.folder / "report.json", "report")
            source, settings, known = report["sequence"], report["settings"], report["meaning"]
            kinds = [type(value) for value in (source, settings, known, *known)]
            if kinds != [str, dict, list, *[str] * len(known)]:
                raise TypeError
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{self.folder} holds other results; {ELSEWHERE}") from error
        if source != self.source:
            raise ValueError(f"{self.folder} holds the frames of {source}; {ELSEWHERE}")
        for name in sorted({*settings, *self.settings}):
            old, new = settings.get(name), self.settings.get(name)
            if old != new:
                told = "" if isinstance(old, dict) or isinstance(new, dict) else f" ({old}, not {new})"
                other = f"another {name}{told}"
                raise ValueError(f"{self.folder} holds frames made with {other}; {ELSEWHERE}")
        if os.path.lexists(self.folder / "frames.csv"):  # else stopped just before it
            self._read_rows(self.folder / "frames.csv")
        self.complete, self.meaning = report.get("complete") is True, known

    def _read_rows(self, table: Path) -> None:
        """Take the rows that are certain, and note why others are not."""
        try:
            cells = list(read_rows(table, COLUMNS, "a video's frames"))
        except ValueError as error:
            raise ValueError(f"{error}; remove it, {ELSEWHERE}") from error
        for place, row in cells:
            name = None if row is None else row["frame"]
            if row is None or name not in self.index:
                continue
            self.rows.pop(name, None)
            self.doubts.pop(name, None)
            try:
                known = _read_row(row) | {"index": self.index[name]}
                if not known["error"]:
                    self._check(known)
            except (ValueError, OSError) as error:
                found = str(error) or f"{table}, line {place}: not a row of a frame"
                self.doubts[name] = f"{name} is done again; {found}"
            else:
                self.rows[name] = known

    def _check(self, row: Row) -> None:
        """ValueError or OSError in one sentence, if a frame's depth map is not what its row tells of."""
        path = self.depth(row["frame"])
        maps = read_depth(path, (*MAPS, "mask", "metric"))
        known = maps["distance"][maps["mask"] != 0]
        told = known.size, bool(maps["metric"]), np.isfinite(known).all()
        if told != (row["pixels"], row["unit"] == "mm", True) or not np.isclose(
            np.median(known), row["median_distance"], rtol=1e-5
        ):
            raise ValueError(f"{path}: not the depth map that frames.csv tells of")

    def depth(self, name: str) -> Path:
        """Where a frame's depth map is."""
        return self.folder / "frames" / self._places[name] / "depth.npz"

    def _state(self, name: str) -> Path:
        return self.depth(name).with_name("state.npz")

    def done(self, name: str) -> bool:
        """Whether a frame needs not be done again."""
        return name in self.rows and not self.rows[name]["error"]

    def gaps(self, wanted: list[str]) -> list[Gap]:
        """Give each row of frames that are still to do, and their neighbours."""
        groups = [(done, list(names)) for done, names in groupby(wanted, key=self.done)]
        ends = [None, *((names[0], names[-1]) if done else None for done, names in groups), None]
        around = zip(groups, ends, ends[2:], strict=False)
        return [
            Gap(names, before and before[1], after and after[0])
            for (done, names), before, after in around
            if not done
        ]

    def surface(self, name: str | None) -> Surface | None:
        """Read what a frame that is done came to."""
        if name is None:
            return None
        distance, row = read_depth(self.depth(name))["distance"].astype(np.float64), self.rows[name]
        return Surface(distance, row["gain"], row["unit"] == "mm")

    def carried(self, name: str | None, calibration: Endoscope) -> Carried | None:
        """Read what a frame hands to the next; None if it is not there, or does not go with the frame."""
        if name is None:
            return None
        row, known = self.rows[name], read_depth(self.depth(name))["distance"]

        try:
            arrays = read_arrays(self._state(name), "what a frame hands to the next", HANDED)
            if "log_distance" not in arrays or arrays["log_distance"].shape != known.shape:
                return None
            carried = Carried.from_arrays(arrays, calibration)
        except (ValueError, OSError):
            return None
        problem, found = carried.result.problem, carried.result.distance
        same = (problem.photometry.gain, problem.unit) == (row["gain"], row["unit"])
        return carried if same and np.allclose(found, known, rtol=1e-6, atol=0, equal_nan=True) else None

    def forget(self, name: str | None) -> None:
        """Remove what a frame hands to the next, which has it."""
        if name is not None:
            with suppress(OSError):
                self._state(name).unlink(missing_ok=True)

    def add(self, step: Step) -> None:
        """Write what became of a frame; OSError in one sentence, and what was there stays."""
        row: Row = dict.fromkeys(NUMBERS, math.nan)
        row |= {"index": self.index[step.name], "frame": step.name, "status": "", "warm": int(step.warm)}
        row |= {"unit": "", "seconds": step.seconds, "error": " ".join(step.error.split())}
        result = step.result
        if result is not None:
            known = result.distance[result.mask]
            row |= measured(result) | {"unit": result.problem.unit, "gain": result.problem.photometry.gain}
            row |= {"median_distance": float(np.median(known)), "pixels": known.size}
            self._save(step, result)
            self._write_table(self.rows | {step.name: row})
        self.rows[step.name] = row  # that of a broken frame is in the table when the next is written

    def _write_table(self, rows: dict[str, Row]) -> None:
        in_order = sorted(rows.values(), key=lambda row: row["index"])
        write_rows(self.folder / "frames.csv", COLUMNS, in_order)

    def _save(self, step: Step, result: Result) -> None:
        """Write the files of a frame, all or none; before the first, the report that says whose they are."""
        depth, state, report = self.depth(step.name), self._state(step.name), self.folder / "report.json"
        handed = io.BytesIO()
        arrays: dict[str, Any] = {} if step.carried is None else step.carried.to_arrays()
        np.savez(handed, **arrays)
        with _undone([depth, state, report]):
            if not self._begun:
                _make(self.folder)
                if not any(self.done(name) for name in self.index):
                    self.meaning = list(meaning(result))
                for path in self._files() if self._anew else ():  # else they would pass for what is to come
                    with one_sentence(f"cannot write {path}"):
                        path.unlink(missing_ok=True)
                self._report([])
                self._begun = True
            _make(depth.parent)
            save_depth(depth, result, result.metric)
            write_atomically(state, handed.getvalue())

    def close(self, wanted: list[str]) -> None:
        """Write the table, with the broken frames, and the report; `wanted` are the frames asked for."""
        self._write_table(self.rows)
        self._report(wanted)

    def _report(self, wanted: list[str]) -> None:
        done = [name for name in self.index if self.done(name)]
        broken = {name: row["error"] for name, row in self.rows.items() if row["error"]}
        content = {
            "endolab": 1,
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


def _read_row(cells: dict[str, str]) -> Row:
    """Read a row of ``frames.csv``; ValueError, in which case there may be no sentence, if it is none."""
    try:
        row: Row = {**cells, **read_numbers(cells, NUMBERS), "warm": ["0", "1"].index(cells["warm"])}
    except ValueError:
        raise ValueError from None
    if not 0 <= row["seconds"] < math.inf:
        raise ValueError
    if not row["error"]:
        numbers = [row[name] for name in ("gain", "median_distance", "pixels")]
        told = row["status"] in Status.__members__ and row["unit"] in UNITS and row["iterations"] >= 0
        if not (told and all(0 < number < math.inf for number in numbers)):
            raise ValueError
    return row


def _make(folder: Path) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OSError(f"cannot write to the folder {folder}: {error.strerror}") from error


@contextmanager
def _undone(files: list[Path]) -> Iterator[None]:
    """Leave none of these files that was not there, and no folder of theirs, if the block fails."""
    folders = {folder for file in files for folder in file.parents}
    new = [path for path in (*files, *sorted(folders, reverse=True)) if not os.path.lexists(path)]
    try:
        yield
    except BaseException:
        for path in new:
            with suppress(OSError):
                path.unlink() if path in files else path.rmdir()
        raise


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
    """The recording of a folder's frames, begun once there is one; none without Rerun.

    It shows what the folder keeps, in single precision, so that it is the same whoever did a frame.
    """

    def __init__(
        self, folder: SequenceFolder, frames: Frames, calibration: Endoscope, mask: BoolArray | None
    ) -> None:
        self.folder, self.frames, self.calibration, self.mask = folder, frames, calibration, mask
        self.path = folder.folder / "recording.rrd"
        self.possible = not lacking("rerun")
        self.recorder: SequenceRecorder | None = None

    def begin_again(self, names: list[str]) -> None:
        """Log frames that an earlier call has done."""
        full, gamma = self.calibration.camera, self.calibration.photometry.gamma
        for name, picture in _pictures(self.frames, names, self.mask):
            if picture is None:  # it is broken since
                continue
            frame, maps = framed(name, picture), read_depth(self.folder.depth(name), ("distance", "normals"))
            (height, width), camera = maps["distance"].shape, full
            if (frame.width, frame.height) != (full.width, full.height):  # likewise
                continue
            if (width, height) != (full.width, full.height):
                frame, camera = frame.resize(width, height, gamma), full.resize(width, height)
            self._log(name, frame.image, maps["distance"], maps["normals"], camera)

    def add(self, name: str, result: Result) -> None:
        """Log a frame."""
        problem = result.problem
        if self.possible:
            self._log(name, problem.shown, result.distance, result.normals, problem.camera)

    def _log(
        self, name: str, picture: FloatArray, distance: np.ndarray, normals: np.ndarray, camera: Camera
    ) -> None:
        from endolab.recording.sequence import SequenceRecorder

        row = self.folder.rows[name]
        if self.recorder is None:
            self.recorder = SequenceRecorder(self.path, row["unit"])
        scalars = {key: row[key] for key in PLOTTED}
        distance, normals = distance.astype(np.float32), normals.astype(np.float32)
        self.recorder.log(self.folder.index[name], picture, distance, normals, camera, scalars)

    def close(self) -> None:
        """Write it, if there is something new in it."""
        if self.recorder is not None:
            self.recorder.close()

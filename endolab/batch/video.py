"""The folder of a video's results: what is done stays, and the next call goes on from there."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from endolab.io.atomic import PathLike, as_json, staged_folder, write_atomically
from endolab.io.surfaces import save_depth
from endolab.reconstruction.assumptions import meaning
from endolab.reconstruction.sequence import Step, Surface

if TYPE_CHECKING:
    from endolab.depth.result import Result
    from endolab.io.video import Frames
    from endolab.model.cameras import Camera
    from endolab.preprocessing.frame import Frame
    from endolab.recording.sequence import SequenceRecorder

NUMBERS = (
    *("iterations", "energy", "data", "regulariser_energy", "seconds", "gain"),
    *("median_distance", "pixels"),
)
COUNTS = ("iterations", "pixels")
COLUMNS = ("index", "frame", "status", "warm", "unit", *NUMBERS, "error")
PLOTTED = ("energy", "iterations", "seconds", "gain", "median_distance")

Row = dict[str, Any]


class SequenceFolder:
    """Holds ``frames/NAME/depth.npz``, the table ``frames.csv`` and ``report.json``.

    Parameters
    ----------
    folder : path
        Nothing is written before the first frame is done.
    source : str
        What the frames are of.
    names : iterable of str
        Of all frames that the source has.
    settings : dict
        All that a frame's result depends on; JSON.

    Attributes
    ----------
    rows : dict of str to dict
        What is known of each frame, by its name.
    meaning : list of str
        What the numbers of the first frame that was done mean; the others take their scale from it.

    Raises
    ------
    ValueError, OSError
        In one sentence, if the folder holds results of something else.
    """

    def __init__(self, folder: PathLike, source: str, names: Iterable[str], settings: dict[str, Any]) -> None:
        self.folder, self.source = Path(folder), source
        self.settings = json.loads(as_json(settings))
        self.rows: dict[str, Row] = {}
        self.meaning: list[str] = []
        self.names = tuple(names)
        stems = [Path(name).stem for name in self.names]
        alone = len(set(stems)) == len(stems)
        self._places = dict(zip(self.names, stems if alone else self.names, strict=True))
        if (self.folder / "report.json").exists():
            self._resume()

    def _resume(self) -> None:
        try:
            report = json.loads((self.folder / "report.json").read_text(encoding="utf-8"))
            found = report["sequence"], report["settings"]
            table = self.folder / "frames.csv"
            self.meaning = list(report.get("meaning", ()))
            text = table.read_text(encoding="utf-8") if table.exists() else ""  # stopped just before it
            reader = csv.DictReader(io.StringIO(text))
            for cells in reader:
                row: Row = dict(cells)
                row |= {name: float(cells[name] or "nan") for name in NUMBERS}
                row |= {name: int(row[name]) for name in COUNTS if cells[name]}
                self.rows[row["frame"]] = row | {"index": int(row["index"])}
        except (ValueError, KeyError, TypeError) as error:
            raise ValueError(f"{self.folder} holds other results; choose another folder") from error
        if found[0] != self.source:
            raise ValueError(f"{self.folder} holds the frames of {found[0]}; choose another folder")
        for name in sorted({*found[1], *self.settings}):
            old, new = found[1].get(name), self.settings.get(name)
            if old != new:
                told = "" if isinstance(old, dict) or isinstance(new, dict) else f" ({old}, not {new})"
                raise ValueError(
                    f"{self.folder} holds frames made with another {name}{told}; choose another folder"
                )

    def depth(self, name: str) -> Path:
        """Where a frame's depth map is."""
        return self.folder / "frames" / self._places[name] / "depth.npz"

    def done(self, name: str) -> bool:
        """Whether a frame needs not be done again."""
        return name in self.rows and not self.rows[name]["error"] and self.depth(name).is_file()

    def surface(self, name: str) -> Surface:
        """Read what a frame that is done came to."""
        row, path = self.rows[name], self.depth(name)
        try:
            with np.load(path, allow_pickle=False) as archive:
                distance, normals = (archive[key].astype(np.float64) for key in ("distance", "normals"))
        except (ValueError, OSError, EOFError, KeyError) as error:
            raise ValueError(f"{path}: not a depth.npz that endolab wrote; remove it") from error
        return Surface(distance, normals, row["gain"], row["unit"] == "mm")

    def add(self, index: int, step: Step) -> None:
        """Write what became of a frame.

        Parameters
        ----------
        index : int
            Of the frame in its source.
        step : Step

        Raises
        ------
        OSError
            In one sentence, if it cannot be written; what was there stays.
        """
        row: Row = dict.fromkeys(NUMBERS, math.nan)
        row |= {"index": index, "frame": step.name, "status": "", "warm": int(step.warm), "unit": ""}
        row |= {"error": " ".join(step.error.split()), "seconds": step.seconds}
        result = step.result
        if result is not None:
            first = not any(not known["error"] for known in self.rows.values())
            with staged_folder(self.depth(step.name).parent) as staging:
                save_depth(
                    staging / "depth.npz",
                    result.distance,
                    result.z,
                    result.normals,
                    result.mask,
                    result.metric,
                )
            terms = result.iterate.terms
            row |= {
                "status": result.status.name,
                "unit": result.problem.unit,
                "iterations": result.iterations,
                "energy": result.energy,
                "data": terms.get("data", math.nan),
                "regulariser_energy": terms.get("regulariser", math.nan),
                "gain": result.problem.photometry.gain,
                "median_distance": float(np.median(result.distance[result.mask])),
                "pixels": int(result.mask.sum()),
            }
            self.rows[step.name] = row
            if first:
                self.meaning = list(meaning(result))
                self.report([])
        self.rows[step.name] = row
        if any(not known["error"] for known in self.rows.values()):
            self._write_table()

    def _write_table(self) -> None:
        text = io.StringIO()
        writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
        writer.writeheader()
        for row in sorted(self.rows.values(), key=lambda row: row["index"]):
            writer.writerow({name: "" if row[name] != row[name] else row[name] for name in COLUMNS})
        write_atomically(self.folder / "frames.csv", text.getvalue().encode())

    def report(self, wanted: Iterable[str]) -> None:
        """Write ``report.json``; `wanted` are the frames that were asked for."""
        wanted = list(wanted)
        done = [name for name in self.names if self.done(name)]
        broken = {name: row["error"] for name, row in self.rows.items() if row["error"]}
        content = {
            "sequence": self.source,
            "complete": bool(wanted) and all(name in broken or self.done(name) for name in wanted),
            "frames": len(self.names),
            "done": len(done),
            "unit": next((self.rows[name]["unit"] for name in done), None),
            "meaning": self.meaning,
            "broken": broken,
            "settings": self.settings,
        }
        write_atomically(self.folder / "report.json", as_json(content))


def _gaps(wanted: list[str], folder: SequenceFolder) -> Iterator[tuple[str | None, list[str]]]:
    """Give each row of frames that are still to do, and a neighbour whose scale they take up."""
    state = [(name, folder.done(name)) for name in wanted]
    first = next((name for name, there in state if there), None)
    before: str | None = None
    gap: list[str] = []
    for name, there in state:
        if not there:
            gap.append(name)
            continue
        if gap:
            yield before or first, gap
        before, gap = name, []
    if gap:
        yield before, gap


def _pictures(frames: Frames, names: list[str], mask: Any) -> Iterator[tuple[str, Frame | Any]]:
    """Give names and pictures, within the mask; one of another size is left to be refused."""
    from endolab.preprocessing.frame import Frame

    for name, image in frames.read(names):
        if image is not None and mask is not None and mask.shape == image.shape[:2]:
            yield name, Frame(image, mask, name)
        else:
            yield name, image


class _Recording:
    """The recording of a folder's frames, begun once there is one."""

    def __init__(self, folder: SequenceFolder, frames: Frames, camera: Camera) -> None:
        self.folder, self.frames, self.camera = folder, frames, camera
        self.path = Path(folder.folder) / "recording.rrd"
        self.recorder: SequenceRecorder | None = None
        self.number = {name: index for index, name in enumerate(frames.names)}

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
        picture = problem.image if problem.picture is None else problem.picture
        self._log(name, picture, result.distance, result.normals, problem.camera)

    def _log(self, name: str, picture: Any, distance: Any, normals: Any, camera: Camera) -> None:
        from endolab.batch.video import PLOTTED
        from endolab.recording.sequence import SequenceRecorder

        row = self.folder.rows[name]
        if self.recorder is None:
            self.recorder = SequenceRecorder(self.path, row["unit"])
        scalars = {key: row[key] for key in PLOTTED}
        self.recorder.log(self.number[name], picture, distance, normals, camera, scalars)

    def close(self) -> None:
        """Write it, if there is something new in it."""
        if self.recorder is not None:
            self.recorder.close()

"""The folder of a video's results: what is done stays, and the next call goes on from there."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from endolab.files import PathLike, as_json, save_depth, staged_folder, write_atomically
from endolab.scale import meaning
from endolab.sequence import Step, Surface

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

"""Recordings read back: curves, depth maps and normals of a run, without the solver."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from endolab.depth.result import SOLUTION
from endolab.io.atomic import PathLike
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.recording.layouts import TIMELINE
from endolab.recording.stream import stage_of

# Rows of a component: iteration (None if it stays) to its arrow values.
Rows = dict[int | None, Any]


def read_recording(path: PathLike) -> Recording:
    """Read a recording that `record` or a `Comparison` has written.

    Parameters
    ----------
    path : path
        The ``.rrd`` file.

    Raises
    ------
    FileNotFoundError, ValueError
        In one sentence, if there is no such file, or it is no recording, truncated, damaged, or of
        another version of Rerun.
    """
    entities: dict[str, dict[str, Rows]] = {}
    for chunk in _chunks(Path(path)):
        batch = chunk.to_record_batch()
        entity = (batch.schema.metadata or {}).get(b"rerun:entity_path", b"").decode()
        timed = TIMELINE in batch.schema.names
        at: list[int | None] = batch.column(TIMELINE).to_pylist() if timed else [None] * len(batch)
        for name in batch.schema.names:
            if ":" in name:
                column = batch.column(name)
                rows = entities.setdefault(entity, {}).setdefault(name.split(":")[1], {})
                rows |= {k: column[i].values for i, k in enumerate(at) if column[i].is_valid}
    return Recording(Path(path), entities)


def _chunks(path: Path) -> list[Any]:
    """Whole content of a file; `rerun rrd verify` is content with any file, so read it."""
    if not path.is_file():
        raise FileNotFoundError(f"there is no recording {path}")
    with path.open("rb") as stream:
        head = stream.read(8)
    if not head:
        raise ValueError(f"{path} is empty: the recording was never written")
    if head[:3] != b"RRF":
        raise ValueError(f"{path} is no Rerun recording: expected a file that begins with RRF")
    theirs, ours = tuple(head[4:6]), tuple(int(part) for part in rr.__version__.split(".")[:2])
    version = f"Rerun {'.'.join(map(str, theirs))}, and here is {rr.__version__}"
    if head[3:4] != b"2" or (len(head) == 8 and theirs > ours):
        raise ValueError(f"{path} was written by another version: {version}")
    try:
        with warnings.catch_warnings(record=True) as complaints:
            warnings.simplefilter("always")
            chunks = list(rr.chunk.RrdReader(path).stream().to_chunks())
    except (RuntimeError, ValueError) as error:
        if "incompatible" in str(error):
            raise ValueError(f"{path} was written by another version: {version}") from error
        what = "truncated" if "size" in str(error) or "too small" in str(error) else "damaged"
        raise ValueError(f"{path} is {what}: record the run again") from error
    if any("footer" in str(complaint.message) for complaint in complaints):
        raise ValueError(f"{path} is truncated: record the run again")
    return chunks


class Recording:
    """A recording of the file `path`, or one run of it."""

    # Of each entity the rows of each component; without a run, it is the only one.
    def __init__(self, path: Path, entities: dict[str, dict[str, Rows]], run: str | None = None) -> None:
        self.path, self._entities, self._run = path, entities, run

    def __repr__(self) -> str:
        return f"<Recording {self.path}: {', '.join(map(repr, self.runs)) or 'no run'}>"

    @property
    def runs(self) -> dict[str, Recording]:
        """Runs by name; one that was recorded alone is called ''."""
        end, names = "/plots/energy", [self._run or ""]
        if self._run is None:
            names = [name.removesuffix(end).lstrip("/") for name in self._entities if name.endswith(end)]
        return {name: Recording(self.path, self._entities, name) for name in names}

    @property
    def _start(self) -> str:
        """What the entities of the run begin with."""
        names = list(self.runs)
        if len(names) > 1:
            raise ValueError(f"{self.path} holds several runs: choose one, .runs[{names[0]!r}]")
        if not names:
            raise ValueError(f"{self.path} holds no reconstruction")
        return f"/{names[0]}/" if names[0] else "/"

    def _rows(self, entity: str, component: str) -> Rows:
        return self._entities.get(self._start + entity, {}).get(component, {})

    @property
    def scalars(self) -> dict[str, tuple[NDArray[np.int64], FloatArray]]:
        """Energy, its terms, change and the solver's scalars: iterations and values, (n,) each."""
        start, found = f"{self._start}plots/", {}
        for name in (entity.removeprefix(start) for entity in self._entities if entity.startswith(start)):
            rows = self._timed(f"plots/{name}", "scalars")
            values = np.array([row[0].as_py() for row in rows.values()], float)
            found[name] = np.array(list(rows), int), values
        return dict(sorted(found.items(), key=lambda item: item[0] != "energy"))

    def _timed(self, entity: str, component: str) -> dict[int, Any]:
        rows = self._rows(entity, component)
        return {k: rows[k] for k in sorted(k for k in rows if k is not None)}

    def table(self) -> NDArray[np.void]:
        """All scalars, one row per iteration: a structured array (n,) with the field "iteration".

        ``recording.table()["energy"]`` is a column; what was not logged is nan.
        """
        scalars = self.scalars
        iterations = np.unique(np.concatenate([at for at, _ in scalars.values()]))
        table = np.empty(len(iterations), dtype=[("iteration", int), *((n, float) for n in scalars)])
        table["iteration"] = iterations
        for name, (at, values) in scalars.items():
            table[name] = np.nan
            table[name][np.searchsorted(iterations, at)] = values
        return table

    @property
    def pictured(self) -> tuple[int, ...]:
        """Iterations with pictures: the others have scalars only."""
        return tuple(self._timed("depth", "buffer"))

    @property
    def stages(self) -> list[tuple[int, str, int]]:
        """Stages of the run: first iteration, name, and round (0 if there is one only)."""
        texts = {k or 0: stage_of(text[0].as_py()) for k, text in self._rows("stage", "text").items()}
        first = int(self.scalars["energy"][0][0])
        return [(k, *texts[k]) for k in sorted(texts)] or [(first, SOLUTION, 0)]

    def _standing(self, entity: str, component: str, k: int | None = None) -> Any:
        """What stays for a run or a stage, at an iteration; by default at the end."""
        rows = self._rows(entity, component)
        return rows[max((at for at in rows if at is not None and (k is None or at <= k)), default=None)]

    @property
    def unit(self) -> str:
        """Of distances: "mm", or "relative units" where the gain was unknown; of the last stage."""
        meter = self._rows("depth", "meter")[self._chosen(-1)][0].as_py()
        return "mm" if meter == 1000 else "relative units"

    @property
    def mask(self) -> BoolArray:
        """Pixels that took part, (h, w); of the last stage."""
        return self._mask()

    def _mask(self, k: int | None = None) -> BoolArray:
        values, form = (self._standing("mask", component, k) for component in ("buffer", "format"))
        return _array(values, form, np.uint8).astype(bool)

    @property
    def picture(self) -> FloatArray:
        """The frame as it looked, (h, w, 3), in [0, 1]; maybe thinned; of the last stage."""
        return _decoded(self._standing("input", "blob"))

    @property
    def settings(self) -> str:
        """What was solved and how, as Markdown; of the last stage."""
        return str(self._standing("settings", "text")[0].as_py())

    def depth(self, iteration: int = -1) -> FloatArray:
        """Distance at an iteration of `pictured`, (h, w), in `unit`; nan outside the mask; -1 is the last.

        Thinned if the frame was wider than the recording. An earlier stage may be on a smaller grid
        and in relative units. ValueError if the iteration has no picture.
        """
        k = self._chosen(iteration)
        values, form = (self._rows("depth", component)[k] for component in ("buffer", "format"))
        return _array(values, form, np.float32).astype(float)

    def normals(self, iteration: int = -1) -> FloatArray:
        """Unit normals at an iteration, (h, w, 3), to half a degree; nan outside the mask; see `depth`."""
        k = self._chosen(iteration)
        colours = _decoded(self._rows("normals", "blob")[k])
        n = np.where(self._mask(k)[..., None], 2 * colours - 1, np.nan)
        return n / np.linalg.norm(n, axis=-1, keepdims=True)

    def _chosen(self, iteration: int) -> int:
        pictured = self.pictured
        if not pictured:
            raise ValueError(f"{self.path} holds no depth maps")
        k = pictured[-1] if iteration == -1 else iteration
        if k not in pictured:
            nearest = min(pictured, key=lambda other: abs(other - k))
            raise ValueError(f"iteration {iteration} has no picture; the nearest that has is {nearest}")
        return k


def _array(values: Any, form: Any, dtype: type) -> NDArray:
    """A picture from its bytes and its format."""
    shape: Mapping[str, int] = form[0].as_py()
    return np.frombuffer(_bytes(values).tobytes(), dtype).reshape(shape["height"], shape["width"])


def _decoded(blob: Any) -> FloatArray:
    stored: Any = cv2.imdecode(_bytes(blob), cv2.IMREAD_COLOR)
    return np.asarray(stored[..., ::-1] / 255.0)


def _bytes(values: Any) -> NDArray[np.uint8]:
    return np.asarray(values.flatten().to_numpy(zero_copy_only=False).astype(np.uint8))

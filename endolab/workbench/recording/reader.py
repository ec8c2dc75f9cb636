"""Recordings read back: curves, depth maps and normals of a run, without the solver."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from endolab.io.atomic import PathLike
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.checks import PATH, check_kinds
from endolab.workbench.recording.layouts import ITERATIONS

# By entity and component, Arrow's values of each iteration (None if they stay).
Entities = dict[str, dict[str, dict[int | None, Any]]]


@check_kinds(path=PATH)
def read_recording(path: PathLike) -> Recording:
    """Read a recording that `record` or a `Comparison` has written.

    Parameters
    ----------
    path : path
        The ``.rrd`` file.

    Returns
    -------
    Recording
        Curves, depth maps and normals by iteration; of several runs, `runs` has each.

    Raises
    ------
    OSError, ValueError
        In one sentence, if there is no such file, or it is no recording, cut off, or of another version of
        Rerun. Bytes that have changed within a file can end the process, in Rerun's own reader.

    Examples
    --------
    >>> import endolab as el
    >>> sample = el.load_traced("matt")  # a frame that comes with endolab
    >>> with el.record("run.rrd") as recorder:
    ...     result = el.reconstruct(sample.frame, sample.calibration, width=96, observers=[recorder])
    >>> recording = el.read_recording("run.rrd")
    >>> recording.unit, recording.depth().shape
    ('mm', (72, 96))
    """
    file = Path(path)
    if not file.is_file():
        raise FileNotFoundError(f"there is no recording {file}")
    entities: Entities = {}
    try:
        chunks = rr.chunk.RrdReader(file).stream().to_chunks()
        batches = [chunk.to_record_batch() for chunk in chunks]
    except Exception as error:  # of whatever kind Rerun's reader raises
        text = f"{file} is damaged, of another version than Rerun {rr.__version__}, or no recording"
        raise ValueError(text) from error
    # As it was logged.
    for batch in sorted(batches, key=lambda batch: batch.column(0)[0].as_py()):
        _take(batch, entities)
    return Recording(file, entities)


def _take(batch: Any, entities: Entities) -> None:
    """Sort the rows of a batch by entity, component and iteration."""
    entity = batch.schema.metadata[b"rerun:entity_path"].decode()
    at: list[int | None] = [None] * len(batch)
    if ITERATIONS in batch.schema.names:
        at = batch.column(ITERATIONS).to_pylist()
    for name in batch.schema.names:
        if ":" in name:
            column = batch.column(name)
            rows = entities.setdefault(entity, {}).setdefault(name.split(":")[1], {})
            rows |= {k: column[i].values for i, k in enumerate(at) if column[i].is_valid}


@dataclass(frozen=True, repr=False)
class Recording:
    """A recording of the file `path`, or one run of it."""

    path: Path
    entities: Entities  # of each the rows of each component
    run: str | None = None  # none: it is the only one

    def __repr__(self) -> str:
        return f"<Recording {self.path}: {', '.join(map(repr, self.runs)) or 'no run'}>"

    @property
    def runs(self) -> dict[str, Recording]:
        """Runs by name; one that was recorded alone is called ''."""
        names = [self.run or ""]
        if self.run is None:
            # Pictures over the iterations: other recordings of ours are over frames.
            depths = [name for name in self.entities if self._at(name, "depth_range")]
            names = [name.removesuffix("depth").strip("/") for name in depths]
        return {name: Recording(self.path, self.entities, name) for name in names}

    @property
    def _start(self) -> str:
        """What the entities of the run begin with."""
        names = list(self.runs)
        if len(names) != 1:
            raise ValueError(f"{self.path} holds several runs or none: .runs is {names}")
        return f"/{names[0]}/" if names[0] else "/"

    def _at(self, entity: str, component: str) -> list[int]:
        """Iterations at which an entity, by its whole path, has a component."""
        rows = self.entities.get(entity, {}).get(component, {})
        return sorted(k for k in rows if k is not None)

    def _values(self, entity: str, component: str, k: int | None = None) -> Any:
        """What an entity of the run has at an iteration, or had last before; by default, at the end."""
        entity = self._start + entity
        at = self._at(entity, component)
        last = max(before for before in at if k is None or before <= k)
        return self.entities[entity][component][last]

    @property
    def history(self) -> list[dict[str, float]]:
        """A row per iterate as in `Result.history`: k, energy, its terms, change and the solver's scalars."""
        start = f"{self._start}plots/"
        names = [name for name in self.entities if name.startswith(start)]
        rows = []
        for k in self._at(f"{start}energy", "scalars"):
            row: dict[str, float] = {"k": k}
            for name in names:
                value = self.entities[name]["scalars"].get(k)
                row[name.removeprefix(start)] = value[0].as_py() if value else np.nan
            rows.append(row)
        return rows

    def table(self) -> NDArray[np.void]:
        """The history as a structured array, (n,), with the field "iteration".

        ``recording.table()["energy"]`` is a column; what was not logged is nan.
        """
        history = self.history
        fields = [("iteration", int), *((name, float) for name in list(history[0])[1:])]
        return np.array([tuple(row.values()) for row in history], fields)

    @property
    def pictured(self) -> tuple[int, ...]:
        """Iterations with pictures: the others have scalars only."""
        return tuple(self._at(f"{self._start}depth", "buffer"))

    @property
    def unit(self) -> str:
        """Of distances: "mm", or "relative units" where the gain was unknown; of the last stage."""
        metric = self._values("depth", "meter")[0].as_py() == 1000
        return "mm" if metric else "relative units"

    @property
    def mask(self) -> BoolArray:
        """Pixels that took part, (h, w); of the last stage."""
        return self._map("mask", np.uint8).astype(bool)

    @property
    def picture(self) -> FloatArray:
        """The frame as it looked, (h, w, 3); of the last stage, in [0, 1]."""
        return self._map("input", np.uint8, None, 3) / 255.0

    def depth(self, iteration: int = -1) -> FloatArray:
        """Distance at an iteration of `pictured`, (h, w), in `unit`; nan outside the mask; -1 is the last.

        Thinned if the frame was wider than the recording. An earlier stage may be on a smaller grid
        and in relative units. ValueError if the iteration has no picture.
        """
        k = self._choose_iteration(iteration)
        return self._map("depth", np.float32, k).astype(float)

    def normals(self, iteration: int = -1) -> FloatArray:
        """Unit normals at an iteration, (h, w, 3), to half a degree; nan outside the mask; see `depth`."""
        k = self._choose_iteration(iteration)
        n = self._map("normals", np.uint8, k, 3) / 127.5 - 1
        n[np.isnan(self.depth(k))] = np.nan
        return n / np.linalg.norm(n, axis=-1, keepdims=True)

    def _choose_iteration(self, iteration: int) -> int:
        pictured = self.pictured
        k = pictured[-1] if iteration == -1 else iteration
        if k not in pictured:
            raise ValueError(
                f"iteration {k} has no picture: those that have are {pictured}"
            )
        return k

    def _map(self, entity: str, kind: type, k: int | None = None, *depth: int) -> NDArray:
        """A picture of raw values, (h, w), or of so many channels."""
        form = self._values(entity, "format", k)[0].as_py()
        content = self._values(entity, "buffer", k).flatten().to_numpy()
        return np.asarray(content.view(kind).reshape(form["height"], form["width"], *depth))

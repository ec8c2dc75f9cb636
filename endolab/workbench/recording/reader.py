"""Recordings read back: curves, depth maps and normals of a run, without the solver."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from endolab.io.atomic import PathLike
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.checks import PATH, check_kinds
from endolab.workbench.recording.layouts import ITERATIONS

# Of "/entity:component", Arrow's values by iteration, as they were logged.
Rows = dict[str, dict[int, Any]]
DEPTHS = "/depth:buffer"


@check_kinds(path=PATH)
def read_recording(path: PathLike) -> Recording:
    """Read a recording that `record` has written.

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
    try:
        chunks = rr.chunk.RrdReader(file).stream().filter(has_timeline=ITERATIONS)
        found = [(chunk.entity_path, chunk.to_record_batch()) for chunk in chunks]
    except Exception as error:  # of whatever kind Rerun's reader raises
        text = f"{file} is damaged, of another version than Rerun {rr.__version__}, or no recording"
        raise ValueError(text) from error
    rows: Rows = {}
    # As it was logged.
    for entity, batch in sorted(found, key=lambda one: one[1].column(0)[0].as_py()):
        at = batch.column(ITERATIONS).to_pylist()
        for name in batch.schema.names:
            if ":" in name:
                of = rows.setdefault(f"{entity}:{name.split(':')[1]}", {})
                cells = zip(at, batch.column(name), strict=True)
                of |= {k: cell.values for k, cell in cells if cell.is_valid}
    return Recording(file, rows)


@dataclass(frozen=True, repr=False)
class Recording:
    """A recording of the file `path`, or one run of it."""

    path: Path
    rows: Rows
    start: str = ""  # of one run's entities

    def __repr__(self) -> str:
        return f"<Recording {self.path}: {', '.join(map(repr, self.runs)) or 'no run'}>"

    @property
    def runs(self) -> dict[str, Recording]:
        """Runs by name; one that was recorded alone is called ''."""
        starts = [name.removesuffix(DEPTHS) for name in self.rows if name.endswith(DEPTHS)]
        return {start.strip("/"): replace(self, start=start) for start in starts}

    def _of(self, name: str) -> dict[int, Any]:
        if self.start + name not in self.rows:
            names = list(self.runs)
            raise ValueError(f"{self.path} holds several runs or none: .runs is {names}")
        return self.rows[self.start + name]

    def table(self) -> NDArray[np.void]:
        """A row per iterate, (n,): "iteration", energy, its terms, change and the solver's scalars.

        ``recording.table()["energy"]`` is a column; what was not logged is nan.
        """
        at = list(self._of("/plots/energy:scalars"))
        start = f"{self.start}/plots/"
        curves = {
            name.removeprefix(start).removesuffix(":scalars"): rows
            for name, rows in self.rows.items()
            if name.startswith(start)
        }
        table = np.zeros(len(at), [("iteration", int), *((name, float) for name in curves)])
        table["iteration"] = at
        for name, rows in curves.items():
            table[name] = [rows[k][0].as_py() if k in rows else np.nan for k in at]
        return table

    @property
    def pictured(self) -> tuple[int, ...]:
        """Iterations with pictures: the others have scalars only."""
        return tuple(sorted(self._of(DEPTHS)))

    @property
    def unit(self) -> str:
        """Of distances: "mm", or "relative units" where the gain was unknown; of the last stage."""
        last = self.pictured[-1]
        is_metric = self._of("/depth:meter")[last][0].as_py() == 1000
        return "mm" if is_metric else "relative units"

    @property
    def mask(self) -> BoolArray:
        """Pixels that took part, (h, w); of the last stage."""
        return np.isfinite(self.depth())

    @property
    def picture(self) -> FloatArray:
        """The frame as it looked, (h, w, 3); of the last stage, in [0, 1]."""
        return self._map("input", np.uint8, -1) / 255.0

    def depth(self, iteration: int = -1) -> FloatArray:
        """Distance at an iteration of `pictured`, (h, w), in `unit`; nan outside the mask; -1 is the last.

        Thinned if the frame was wider than the recording. An earlier stage may be on a smaller grid
        and in relative units. ValueError if the iteration has no picture.
        """
        return self._map("depth", np.float32, iteration)[..., 0].astype(float)

    def normals(self, iteration: int = -1) -> FloatArray:
        """Unit normals at an iteration, (h, w, 3), to half a degree; nan outside the mask; see `depth`."""
        n = self._map("normals", np.uint8, iteration) / 127.5 - 1
        n[np.isnan(self.depth(iteration))] = np.nan
        return n / np.linalg.norm(n, axis=-1, keepdims=True)

    def _map(self, entity: str, kind: type, iteration: int) -> NDArray:
        """A picture of raw values, (h, w, 1 or 3), at an iteration with one; -1 is the last."""
        rows = self._of(f"/{entity}:buffer")
        k = max(rows) if iteration == -1 else iteration
        if k not in rows:
            raise ValueError(f"iteration {k} has no picture; {self.pictured} have")
        form = self._of(f"/{entity}:format")[k][0].as_py()
        content = rows[k].flatten().to_numpy().view(kind)
        return np.asarray(content.reshape(form["height"], form["width"], -1))

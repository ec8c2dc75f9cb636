"""Recordings read back: curves, depth maps and normals of a run, without the solver."""

from __future__ import annotations

import importlib.metadata
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
from numpy.typing import NDArray

from endolab.io.atomic import PathLike, one_sentence
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.memory import check_memory
from endolab.workbench.recording import decoder
from endolab.workbench.recording.layouts import ITERATIONS
from endolab.workbench.recording.recorder import stage_of

# Rows of a component: iteration (None if it stays) to its arrow values.
Rows = dict[int | None, Any]


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
        In one sentence, if there is no such file, or it is no recording, damaged, or of another version of
        Rerun.
    MemoryError
        If it is too large for this machine.

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
    batches = list(_batches(Path(path)))
    entities: dict[str, dict[str, Rows]] = {}
    try:
        for batch in sorted(
            batches, key=lambda batch: batch.column(0)[0].as_py()
        ):  # as it was logged
            _take(batch, entities)
        recording = Recording(Path(path), entities)
        for run in recording.runs.values():
            run._check()
    except MemoryError:
        raise
    except Exception as error:  # whatever the values in a damaged file lead to
        raise ValueError(f"{path} is damaged: record the run again") from error
    return recording


def _take(batch: Any, entities: dict[str, dict[str, Rows]]) -> None:
    """Sort the rows of a batch by entity, component and iteration."""
    entity = (batch.schema.metadata or {}).get(b"rerun:entity_path", b"").decode()
    timed = ITERATIONS in batch.schema.names and pa.types.is_int64(
        batch.schema.field(ITERATIONS).type
    )
    at: list[int | None] = (
        batch.column(ITERATIONS).to_pylist() if timed else [None] * len(batch)
    )
    for name, kind in zip(batch.schema.names, batch.schema.types, strict=True):
        if ":" in name and pa.types.is_list(kind):
            column = batch.column(name)
            rows = entities.setdefault(entity, {}).setdefault(name.split(":")[1], {})
            rows |= {k: column[i].values for i, k in enumerate(at) if column[i].is_valid}


def _batches(path: Path) -> Iterator[Any]:
    """What a file holds, decoded by a process of its own."""
    if not path.is_file():
        raise FileNotFoundError(f"there is no recording {path}")
    with one_sentence(f"{path}: cannot be read"), path.open("rb") as stream:
        head = stream.read(6)
    if head[:3] != b"RRF":
        raise ValueError(
            f"{path} is no Rerun recording: expected a file that begins with RRF"
        )
    size = path.stat().st_size
    check_memory(6 * size, f"{path}: a recording of {size / 1e6:.0f} MB")
    program = subprocess.run(
        [sys.executable, "-P", decoder.__file__, str(path.resolve())],
        env={**os.environ, "RUST_LOG": "off"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        timeout=60 + size / 1e6,  # s: one more for each megabyte
        check=False,
    )
    if program.returncode:
        theirs = ".".join(map(str, head[4:]))
        ours = importlib.metadata.version("rerun-sdk")
        raise ValueError(
            f"{path} is damaged, or of another version: Rerun {theirs}, and here is {ours}"
        )
    with pa.BufferReader(program.stdout) as content:
        while content.tell() < content.size():
            yield from pa.ipc.open_stream(content)


class Recording:
    """A recording of the file `path`, or one run of it."""

    # Of each entity the rows of each component; without a run, it is the only one.
    def __init__(
        self, path: Path, entities: dict[str, dict[str, Rows]], run: str | None = None
    ) -> None:
        self.path = path
        self._entities = entities
        self._run = run

    def __repr__(self) -> str:
        return f"<Recording {self.path}: {', '.join(map(repr, self.runs)) or 'no run'}>"

    @property
    def runs(self) -> dict[str, Recording]:
        """Runs by name; one that was recorded alone is called ''."""
        end = "/plots/energy"
        names = [self._run or ""]
        if self._run is None:
            # Curves over the iterations: other recordings of ours are over frames.
            ours = [
                name
                for name in self._entities
                if name.endswith(end) and self._at(name, "scalars")
            ]
            names = [name.removesuffix(end).lstrip("/") for name in ours]
        return {name: Recording(self.path, self._entities, name) for name in names}

    @property
    def _start(self) -> str:
        """What the entities of the run begin with."""
        names = list(self.runs)
        if len(names) > 1:
            raise ValueError(
                f"{self.path} holds several runs: choose one, .runs[{names[0]!r}]"
            )
        if not names:
            raise ValueError(f"{self.path} holds no reconstruction")
        return f"/{names[0]}/" if names[0] else "/"

    def _check(self) -> None:
        """Read all there is of a run once: what is damaged fails now."""
        assert all(np.isfinite(values).all() for _, values in self.scalars.values())
        _ = self.stages, self.unit, self.picture, self.settings, self.sigma
        for k in self.pictured:
            known = np.isfinite(self.depth(k))
            assert (self.depth(k)[known] > 0).all()
            assert known.shape == self._mask(k).shape
            assert self.normals(k).shape == (*known.shape, 3)
        if self.dominant_source is not None:
            assert self.dominant_source.shape == self.mask.shape

    def _at(self, entity: str, component: str) -> list[int]:
        """Iterations at which an entity, by its whole path, has a component."""
        return sorted(
            k for k in self._entities.get(entity, {}).get(component, {}) if k is not None
        )

    def _values(self, entity: str, component: str, k: int | None = None) -> Any:
        """What an entity of the run has at an iteration, or had last before; by default, at the end."""
        rows = self._entities[self._start + entity][component]
        before = [at for at in rows if at is not None and (k is None or at <= k)]
        return rows[max(before, default=None)]

    @property
    def scalars(self) -> dict[str, tuple[NDArray[np.int64], FloatArray]]:
        """Energy, its terms, change and the solver's scalars: iterations and values, (n,) each."""
        start = f"{self._start}plots/"
        curves = {}
        for entity in sorted(self._entities, key=lambda entity: entity != f"{start}energy"):
            at = self._at(entity, "scalars") if entity.startswith(start) else []
            if at:
                values = [self._entities[entity]["scalars"][k][0].as_py() for k in at]
                curves[entity.removeprefix(start)] = np.array(at), np.array(values, float)
        return curves

    def table(self) -> NDArray[np.void]:
        """All scalars, one row per iteration: a structured array (n,) with the field "iteration".

        ``recording.table()["energy"]`` is a column; what was not logged is nan.
        """
        scalars = self.scalars
        iterations = np.unique(np.concatenate([at for at, _ in scalars.values()]))
        table = np.empty(
            len(iterations), dtype=[("iteration", int), *((n, float) for n in scalars)]
        )
        table["iteration"] = iterations
        for name, (at, values) in scalars.items():
            table[name] = np.nan
            table[name][np.searchsorted(iterations, at)] = values
        return table

    @property
    def pictured(self) -> tuple[int, ...]:
        """Iterations with pictures: the others have scalars only."""
        return tuple(self._at(f"{self._start}depth", "buffer"))

    @property
    def stages(self) -> list[tuple[int, str, int]]:
        """Stages of the run: first iteration, name, and round (0 if there is one only)."""
        begins = self._at(f"{self._start}stage", "text")
        return [(k, *stage_of(self._values("stage", "text", k)[0].as_py())) for k in begins]

    @property
    def unit(self) -> str:
        """Of distances: "mm", or "relative units" where the gain was unknown; of the last stage."""
        return (
            "mm" if self._values("depth", "meter")[0].as_py() == 1000 else "relative units"
        )

    @property
    def mask(self) -> BoolArray:
        """Pixels that took part, (h, w); of the last stage."""
        return self._mask()

    def _mask(self, k: int | None = None) -> BoolArray:
        return self._map("mask", np.uint8, k).astype(bool)

    @property
    def picture(self) -> FloatArray:
        """The frame as it looked, (h, w, 3); of the last stage, in [0, 1]."""
        return self._map("input", np.uint8, None, 3) / 255.0

    @property
    def settings(self) -> str:
        """What was solved and how, as Markdown; of the last stage."""
        return str(self._values("settings", "text")[0].as_py())

    def depth(self, iteration: int = -1) -> FloatArray:
        """Distance at an iteration of `pictured`, (h, w), in `unit`; nan outside the mask; -1 is the last.

        Thinned if the frame was wider than the recording. An earlier stage may be on a smaller grid
        and in relative units. ValueError if the iteration has no picture.
        """
        return self._map("depth", np.float32, self._choose_iteration(iteration)).astype(
            float
        )

    def normals(self, iteration: int = -1) -> FloatArray:
        """Unit normals at an iteration, (h, w, 3), to half a degree; nan outside the mask; see `depth`."""
        k = self._choose_iteration(iteration)
        n = np.where(
            self._mask(k)[..., None],
            2 * (self._map("normals", np.uint8, k, 3) / 255.0) - 1,
            np.nan,
        )
        return n / np.linalg.norm(n, axis=-1, keepdims=True)

    @property
    def sigma(self) -> FloatArray | None:
        """Standard deviation of the last `depth`, (h, w), in its unit; None if it was not recorded."""
        if f"{self._start}uncertainty/sigma" not in self._entities:
            return None
        return self._map("uncertainty/sigma", np.float32) / 100 * self.depth()

    @property
    def dominant_source(self) -> NDArray[np.uint8] | None:
        """What determined the pixels of the last `depth`, (h, w); None if no uncertainty was recorded.

        1 the data, 2 border or contour, 3 the prior; 0 outside the mask.
        """
        if f"{self._start}uncertainty/dominant_source" not in self._entities:
            return None
        return self._map("uncertainty/dominant_source", np.uint8)

    def _choose_iteration(self, iteration: int) -> int:
        pictured = self.pictured
        if not pictured:
            raise ValueError(f"{self.path} holds no depth maps")
        k = pictured[-1] if iteration == -1 else iteration
        if k not in pictured:
            nearest = min(pictured, key=lambda other: abs(other - k))
            raise ValueError(
                f"iteration {iteration} has no picture; the nearest that has is {nearest}"
            )
        return k

    def _map(self, entity: str, kind: type, k: int | None = None, *depth: int) -> NDArray:
        """A picture of raw values, (h, w), or of so many channels."""
        form = self._values(entity, "format", k)[0].as_py()
        content = self._values(entity, "buffer", k).flatten().to_numpy()
        return np.asarray(content.view(kind).reshape(form["height"], form["width"], *depth))

"""Recordings read back: curves, depth maps and normals of a run, without the solver."""

from __future__ import annotations

import importlib.metadata
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa  # type: ignore[import-untyped]
from numpy.typing import NDArray

from endolab.depth.result import SOLUTION
from endolab.io.atomic import PathLike, one_sentence
from endolab.io.images import decode
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.memory import check_memory
from endolab.recording import decoder
from endolab.recording.layouts import TIMELINE
from endolab.recording.stream import stage_of

# Rows of a component: iteration (None if it stays) to its arrow values.
Rows = dict[int | None, Any]
T = TypeVar("T")


def read_recording(path: PathLike) -> Recording:
    """Read a recording that `record` or a `Comparison` has written.

    Parameters
    ----------
    path : path
        The ``.rrd`` file.

    Raises
    ------
    OSError, ValueError
        In one sentence, if there is no such file, or it is no recording, truncated, damaged, or of
        another version of Rerun.
    MemoryError
        If it is too large for this machine.
    """
    entities: dict[str, dict[str, Rows]] = {}
    for batch in _batches(Path(path)):
        entity = (batch.schema.metadata or {}).get(b"rerun:entity_path", b"").decode()
        timed = TIMELINE in batch.schema.names and pa.types.is_int64(batch.schema.field(TIMELINE).type)
        at: list[int | None] = batch.column(TIMELINE).to_pylist() if timed else [None] * len(batch)
        for name, kind in zip(batch.schema.names, batch.schema.types, strict=True):
            if ":" in name and pa.types.is_list(kind):
                column = batch.column(name)
                rows = entities.setdefault(entity, {}).setdefault(name.split(":")[1], {})
                rows |= {k: column[i].values for i, k in enumerate(at) if column[i].is_valid}
    if not entities:
        raise ValueError(f"{path} is damaged: there is nothing in it")
    recording = Recording(Path(path), entities)
    for run in recording.runs.values():
        run._check()
    return recording


def _batches(path: Path) -> Iterator[Any]:
    """What a file holds; `rerun rrd verify` is content with any file, so read it."""
    if not path.is_file():
        raise FileNotFoundError(f"there is no recording {path}")
    with one_sentence(f"{path}: cannot be read"), path.open("rb") as stream:
        head = stream.read(8)
    if not head:
        raise ValueError(f"{path} is empty: the recording was never written")
    if head[:3] != b"RRF":
        raise ValueError(f"{path} is no Rerun recording: expected a file that begins with RRF")
    rerun = importlib.metadata.version("rerun-sdk")
    theirs, ours = tuple(head[4:6]), tuple(int(part) for part in rerun.split(".")[:2])
    version = f"Rerun {'.'.join(map(str, theirs))}, and here is {rerun}"
    if head[3:4] != b"2" or (len(head) == 8 and theirs > ours):
        raise ValueError(f"{path} was written by another version: {version}")
    size = path.stat().st_size
    check_memory(6 * size, f"{path}: a recording of {size / 1e6:.0f} MB")
    program = subprocess.run(
        [sys.executable, "-P", decoder.__file__, str(path.resolve())],
        env={**os.environ, "RUST_LOG": "off"},
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        check=False,
    )
    if program.returncode == decoder.OTHER_VERSION:
        raise ValueError(f"{path} was written by another version: {version}")
    if program.returncode == decoder.TRUNCATED:
        raise ValueError(f"{path} is truncated: record the run again")
    if program.returncode == decoder.CHANGED:
        why = "its checksum is another one; was it rewritten by another program?"
        raise ValueError(f"{path} is damaged: {why}")
    if program.returncode:
        raise ValueError(f"{path} is damaged: record the run again")
    with pa.BufferReader(program.stdout) as content:
        while content.tell() < content.size():
            yield from pa.ipc.open_stream(content)


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
            ours = [name for name in self._entities if name.endswith(end) and self._is_timed(name)]
            names = [name.removesuffix(end).lstrip("/") for name in ours]
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

    def _is_timed(self, entity: str) -> bool:
        """Whether an entity is a curve over the iterations; other recordings of ours are over frames."""
        return any(k is not None for k in self._entities[entity].get("scalars", {}))

    def _check(self) -> None:
        """Read all there is of a run once: what is missing or not as it was written is said now."""
        self.table()
        _ = self.stages, self.unit, self.mask, self.picture, self.settings
        for k in self.pictured:
            shapes = {self.depth(k).shape, self._mask(k).shape, self._colours("normals", k).shape[:2]}
            if len(shapes) > 1:
                raise self._damaged(f"pictures of iteration {k} are not of one size")
        _ = self.sigma, self.decided_by

    def _damaged(self, why: str) -> ValueError:
        return ValueError(f"{self.path} is damaged: {why}")

    def _rows(self, entity: str, component: str) -> Rows:
        return self._entities.get(self._start + entity, {}).get(component, {})

    def _values(self, entity: str, component: str, k: int | None) -> Any:
        """What an entity has at an iteration, or for a run, at least one value."""
        values = self._rows(entity, component).get(k)
        if values is None or len(values) == 0:
            raise self._damaged(f"{entity} has no {component}{'' if k is None else f' at iteration {k}'}")
        return values

    def _value(self, entity: str, component: str, k: int | None, kind: type[T]) -> T:
        value = self._values(entity, component, k)[0].as_py()
        if not isinstance(value, kind):
            raise self._damaged(f"{component} of {entity} is not as it was written")
        return value

    @property
    def scalars(self) -> dict[str, tuple[NDArray[np.int64], FloatArray]]:
        """Energy, its terms, change and the solver's scalars: iterations and values, (n,) each."""
        start, found = f"{self._start}plots/", {}
        for name in (entity.removeprefix(start) for entity in self._entities if entity.startswith(start)):
            at = self._at(f"plots/{name}", "scalars")
            values = np.array([self._value(f"plots/{name}", "scalars", k, float) for k in at])
            if not np.isfinite(values).all():
                raise self._damaged(f"plots/{name} is not finite everywhere")
            found[name] = np.array(at, int), values.astype(float)
        return dict(sorted(found.items(), key=lambda item: item[0] != "energy"))

    def _at(self, entity: str, component: str) -> list[int]:
        """Iterations at which an entity has a component."""
        return sorted(k for k in self._rows(entity, component) if k is not None)

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
        return tuple(self._at("depth", "buffer"))

    @property
    def stages(self) -> list[tuple[int, str, int]]:
        """Stages of the run: first iteration, name, and round (0 if there is one only)."""
        texts = {k or 0: stage_of(self._value("stage", "text", k, str)) for k in self._rows("stage", "text")}
        first = int(self.scalars["energy"][0][0])
        return [(k, *texts[k]) for k in sorted(texts)] or [(first, SOLUTION, 0)]

    def _standing(self, entity: str, component: str, k: int | None = None) -> int | None:
        """Where the value is that stays for a stage, at an iteration; None if one stays for the run."""
        return max((at for at in self._at(entity, component) if k is None or at <= k), default=None)

    @property
    def unit(self) -> str:
        """Of distances: "mm", or "relative units" where the gain was unknown; of the last stage."""
        return "mm" if self._value("depth", "meter", self._chosen(-1), float) == 1000 else "relative units"

    @property
    def mask(self) -> BoolArray:
        """Pixels that took part, (h, w); of the last stage."""
        return self._mask()

    def _mask(self, k: int | None = None) -> BoolArray:
        return self._map("mask", self._standing("mask", "buffer", k), np.uint8).astype(bool)

    @property
    def picture(self) -> FloatArray:
        """The frame as it looked, (h, w, 3), in [0, 1]; maybe thinned; of the last stage."""
        return self._colours("input", self._standing("input", "blob")) / 255.0

    @property
    def settings(self) -> str:
        """What was solved and how, as Markdown; of the last stage."""
        return self._value("settings", "text", self._standing("settings", "text"), str)

    def depth(self, iteration: int = -1) -> FloatArray:
        """Distance at an iteration of `pictured`, (h, w), in `unit`; nan outside the mask; -1 is the last.

        Thinned if the frame was wider than the recording. An earlier stage may be on a smaller grid
        and in relative units. ValueError if the iteration has no picture.
        """
        distance = self._map("depth", self._chosen(iteration), np.float32).astype(float)
        if not (distance > 0).any() or (distance <= 0).any() or np.isinf(distance).any():
            raise self._damaged("a distance is not positive and finite")
        return distance

    def normals(self, iteration: int = -1) -> FloatArray:
        """Unit normals at an iteration, (h, w, 3), to half a degree; nan outside the mask; see `depth`."""
        k = self._chosen(iteration)
        n = np.where(self._mask(k)[..., None], 2 * (self._colours("normals", k) / 255.0) - 1, np.nan)
        return n / np.linalg.norm(n, axis=-1, keepdims=True)

    @property
    def sigma(self) -> FloatArray | None:
        """Standard deviation of the last `depth`, (h, w), in its unit; None if no trust was recorded."""
        if not self._rows("front/trust/sigma", "buffer"):
            return None
        depth, percent = self.depth(), self._map("front/trust/sigma", None, np.float32).astype(float)
        known = np.isfinite(depth)
        if percent.shape != depth.shape or not (percent[known] >= 0).all() or np.isinf(percent).any():
            raise self._damaged("the trust is not that of the run's end")
        return np.where(known, percent / 100 * depth, np.nan)

    @property
    def decided_by(self) -> NDArray[np.uint8] | None:
        """Who decided the pixels of the last `depth`, (h, w); None if no trust was recorded.

        1 the data, 2 border or contour, 3 the prior; 0 outside the mask.
        """
        if not self._rows("front/trust/decided_by", "buffer"):
            return None
        decided = self._map("front/trust/decided_by", None, np.uint8)
        depth = self.depth()
        if decided.shape != depth.shape or not np.isin(decided[np.isfinite(depth)], (1, 2, 3)).all():
            raise self._damaged("the trust is not that of the run's end")
        return decided

    def _chosen(self, iteration: int) -> int:
        pictured = self.pictured
        if not pictured:
            raise ValueError(f"{self.path} holds no depth maps")
        k = pictured[-1] if iteration == -1 else iteration
        if k not in pictured:
            nearest = min(pictured, key=lambda other: abs(other - k))
            raise ValueError(f"iteration {iteration} has no picture; the nearest that has is {nearest}")
        return k

    def _map(self, entity: str, k: int | None, kind: type) -> NDArray:
        """A picture of raw values, (h, w)."""
        form = self._value(entity, "format", k, dict)
        content = self._bytes(entity, "buffer", k)
        width, height = form.get("width"), form.get("height")
        if not (width and height) or len(content) != width * height * np.dtype(kind).itemsize:
            raise self._damaged(f"{entity} is not of the size that it says")
        return content.view(kind).reshape(height, width)

    def _colours(self, entity: str, k: int | None) -> NDArray[np.uint8]:
        """An encoded picture, (h, w, 3)."""
        content = self._bytes(entity, "blob", k)
        try:
            stored = decode(content.tobytes(), entity)
        except (ValueError, MemoryError) as error:
            raise self._damaged(f"a picture of {entity} cannot be decoded") from error
        return np.asarray(stored[..., ::-1], np.uint8)

    def _bytes(self, entity: str, component: str, k: int | None) -> NDArray[np.uint8]:
        values = self._values(entity, component, k).flatten()
        if not pa.types.is_uint8(values.type) or values.null_count:
            raise self._damaged(f"{component} of {entity} is not as it was written")
        return np.asarray(values.to_numpy())

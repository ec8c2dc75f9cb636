"""The command `reconstruct` of a folder or a video."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from endolab.cli_solving import calibration_of, known_length, solving_keywords

if TYPE_CHECKING:
    from endolab.cameras import Camera
    from endolab.iteration import Result
    from endolab.preprocess import Frame
    from endolab.sequence_folder import SequenceFolder
    from endolab.sequence_recording import SequenceRecorder
    from endolab.video import Frames


def reconstruct_video(arguments: argparse.Namespace) -> None:
    """Reconstruct the frames of a folder or a video that are not done yet, and tell what came of them."""
    from tqdm import tqdm

    from endolab.files import read_mask
    from endolab.iteration import Status
    from endolab.sequence import reconstruct_sequence
    from endolab.sequence_folder import SequenceFolder
    from endolab.video import open_frames

    for option in ("every", "limit"):
        value = getattr(arguments, option)
        if value is not None and value < 1:
            raise ValueError(f"--{option} must be at least 1, got {value}")
    if arguments.mesh or arguments.prepare or arguments.snapshots is not None:
        raise ValueError("--mesh, --prepare and --snapshots are of one frame, not of a folder or a video")
    calibration = calibration_of(arguments)
    keywords = solving_keywords(arguments) | known_length(arguments)
    mask = None if arguments.mask is None else read_mask(arguments.mask)
    frames = open_frames(arguments.frame)
    wanted = list(frames.names[:: arguments.every or 1][: arguments.limit])
    known = {key: value for key, value in calibration.to_dict().items() if key != "evidence"}
    settings = {**keywords, "mask": arguments.mask, "calibration": known}
    folder = SequenceFolder(arguments.out, str(frames.path.resolve()), frames.names, settings)
    recording = _Recording(folder, frames, calibration.camera)
    number = {name: index for index, name in enumerate(frames.names)}
    done = [name for name in wanted if folder.done(name)]
    bar = tqdm(total=len(wanted), initial=len(done), unit="frame", leave=False, disable=None, desc="video")
    try:
        with bar:
            if done and (len(done) < len(wanted) or not recording.path.exists()):
                recording.begin_again(done)
            for before, names in _gaps(wanted, folder):
                pictures = _pictures(frames, names, mask)
                surface = None if before is None else folder.surface(before)
                for step in reconstruct_sequence(pictures, calibration, before=surface, **keywords):
                    result = step.result
                    if result is not None and result.status is Status.STOPPED:
                        raise KeyboardInterrupt("interrupted")
                    folder.add(number[step.name], step)
                    if result is not None:
                        recording.add(step.name, result)
                        bar.set_postfix_str(f"energy {result.energy:.3e}", refresh=False)
                    bar.update()
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
        raise kind(
            f"{said}; {count} of {len(wanted)} frames are done and stay, the same command goes on"
        ) from failure
    _tell(folder, wanted, len(done), recording, arguments.out)


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
    from endolab.preprocess import Frame

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
        from endolab.sequence_folder import PLOTTED
        from endolab.sequence_recording import SequenceRecorder

        row = self.folder.rows[name]
        if self.recorder is None:
            self.recorder = SequenceRecorder(self.path, row["unit"])
        scalars = {key: row[key] for key in PLOTTED}
        self.recorder.log(self.number[name], picture, distance, normals, camera, scalars)

    def close(self) -> None:
        """Write it, if there is something new in it."""
        if self.recorder is not None:
            self.recorder.close()


def _tell(folder: SequenceFolder, wanted: list[str], before: int, recording: _Recording, out: str) -> None:
    """End the folder and say what is in it; so many frames were done by an earlier call."""
    rows = [folder.rows[name] for name in wanted]
    done, broken = ([row for row in rows if bool(row["error"]) is wrong] for wrong in (False, True))
    if not done:
        raise ValueError(f"no frame could be reconstructed; the first: {broken[0]['error']}")
    folder.report(wanted)
    recording.close()
    for row in broken:
        print(f"not done: {row['error']}")
    seconds = sum(row["seconds"] for row in done)
    warm = sum(int(row["warm"]) for row in done)
    print(f"{len(done)} of {len(rows)} frames, {warm} started from the last, {seconds:.2f} s")
    if before:
        print(f"done by an earlier call: {before} of them")
    middle = [row["median_distance"] for row in done]
    print(f"median distance: {min(middle):.4g} to {max(middle):.4g} ({done[0]['unit']})")
    if done[0]["unit"] != "mm":
        print("The gain is unknown: distances have no unit, but nearly the same one in all frames.")
    print(f"written to {out}: frames, frames.csv, recording.rrd, report.json")

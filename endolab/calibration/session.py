"""A calibration from end to end: frames of a target in, the endoscope's camera and light out.

frames, target
   |  detect_all    where the target is seen in each
   v
Detected
   |  fit_camera    the camera, from some of the views, unless it is given
   |  locate        where the target stood in every frame
   v
Located
   |  fit_light     the light, from how bright the paper is there
   v
Session             what came of it; `summary` says it
"""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from operator import length_hint
from typing import Any

import numpy as np

from endolab.calibration import constants
from endolab.calibration.detection.detect import Detection, detect, no_features, see_board
from endolab.calibration.geometric.fit import GeometricFit, calibrate_camera
from endolab.calibration.geometric.pose import Pose
from endolab.calibration.geometric.projection import Lens
from endolab.calibration.geometric.reprojection import find_pose, views_of
from endolab.calibration.least_squares import Row
from endolab.calibration.photometric.fit import LightOptions, calibrate_light
from endolab.calibration.photometric.result import PhotometricFit
from endolab.calibration.photometric.samples import Samples, sample_sheet
from endolab.calibration.refusals import Refusal, Verdict
from endolab.calibration.targets import Board, Charuco, Target
from endolab.calibration.uncertainty import ray_uncertainty, values_within
from endolab.frames.frame import check_size
from endolab.model.photometry import CHANNELS, GREY_WEIGHTS
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import check_int, check_kinds, unknown_name

Progress = Callable[[str, int, int], None]
# One pose a panel, None for one that was not located.
Panels = tuple[Pose | None, ...]
Named = Iterable[tuple[str, FloatArray | ValueError]]
LEFT_OUT = no_features(str(Refusal.LEFT_OUT.error()))


@dataclass(frozen=True, eq=False)
class Located:
    """A camera, and where a target stood before it."""

    target: Target
    detections: Mapping[str, Detection]  # by the name of the frame, in order
    geometry: GeometricFit | None  # None if the camera was given
    camera: Lens
    # Of each panel, for the frames where the target was located.
    poses: dict[str, Panels]
    # Of located frames, rms of what counts, px, on the worse panel.
    errors: dict[str, float]
    dropped: dict[str, str]  # frames that were not used, and why


@dataclass(frozen=True, eq=False)
class Session(Located):
    """All that came of a calibration; `Session.samples.frame` counts the keys of `poses`."""

    samples: Samples  # of all located frames
    light: PhotometricFit | None  # None if the samples could not tell it
    refused: str = ""  # why not; empty if they could

    @property
    def verdict(self) -> Verdict:
        """What can be used of it: of simulated views, all but 2 to 8 % of the points agree."""
        if self.geometry is not None and self.geometry.agreement < 0.85:
            return Verdict.USELESS
        return Verdict.CAMERA_ALONE if self.light is None else Verdict.USE

    @property
    def remarks(self) -> list[str]:
        """What may be wrong with it, or was left to choose, a sentence each."""
        fits = (self.geometry, self.light)
        return [doubt.value for fit in fits if fit is not None for doubt in fit.doubts]

    def table(self) -> list[Row]:
        """Name, value, standard error and unit of all that was found: the camera, the light, how they fit.

        An error of 0 is that of a number that was given, inf of one that the frames do not tell, nan of one
        that says itself how sure something is.
        """
        rows: list[Row] = []
        if self.geometry is not None:
            seen = self.geometry.max_angle_seen
            rays = ray_uncertainty(self.camera, self.geometry.covariance, max_angle=seen)
            known = values_within(rays, self.camera, seen)
            rows += self.geometry.table()
            rows.append(("σ of a ray", float(np.median(known)), np.nan, "mrad"))
        if self.light is not None:
            off = 100 * self.light.errors_by_angle(self.samples).largest
            rows += self.light.table()
            rows.append(("light off by", off, np.nan, "%"))
        return rows


def silent(stage: str, done: int, total: int) -> None:
    """Say nothing of the progress."""


# Detect ---------------------------------------------------------------------------------
def detect_all(
    frames: Named,
    target: Target,
    *,
    progress: Progress = silent,
    leave_out: Collection[str] = (),
) -> tuple[dict[str, Detection], tuple[int, int] | None]:
    """Find the target in named frames, (H, W) or (H, W, 3), a ValueError for one that could not be read.

    `progress` is told the stage, what is done and the total, 0 if it is not known. Those that `leave_out`
    names are not looked at; the others must share their size. Returns the detections by name, and width and
    height, px; None if no frame could be read.
    """
    size = None
    detections: dict[str, Detection] = {}
    total = length_hint(frames)
    for number, (name, image) in enumerate(frames):
        if name in leave_out:
            detections[name] = LEFT_OUT
        elif isinstance(image, ValueError):
            # Without the file's name, so that frames with one reason come together.
            detections[name] = no_features(str(image).split(": ", 1)[-1])
        else:
            found = image.shape[1], image.shape[0]
            if size is None:
                first, size = name, found
            if found != size:
                raise ValueError(
                    f"the frames differ in size: {first} is {size[0]}x{size[1]} px, {name} is "
                    f"{found[0]}x{found[1]} px; leave_out (--leave-out) can name those to do without"
                )
            detections[name] = detect(image, target)
        progress("detecting", number + 1, total)
    return detections, size


# Fit ------------------------------------------------------------------------------------
def choose_views(detections: Mapping[str, Detection], every: int = 20) -> list[str]:
    """Name frames for the geometry, in order: the best of each `every` that show the target; more if few."""
    seen = [name for name in detections if len(detections[name].ids)]
    every = max(1, min(every, len(seen) // 15))
    groups = (seen[start : start + every] for start in range(0, len(seen), every))
    return [max(group, key=lambda name: len(detections[name].ids)) for group in groups]


def locate(
    detections: Mapping[str, Detection],
    size: tuple[int, int],
    target: Target,
    *,
    camera: Lens | None = None,
    lens: str = "auto",
    every: int = 20,
    progress: Progress = silent,
) -> Located:
    """Calibrate the camera, if none is given, and find the poses of the target's panels in every frame.

    A frame does not belong to the others if its points are off by ten times the median.
    """
    geometry = None
    if camera is None:
        chosen = choose_views(detections, every)
        views = [
            view for name in chosen for view in views_of(name, detections[name], target)
        ]
        try:
            geometry = calibrate_camera(views, target, *size, lens=lens)
        except ValueError as error:
            raise ValueError(f"{error}; {_reasons(detections)}") from None
        camera = geometry.camera
    check_size("a frame", size, camera, "camera")
    poses: dict[str, Panels] = {}
    errors: dict[str, float] = {}
    dropped: dict[str, str] = {}
    for number, (name, detection) in enumerate(detections.items()):
        placed: list[Pose | None] = [None] * target.panels
        dropped[name] = detection.reason or "too few points"
        for view in views_of(name, detection, target):
            try:
                placed[view.panel], inliers, residual = find_pose(view, target, camera)
                off = float(np.sqrt(np.mean(np.sum(residual[inliers] ** 2, axis=1))))
                errors[name] = max(off, errors.get(name, 0.0))
                poses[name] = tuple(placed)
            except ValueError as error:
                dropped[name] = str(error)
        progress("locating", number + 1, len(detections))
    usual = float(np.median([*errors.values(), constants.FINEST]))
    for name, off in list(errors.items()):
        if off < 10 * max(usual, constants.FINEST):
            del dropped[name]
        else:
            del poses[name], errors[name]
            dropped[name] = str(Refusal.ALIEN.error(off=off, usual=usual))
    return Located(target, detections, geometry, camera, poses, errors, dropped)


def fit_light(
    frames: Named,
    located: Located,
    *,
    channel: str = "grey",
    progress: Progress = silent,
    **light: Any,
) -> Session:
    """Calibrate the light by the brightness of the located frames, with the options of `calibrate_light`."""
    weights = GREY_WEIGHTS if channel == "grey" else np.equal(CHANNELS, channel)
    poses = located.poses
    parts: list[Samples] = []
    for name, image in frames:
        if not isinstance(image, ValueError) and name in poses:
            grey = image if image.ndim == 2 else image @ weights
            where = located.target, poses[name], located.camera
            parts.append(sample_sheet(grey, *where, frame=list(poses).index(name)))
            progress("sampling", len(parts), len(poses))
    samples = Samples.concatenate(parts)
    # Whatever fails, be it arithmetic, the camera is not lost.
    try:
        return Session(
            **vars(located), samples=samples, light=calibrate_light(samples, **light)
        )
    except (ValueError, ArithmeticError) as error:
        return Session(**vars(located), samples=samples, light=None, refused=str(error))


# Say ------------------------------------------------------------------------------------
def by_reason(dropped: Mapping[str, str]) -> list[str]:
    """Say which frames were dropped and why, one line a reason, most frequent first."""
    lines = []
    for reason, count in Counter(dropped.values()).most_common():
        names = [name for name in dropped if dropped[name] == reason]
        more = f" and {count - 8} more" if count > 8 else ""
        lines.append(f"{count}: {reason} ({', '.join(names[:8])}{more})")
    return lines


def _reasons(detections: Mapping[str, Detection]) -> str:
    """Say in how many frames the target was found, and why not in the others."""
    lost = {name: found.reason for name, found in detections.items() if found.reason}
    count = len(detections) - len(lost) or "none"
    why = [f"the target was found in {count} of {len(detections)} frames", *by_reason(lost)]
    return "; ".join(why)


def _nothing_found_error(
    frames: Named, detections: Mapping[str, Detection], target: Target
) -> ValueError:
    if isinstance(target, Board):
        readable = (image for _, image in frames if not isinstance(image, ValueError))
        seen = next(filter(None, map(see_board, islice(readable, 2))), None)
        if seen:
            columns, rows = seen
            return ValueError(
                f"found no {target.kind} of {target.columns}×{target.rows} squares; these pictures "
                f"show {columns}×{rows}: add --target chessboard:{columns}x{rows}:SIZE, SIZE as in 3mm"
            )
    how = "the whole of it in view" if target.found_whole else "a part of it is enough"
    return ValueError(
        f"{_reasons(detections)}; looked for {describe_target(target)}, {how}"
    )


def describe_target(target: Target) -> str:
    """Say what a target is, in a few words."""
    is_dots = target.kind == "dots"
    what = "dots of two sizes" if is_dots else f"squares of a {target.kind}"
    apart = f"{target.columns} x {target.rows} {what}, {target.spacing:g} mm apart"
    folded = ", folded" if target.fold else ""
    is_old = isinstance(target, Charuco) and target.legacy
    return apart + folded + (", of the pattern before OpenCV 4.6" if is_old else "")


def check_names(leave_out: Collection[str], names: Collection[str]) -> None:
    """Raise a ValueError if a frame that is to be left out is none of `names`."""
    for name in leave_out:
        if name not in names:
            some = ", ".join(list(names)[:3])
            raise ValueError(
                f"leave_out must name some of the frames ({some}, …), got {name!r}"
            )


@check_kinds(target=Target)
def calibrate(
    frames: Named,
    target: Target,
    *,
    camera: Lens | None = None,
    detections: Mapping[str, Detection] | None = None,
    size: tuple[int, int] | None = None,
    lens: str = "auto",
    every: int = 20,
    channel: str = "grey",
    leave_out: Collection[str] = (),
    progress: Progress = silent,
    **light: Any,
) -> Session:
    """Calibrate an endoscope from frames of a target.

    Parameters
    ----------
    frames : iterable of (str, image)
        Names and stored values, (H, W) or (H, W, 3), in the order of time; a ValueError for one that
        cannot be read. Read twice, to find the target, then for its brightness; what can be read once
        alone, such as a generator, is held in memory.
    target : Target
    camera : KannalaBrandt or BrownConrady, optional
        If known; then only the light is calibrated.
    detections : mapping of str to Detection, optional
        What `detect_all` found, with `size`, the frames' width and height, px.
    lens : {"auto", "fisheye", "brown"}
        The kind of camera; by default what predicts frames best that were held out.
    every : int
        One frame in so many goes into the geometry; fewer are left out of a short video.
    channel : {"grey", "red", "green", "blue"}
        Whose response is calibrated.
    leave_out : collection of str
        Names of frames that the fits are not to see.
    progress : callable
        Told the stage ("detecting", "locating", "sampling"), what is done and the total.
    **light
        Options of `calibrate_light`: gamma, brdf, gain, reflectance …

    Returns
    -------
    Session
        If the light cannot be fitted, whatever the reason, `light` is None and `refused` says why.

    Raises
    ------
    ValueError
        If the frames differ in size, the target is in none of them, they cannot tell the camera, or one to
        be left out is none of them.
    """
    if channel not in (*CHANNELS, "grey"):
        raise unknown_name("channel", channel, (*CHANNELS, "grey"))
    LightOptions(**light)  # checks them, before a long search
    check_int("every", every, 1)
    if isinstance(frames, Iterator):
        frames = list(frames)
    if detections is None:
        detections, size = detect_all(
            frames, target, progress=progress, leave_out=leave_out
        )
    check_names(leave_out, detections)
    detections = {**detections, **dict.fromkeys(leave_out, LEFT_OUT)}
    if size is None or not any(len(detection.ids) for detection in detections.values()):
        raise _nothing_found_error(frames, detections, target)
    located = locate(
        detections,
        size,
        target,
        camera=camera,
        lens=lens,
        every=every,
        progress=progress,
    )
    return fit_light(frames, located, channel=channel, progress=progress, **light)

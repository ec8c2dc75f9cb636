"""A calibration from end to end: frames of a target in, the endoscope's camera and light out."""

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import islice
from operator import length_hint
from typing import Any

import numpy as np

from endolab.calibration.detection.detect import Detection, detect, no_features, see_board
from endolab.calibration.geometric.fit import GeometricFit, calibrate_camera
from endolab.calibration.geometric.pose import Pose
from endolab.calibration.geometric.projection import Lens, camera_vector, predict_view
from endolab.calibration.geometric.reprojection import FINEST, find_pose, views_of
from endolab.calibration.photometric.fit import calibrate_light, check_options
from endolab.calibration.photometric.result import HeldOut, PhotometricFit
from endolab.calibration.photometric.samples import Samples, sample_sheet
from endolab.calibration.targets import Charuco, Chessboard, Target
from endolab.frames.frame import check_size
from endolab.model.photometry import CHANNELS, GREY_WEIGHTS
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checks import check_int, check_kinds, unknown_name

Progress = Callable[[str, int, int], None]
# One pose a panel, None for one that was not located.
Panels = tuple[Pose | None, ...]
Named = Iterable[tuple[str, FloatArray | None]]
LEFT_OUT_REASON = "left out, as asked"


# Frames that the geometry should have; with fewer, more than one in `every` go into it.
ENOUGH_VIEWS = 15
# A frame whose points are so many times as far off as usual does not belong to the others.
ALIEN = 10.0


@dataclass(frozen=True)
class Session:
    """All that came of a calibration; `Session.samples.frame` counts the keys of `poses`."""

    target: Target
    detections: dict[str, Detection]  # by the name of the frame, in order
    geometry: GeometricFit | None  # None if the camera was given
    camera: Lens
    # Of each panel, for the frames where the target was located.
    poses: dict[str, Panels]
    samples: Samples  # of all located frames
    light: PhotometricFit | None  # None if the samples could not tell it
    refused: str = ""  # why not; empty if they could
    scores: HeldOut | None = None  # how well frames are predicted that the fit has not seen
    # Frames that were not used, and why.
    dropped: dict[str, str] = field(default_factory=dict)
    # Of located frames, rms of what counts, px.
    errors: dict[str, float] = field(default_factory=dict)

    def table(self) -> list[tuple[str, float, float, str]]:
        """Name, value, standard error and unit of all numbers that were found: the camera's, the light's.

        An error of 0 is that of a number that was given, inf of one that the frames do not tell.
        """
        rows = []
        if self.geometry is not None:
            errors = self.geometry.standard_errors
            vector = camera_vector(self.camera).tolist()
            for name, value in zip(errors, vector, strict=True):
                rows.append((name, value, errors[name], "" if name[0] in "kp" else "px"))
        if self.light is not None:
            light = self.light
            values = {"k": light.k, "gamma": light.photometry.gamma, "k/gamma": light.ratio}
            for material, value in enumerate(light.reflectance.tolist()):
                values[f"reflectance {material}"] = value
            del values["reflectance 0"]  # 1, as all are relative to it
            for name, value in values.items():
                rows.append((name, value, light.standard_errors[name], ""))
        return rows

    def predict_pixels(self, name: str) -> FloatArray:
        """Where the features detected in a located frame are expected, (n, 2), px; nan without a pose."""
        ids = self.detections[name].ids
        points = self.target.points[ids]
        radii = self.target.radii[ids]
        pixels = np.full((len(ids), 2), np.nan)
        for panel, pose in enumerate(self.poses[name]):
            on_panel = self.target.panel_of(points) == panel
            if pose is not None:
                pixels[on_panel] = predict_view(
                    self.camera,
                    pose,
                    points[on_panel],
                    radii[on_panel],
                )
        return pixels


def silent(
    stage: str,
    done: int,
    total: int,
) -> None:
    """Say nothing of the progress."""


def channel_of(image: FloatArray, channel: str) -> FloatArray:
    """Return one channel, or the grey value, of a picture (H, W) or (H, W, 3) as (H, W)."""
    if image.ndim == 2:
        return image
    if channel == "grey":
        return image @ GREY_WEIGHTS
    return image[..., CHANNELS.index(channel)]


def detect_all(
    frames: Named,
    target: Target,
    *,
    progress: Progress = silent,
    camera: Lens | None = None,
    leave_out: Collection[str] = (),
) -> tuple[dict[str, Detection], tuple[int, int] | None]:
    """Find the target in named frames, (H, W) or (H, W, 3), None for one that could not be read.

    `progress` is told the stage, what is done and the total, 0 if it is not known. Returns the detections by
    name, and width and height, px, which all frames must share, and which must be those of the `camera` that
    is to look at them; None if none could be read. Those that `leave_out` names are not looked at.
    """
    size = None
    first = ""
    detections: dict[str, Detection] = {}
    total = length_hint(frames)
    for number, (name, image) in enumerate(frames):
        if name in leave_out:
            detections[name] = no_features(LEFT_OUT_REASON)
        elif image is None:
            detections[name] = no_features("it cannot be read")
        else:
            found = image.shape[1], image.shape[0]
            if size is None:
                size = found
                first = name
                if camera is not None:
                    check_size(
                        name,
                        size,
                        camera,
                        "camera",
                    )
            elif found != size:
                raise ValueError(
                    f"the frames differ in size: {first} is {size[0]}x{size[1]} px, {name} is "
                    f"{found[0]}x{found[1]} px; leave_out (--leave-out) can name those to do without"
                )
            detections[name] = detect(image, target)
        progress("detecting", number + 1, total)
    return detections, size


def choose_views(detections: Mapping[str, Detection], every: int = 20) -> list[str]:
    """Name the frames for the geometry, in order of time: one in `every`, the best seen; more if few."""
    names = list(detections)
    seen = [name for name in names if len(detections[name].ids)]
    every = max(1, min(every, len(seen) // ENOUGH_VIEWS))
    groups = (names[start : start + every] for start in range(0, len(names), every))
    fullest = (max(group, key=lambda name: len(detections[name].ids)) for group in groups)
    return [name for name in fullest if len(detections[name].ids)]


def locate(
    detections: Mapping[str, Detection],
    target: Target,
    camera: Lens,
    progress: Progress = silent,
) -> tuple[dict[str, Panels], dict[str, float], dict[str, str]]:
    """Find the poses of the target's panels in every frame.

    Returns, of the frames where at least one panel was located, the poses and the root mean square distance
    of the points that count, px; and why the others are dropped. A frame does not belong to the others if
    the points of one of its panels are ten times as far off as those of the median panel.
    """
    poses: dict[str, Panels] = {}
    errors: dict[str, float] = {}
    worst: dict[str, float] = {}
    dropped: dict[str, str] = {}
    for number, (name, detection) in enumerate(detections.items()):
        placed: list[Pose | None] = [None] * target.panels
        reason = detection.reason or "too few points"
        squares = []
        for view in views_of(name, detection, target):
            try:
                placed[view.panel], inliers, residual = find_pose(view, target, camera)
                squares.append(np.sum(residual[inliers] ** 2, axis=1))
            except ValueError as error:
                reason = str(error)
        if squares:
            poses[name] = tuple(placed)
            errors[name] = float(np.sqrt(np.mean(np.concatenate(squares))))
            worst[name] = float(np.sqrt(max(map(np.mean, squares))))
        else:
            dropped[name] = reason
        progress("locating", number + 1, len(detections))
    usual = float(np.median(list(worst.values()) or [0.0]))
    for name, far in worst.items():
        if far > ALIEN * max(usual, FINEST):
            del poses[name], errors[name]
            dropped[name] = (
                f"its points are {far:.3g} px off, of other frames {usual:.2g} px"
            )
    return poses, errors, dropped


def sample_all(
    frames: Named,
    target: Target,
    poses: Mapping[str, Sequence[Pose | None]],
    camera: Lens,
    *,
    channel: str = "grey",
    gamma: float = 2.2,
    progress: Progress = silent,
) -> Samples:
    """Read the brightness of the paper in every frame that has a pose."""
    numbers = list(poses)
    places = target.white_places()
    parts = []
    for name, image in frames:
        if image is None or name not in poses:
            continue
        grey = channel_of(image, channel)
        number = numbers.index(name)
        parts.append(
            sample_sheet(
                grey, target, poses[name], camera, frame=number, gamma=gamma, places=places
            )
        )
        progress("sampling", len(parts), len(poses))
    return Samples.concatenate(parts)


def _reasons(detections: Mapping[str, Detection]) -> str:
    """Say in how many frames the target was found, and why not in the others."""
    reasons = Counter(found.reason for found in detections.values() if found.reason)
    why = ", ".join(f"{reason} in {n}" for reason, n in reasons.most_common())
    count = sum(len(found.ids) > 0 for found in detections.values()) or "none"
    return f"the target was found in {count} of {len(detections)} frames" + (
        f": {why}" if why else ""
    )


def _nothing_found_error(
    frames: Named, detections: Mapping[str, Detection], target: Target
) -> ValueError:
    if isinstance(target, Chessboard):
        readable = (image for _, image in frames if image is not None)
        sizes = [size for size in map(see_board, islice(readable, 2)) if size]
        if sizes:
            columns, rows = max(sizes, key=np.prod)
            return ValueError(
                f"found none of {target.columns}×{target.rows} squares; these pictures show "
                f"{columns}×{rows}: add --target chessboard:{columns}x{rows}:SIZE"
            )
    return ValueError(
        f"{_reasons(detections)}; looked for {describe_target(target)}"
        + (
            ", the whole of it in view"
            if target.found_whole
            else ", a part of it is enough"
        )
    )


def describe_target(target: Target) -> str:
    """Say what a target is, in a few words."""
    is_dots = target.kind == "dots"
    what = "dots of two sizes" if is_dots else f"squares of a {target.kind} board"
    more = {
        "folded": target.fold is not None,
        "of the pattern before OpenCV 4.6": isinstance(target, Charuco) and target.legacy,
    }
    words = [f"{target.spacing:g} mm apart", *(word for word in more if more[word])]
    return f"{target.columns} x {target.rows} {what}, {', '.join(words)}"


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
        Names and stored values, (H, W) or (H, W, 3), in the order of time; None for one that
        cannot be read. Iterated over twice: to find the target, then for its brightness.
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
    check_options(**light)
    check_int("every", every, 1)
    if detections is None:
        detections, size = detect_all(
            frames,
            target,
            progress=progress,
            camera=camera,
            leave_out=leave_out,
        )
    check_names(leave_out, detections)
    kept = {name: found for name, found in detections.items() if name not in leave_out}
    if size is None or not any(len(detection.ids) for detection in kept.values()):
        raise _nothing_found_error(frames, kept, target)
    geometry = None
    if camera is None:
        chosen = choose_views(kept, every)
        views = [view for name in chosen for view in views_of(name, kept[name], target)]
        try:
            geometry = calibrate_camera(views, target, *size, lens=lens)
        except ValueError as error:
            raise ValueError(f"{error}; {_reasons(kept)}") from None
        camera = geometry.camera
    else:
        check_size(
            "a frame",
            size,
            camera,
            "camera",
        )
    poses, errors, dropped = locate(
        kept,
        target,
        camera,
        progress,
    )
    dropped |= dict.fromkeys(leave_out, LEFT_OUT_REASON)
    gamma = light.get("gamma", 2.2)
    guess = 2.2 if isinstance(gamma, str) else float(np.ravel(gamma)[0])
    samples = sample_all(
        frames,
        target,
        poses,
        camera,
        channel=channel,
        gamma=guess,
        progress=progress,
    )
    fit = None
    scores = None
    refused = ""
    # Whatever fails from here on, be it arithmetic, the camera is not lost.
    try:
        fit = calibrate_light(samples, **light)
    except (ValueError, ArithmeticError) as error:
        refused = str(error)
    else:
        scores = score(samples, **light)
    return Session(
        target,
        dict(detections),
        geometry,
        camera,
        poses,
        samples,
        fit,
        refused,
        scores,
        dropped,
        errors,
    )


def score(samples: Samples, **light: Any) -> HeldOut | None:
    """Fit the light to nine frames in ten and predict the tenth; None if they are too few for it."""
    if len(np.unique(samples.frame)) < ENOUGH_VIEWS:
        return None
    kept = samples.frame % 10 == 5
    try:
        return calibrate_light(samples[~kept], **light).score_held_out(samples[kept])
    except (ValueError, ArithmeticError):  # what all frames together could just tell
        return None

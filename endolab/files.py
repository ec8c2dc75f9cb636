"""Files in and out: frames, depth maps, clouds. Nothing is left half-written."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from numpy.typing import NDArray

from endolab.iteration import Result
from endolab.operators import BoolArray, FloatArray
from endolab.preprocess import Frame
from endolab.scale import meaning, scale_of

if TYPE_CHECKING:
    from endolab.endoscope import Calibration

PathLike = str | os.PathLike[str]


# Writing --------------------------------------------------------------------------------


@contextmanager
def staged_folder(folder: PathLike) -> Iterator[Path]:
    """Give a temporary folder whose files move into `folder` only if the block succeeds.

    Parameters
    ----------
    folder : path
        Made if it does not exist; removed again if it was made here and nothing came of it.

    Yields
    ------
    Path
        Where to write.

    Raises
    ------
    OSError
        In one sentence, if the folder cannot be written.
    """
    target = Path(folder)
    made: list[Path] = []
    staging = None
    try:
        try:
            for path in reversed([target, *target.parents]):
                if not path.exists():
                    path.mkdir()
                    made.append(path)
            staging = Path(tempfile.mkdtemp(prefix=".endolab-", dir=target))
        except OSError as error:
            raise OSError(f"cannot write to the folder {target}: {error.strerror or error}") from error
        yield staging
        written = sorted(staging.iterdir())
        for path in written:
            if (target / path.name).is_dir():
                raise OSError(f"cannot write {target / path.name}: it is a folder")
        for path in written:
            os.replace(path, target / path.name)
        made.clear()
    except OSError as error:  # the reader knows nothing of the temporary folder
        if staging is None or str(staging) not in str(error):
            raise
        raise OSError(str(error).replace(str(staging), str(target))) from error
    finally:
        if staging is not None:
            shutil.rmtree(staging, ignore_errors=True)
        for path in reversed(made):
            path.rmdir()


def write_atomically(path: PathLike, content: bytes) -> None:
    """Write a file so that it is either whole or not there."""
    target = Path(path)
    try:
        handle, temporary = tempfile.mkstemp(prefix=f".{target.name}-", dir=target.parent)
    except OSError as error:
        raise OSError(f"cannot write {target}: {error.strerror or error}") from error
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
        os.chmod(temporary, 0o644)
        os.replace(temporary, target)
    except OSError as error:
        raise OSError(f"cannot write {target}: {error.strerror or error}") from error
    finally:
        Path(temporary).unlink(missing_ok=True)


def as_json(content: dict[str, Any]) -> bytes:
    """Encode as strict, indented JSON: a value that is not finite is an error."""
    return (json.dumps(content, indent=2, ensure_ascii=False, allow_nan=False) + "\n").encode()


def write_image(path: PathLike, image: FloatArray, bits: int = 8) -> None:
    """Write a grey or RGB picture with values in [0, 1] as PNG of 8 or 16 bits."""
    stored = np.round(np.clip(image, 0, 1) * (2**bits - 1)).astype(np.uint8 if bits == 8 else np.uint16)
    done, content = cv2.imencode(".png", stored[..., ::-1] if stored.ndim == 3 else stored)
    if not done:
        raise ValueError(f"cannot encode {path} as PNG")
    write_atomically(path, content.tobytes())


def as_ply(
    points: FloatArray,
    normals: FloatArray,
    colours: FloatArray,
    triangles: NDArray | None = None,
    comments: Sequence[str] = (),
) -> bytes:
    """Encode points, and triangles between them if there are any, as binary PLY.

    Parameters
    ----------
    points, normals : (n, 3) float arrays
    colours : (n, 3) float array
        R, G, B; values outside [0, 1] are clipped.
    triangles : (m, 3) int array, optional
        Numbers of points, from 0.
    comments : sequence of str
        Lines of the header.

    Returns
    -------
    bytes
    """
    vertices = np.empty(len(points), dtype=[("place", "<f4", 6), ("colour", "u1", 3)])
    vertices["place"][:, :3], vertices["place"][:, 3:] = points, normals
    vertices["colour"] = np.round(np.clip(colours, 0, 1) * 255)
    header = ["ply", "format binary_little_endian 1.0", *(f"comment {text}" for text in comments)]
    header += [f"element vertex {len(points)}"]
    header += [f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")]
    header += [f"property uchar {name}" for name in ("red", "green", "blue")]
    body = vertices.tobytes()
    if triangles is not None:
        faces = np.empty(len(triangles), dtype=[("count", "u1"), ("corners", "<i4", 3)])
        faces["count"], faces["corners"] = 3, triangles
        header += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
        body += faces.tobytes()
    return "\n".join([*header, "end_header", ""]).encode() + body


def write_cloud(path: PathLike, points: FloatArray, normals: FloatArray, colours: FloatArray) -> None:
    """Write a point cloud as binary PLY.

    Parameters
    ----------
    path : path
    points : (n, 3) float array
        Camera frame, mm or relative.
    normals : (n, 3) float array
    colours : (n, 3) float array
        R, G, B in [0, 1].
    """
    write_atomically(path, as_ply(points, normals, colours))


# Pictures -------------------------------------------------------------------------------


def read_image(path: PathLike) -> FloatArray:
    """Read a grey or colour picture of 8 or 16 bits: PNG, JPEG, TIFF.

    Parameters
    ----------
    path : path

    Returns
    -------
    (H, W) or (H, W, 3) float array
        Stored values over their maximum (255 or 65535); R, G, B. An alpha channel is dropped.

    Raises
    ------
    FileNotFoundError, ValueError
        In one sentence, if there is no such file or it is not such a picture.
    """
    stored = read_stored(path)
    if stored.dtype not in (np.uint8, np.uint16):
        raise ValueError(f"{path}: expected 8 or 16 bits a channel, found {stored.dtype}")
    if stored.ndim == 3:  # grey with alpha, or BGR(A) to RGB
        stored = stored[..., 0] if len(stored[0, 0]) == 2 else stored[..., 2::-1]
    return stored / float(np.iinfo(stored.dtype).max)


def read_stored(path: PathLike) -> np.ndarray:
    """Read a picture as the numbers that the file holds, channels in OpenCV's order."""
    source = Path(path)
    if not source.exists():
        raise FileNotFoundError(f"{source}: there is no such file")
    try:
        content = source.read_bytes()
    except OSError as error:
        raise OSError(f"{source}: cannot be read: {error.strerror or error}") from error
    level = cv2.utils.logging.setLogLevel(0)  # what OpenCV would print is said in the exception
    try:
        stored = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED) if content else None
    except cv2.error:
        stored = None
    finally:
        cv2.utils.logging.setLogLevel(level)
    if stored is None:
        raise ValueError(f"{source}: not a picture that can be read (PNG, JPEG or TIFF)")
    return stored


def _size(picture: np.ndarray) -> str:
    return f"{picture.shape[1]}x{picture.shape[0]} px"


def read_mask(path: PathLike) -> BoolArray:
    """Read a mask, (H, W): True where the picture is brighter than half."""
    image = read_image(path)
    return (image if image.ndim == 2 else image.max(axis=-1)) > 0.5


def read_frame(path: PathLike, calibration: Calibration | None = None, mask: PathLike | None = None) -> Frame:
    """Read a frame, and its mask if there is one.

    Parameters
    ----------
    path : path
        PNG, JPEG or TIFF of 8 or 16 bits, grey or colour.
    calibration : Calibration, optional
        If given, the frame must have its size.
    mask : path, optional
        A picture of the frame's size, bright where the frame is to be used.

    Returns
    -------
    Frame

    Raises
    ------
    OSError, ValueError
        In one sentence, if a file cannot be used.
    """
    image = read_image(path)
    if calibration is not None:
        camera = calibration.camera
        if (camera.height, camera.width) != image.shape[:2]:
            raise ValueError(
                f"{path} is {_size(image)}, but the calibration is for {camera.width}x{camera.height} px"
            )
    inside = np.ones(image.shape[:2], dtype=bool) if mask is None else read_mask(mask)
    if inside.shape != image.shape[:2]:
        raise ValueError(f"the mask {mask} is {_size(inside)}, the frame {_size(image)}")
    if not inside.any():
        raise ValueError(f"the mask {mask} is empty: no pixel in it is brighter than half")
    return Frame(image, inside, Path(path).name)


# Results --------------------------------------------------------------------------------


def save_depth(
    path: PathLike, distance: FloatArray, z: FloatArray, normals: FloatArray, mask: BoolArray, metric: bool
) -> None:
    """Write `depth.npz`: distance and z (H, W), normals (H, W, 3), mask, metric."""
    try:
        with open(path, "wb") as stream:
            np.savez_compressed(
                stream,
                distance=distance.astype(np.float32),
                z=z.astype(np.float32),
                normals=normals.astype(np.float32),
                mask=mask,
                metric=np.array(metric),
            )
    except OSError as error:
        Path(path).unlink(missing_ok=True)
        raise OSError(f"cannot write {path}: {error.strerror or error}") from error


def report(result: Result) -> dict[str, Any]:
    """What `report.json` holds: status, energy, settings, the range of distances and what they mean."""
    known = result.distance[result.mask]
    photometry = result.problem.photometry
    return {
        "status": result.status.name,
        "ended": result.status.value,
        "iterations": result.iterations,
        "energy": result.energy,
        "terms": dict(result.iterate.terms),
        "seconds": result.seconds,
        "unit": result.problem.unit,
        "metric": result.metric,
        "scale": scale_of(result),
        "meaning": list(meaning(result)),
        "distance": {
            "median": float(np.median(known)),
            "least": float(known.min()),
            "greatest": float(known.max()),
        },
        "pixels": int(known.size),
        "photometry": {"k": photometry.k, "gamma": photometry.gamma, "gain": photometry.gain},
        "settings": result.problem.settings,
    }


def save_result(result: Result, folder: PathLike) -> None:
    """Write `depth.npz`, `cloud.ply`, `overview.png` and `report.json` into a folder.

    Parameters
    ----------
    result : Result
    folder : path
        Made if need be. Either all four files are written or none.

    Raises
    ------
    OSError
        In one sentence, if they cannot be written.
    """
    from endolab.plots import overview

    with staged_folder(folder) as staging:
        save_depth(
            staging / "depth.npz", result.distance, result.z, result.normals, result.mask, result.metric
        )
        picture = result.problem.picture if result.problem.picture is not None else result.problem.image
        colour = np.broadcast_to(picture[..., None], (*picture.shape, 3)) if picture.ndim == 2 else picture
        inside = result.mask
        write_cloud(staging / "cloud.ply", result.points[inside], result.normals[inside], colour[inside])
        write_atomically(staging / "report.json", as_json(report(result)))
        try:
            overview(result).savefig(staging / "overview.png")
        except OSError as error:
            raise OSError(f"cannot write overview.png: {error.strerror or error}") from error

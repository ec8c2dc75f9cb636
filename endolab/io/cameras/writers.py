"""Cameras as other programs read them: OpenCV's FileStorage, Kalibr's camchain, COLMAP's and ROS's files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from endolab.io.atomic import PathLike, write_atomically
from endolab.model.cameras import BrownConrady, Camera, KannalaBrandt, Pinhole
from endolab.model.schema import unknown_name

PROGRAMS = ("opencv", "kalibr", "colmap", "ros")


def write_camera_for(program: str, camera: Camera, path: PathLike) -> None:
    """Write a camera as a program reads it, whole or not at all.

    Parameters
    ----------
    program : {"opencv", "kalibr", "colmap", "ros"}
    camera : Camera
        Of a lens that the program has: a pinhole, Brown-Conrady or Kannala-Brandt.
    path : path
        OpenCV's is YAML, XML or JSON, by how it ends.

    Raises
    ------
    OSError, ValueError
        In one sentence, if it cannot be written, or the program has no such camera.
    """
    if program not in PROGRAMS:
        raise unknown_name("program", program, PROGRAMS)
    if not isinstance(camera, BrownConrady | KannalaBrandt | Pinhole):
        raise ValueError(f"{program} has no camera as endolab's {camera.model}")
    matrix = [camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0]
    k = list(camera.k) if isinstance(camera, KannalaBrandt | BrownConrady) else []
    is_fisheye = isinstance(camera, KannalaBrandt)
    size = [camera.width, camera.height]
    match program:
        case "opencv":
            text = _opencv(size, matrix, k or [0.0] * 5, is_fisheye, Path(path).suffix)
        case "kalibr":
            if not is_fisheye and any(k[4:]):
                raise ValueError("kalibr's radtan has no k3 to k6, which this camera has")
            model = "equidistant" if is_fisheye else "radtan"
            chain = {
                "camera_model": "pinhole",
                "intrinsics": [camera.fx, camera.fy, camera.cx, camera.cy],
                "distortion_model": model if k else "none",
                "distortion_coeffs": k[:4],
                "resolution": size,
            }
            text = _as_yaml({"cam0": chain})
        case "colmap":
            model = "OPENCV_FISHEYE" if is_fisheye else "FULL_OPENCV" if k else "PINHOLE"
            # COLMAP counts from the corner of the first pixel.
            centre = [camera.cx + 0.5, camera.cy + 0.5]
            words = [1, model, *size, camera.fx, camera.fy, *centre, *k]
            head = "# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n"
            text = head + " ".join(map(str, words)) + "\n"
        case "ros":
            model = "equidistant" if is_fisheye else "rational_polynomial"
            text = _as_yaml(_ros(size, matrix, k or [0.0] * 8, model))
    write_atomically(path, text.encode())


def _opencv(
    size: list[int], matrix: list[float], k: list[float], is_fisheye: bool, suffix: str
) -> str:
    import cv2
    import numpy as np

    kinds = (".yaml", ".yml", ".xml", ".json")
    if suffix.lower() not in kinds:
        raise ValueError(f"OpenCV's files end in {', '.join(kinds)}, got {suffix!r}")
    mode = cv2.FileStorage_WRITE | cv2.FileStorage_MEMORY
    storage = cv2.FileStorage(f"camera{suffix.lower()}", mode)
    storage.write("image_width", size[0])
    storage.write("image_height", size[1])
    storage.write("fisheye_model", int(is_fisheye))
    storage.write("camera_matrix", np.reshape(matrix, (3, 3)))
    storage.write("distortion_coefficients", np.reshape(k, (-1, 1)))
    return str(storage.releaseAndGetString())


def _ros(size: list[int], matrix: list[float], k: list[float], model: str) -> Any:
    def rows(count: int, data: list[float]) -> dict[str, Any]:
        return {"rows": count, "cols": len(data) // count, "data": data}

    fx, _, cx, _, fy, cy, *_ = matrix
    eye = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    projection = [fx, 0.0, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    return {
        "image_width": size[0],
        "image_height": size[1],
        "camera_name": "endoscope",
        "camera_matrix": rows(3, matrix),
        "distortion_model": model,
        "distortion_coefficients": rows(1, k),
        "rectification_matrix": rows(3, eye),
        "projection_matrix": rows(3, projection),
    }


def _as_yaml(content: dict[str, Any]) -> str:
    import yaml

    return str(yaml.safe_dump(content, sort_keys=False, default_flow_style=None))

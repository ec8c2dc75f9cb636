"""Published pictures of real targets: what is found in them, and how well cameras fit.

Not a test: it asserts nothing. The pictures are looked for as the tests do.
"""

from pathlib import Path

import cv2
import numpy as np

from endolab import datasets
from endolab.calibration.detection.detect import detect
from endolab.calibration.geometric.fit import calibrate_camera
from endolab.calibration.geometric.reprojection import View, views_of
from endolab.calibration.targets import TARGETS, Chessboard, CircleGrid, Target
from endolab.io.images import read_image
from endolab.model.cameras import KannalaBrandt
from tests.benchmarks.report import table

PAPER = datasets.load_calibration("paper").camera
LAPAROSCOPE = (1770.0, 1770.0, 915.0, 459.0)  # published with it


def theirs(views: list[View], target: Target, size: tuple[int, int]) -> str:
    """RMSE of OpenCV's fisheye calibration, px."""
    objects = [target.points[view.ids].reshape(1, -1, 3) for view in views]
    pixels = [view.pixels.reshape(1, -1, 2) for view in views]
    flags = cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW
    how = {"flags": flags, "criteria": (3, 200, 1e-9)}
    try:
        found = cv2.fisheye.calibrate(objects, pixels, size, np.eye(3), np.zeros((4, 1)), **how)
    except cv2.error:
        return "fails"
    return f"{found[0]:.3f}"


def row(name: str, files: list[Path], target: Target, oracle: bool = True, **options: object) -> list[str]:
    """Detect and calibrate."""
    views, seen = [], 0
    for file in files:
        image = read_image(file)
        found = detect(image, target)
        seen += len(found.ids) > 0
        views += views_of(file.name, found, target)
    size = image.shape[1], image.shape[0]
    fit = calibrate_camera(views, target, *size, **options)
    everything = np.concatenate(fit.residuals)
    counts = f"{seen}/{len(files)}", f"{sum(int(good.sum()) for good in fit.inliers)}/{len(everything)}"
    rmse = f"{fit.rmse:.3f}", f"{np.sqrt(np.mean(np.sum(everything**2, axis=1))):.3f}"
    reference = theirs(views, target, size) if oracle else "–"
    return [name, *counts, *rmse, reference, f"{fit.camera.fx:.1f} ± {fit.standard_errors['fx']:.1f}"]


def main() -> None:
    """Print the tables."""
    data = datasets.data_folder()
    sheet = [data / "vicalib_frame" / "sample_frame.png"]
    circles = sorted((data / "circles_fetoscope").rglob("*.jpg"))
    capsule = sorted((data / "checkerboard_capsule").glob("*.jpg"))
    boards = sorted((data / "plates_laparoscope" / "chessboard").glob("*.png"))
    big = TARGETS["vicalib_big"]
    image = read_image(boards[0])
    lens = KannalaBrandt(image.shape[1], image.shape[0], *LAPAROSCOPE)
    rows = [
        row("Vicalib, refined", sheet, big, start=PAPER),
        row("fetoscope, circles", circles, CircleGrid(3, 11, 1.0, radius=0.4)),
        row("capsule, chessboard", capsule, Chessboard(8, 7, 2.0)),
        row("laparoscope, chessboard", boards, Chessboard(15, 11, 3.0), start=lens),
    ]
    head = ("target", "frames", "points that count", "RMSE px", "of all", "cv2.fisheye, of all", "fx px")
    table("Published pictures", head, rows)


if __name__ == "__main__":
    main()

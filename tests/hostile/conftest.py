"""Good files, made once, that the tests here damage; and how many examples they try."""

import contextlib
import json
import os
import shutil
from pathlib import Path

import cv2
import hypothesis
import numpy as np
import pytest

import endolab as el
from endolab.cli.main import main
from endolab.io.datasets import traced
from endolab.io.settings import SolvingSettings, write_settings
from endolab.numerics.checked_types import to_content

# Of every damage; `make attack` asks for more.
EXAMPLES = int(os.environ.get("ENDOLAB_EXAMPLES", "20"))
hypothesis.settings.register_profile(
    "hostile",
    max_examples=EXAMPLES,
    derandomize=EXAMPLES == 20,
    deadline=None,
    database=None,
    suppress_health_check=list(hypothesis.HealthCheck),
)
hypothesis.settings.load_profile("hostile")

# Of other programs.
CALIBRATIONS = {
    "rig.xml": """<rig><camera><camera_model type="calibu_fu_fv_u0_v0_kb4" version="8">
<width> 1440 </width> <height> 1080 </height>
<right> [ 1; 0; 0 ] </right> <down> [ 0; 1; 0 ] </down> <forward> [ 0; 0; 1 ] </forward>
<params> [ 717.7; 718.0; 734.7; 552.1; -0.14; -0.0003; 0.0015; -0.0001 ] </params>
</camera_model></camera></rig>""",
    "camchain.yaml": """cam0:
  camera_model: pinhole
  distortion_coeffs: [-0.05, 0.01, -0.002, 0.001]
  distortion_model: equidistant
  intrinsics: [300, 310.0, 160.0, 120.0]
  resolution: [320, 240]
""",
    "opencv.yaml": """%YAML:1.0
---
image_width: 320
image_height: 240
camera_matrix: !!opencv-matrix
   rows: 3
   cols: 3
   dt: d
   data: [ 300., 0., 160., 0., 310., 120., 0., 0., 1. ]
distortion_coefficients: !!opencv-matrix
   rows: 5
   cols: 1
   dt: d
   data: [ -0.1, 0.02, 0., 0., 0.01 ]
""",
    "cameras.txt": "1 OPENCV 320 240 300 310 160 120 -0.1 0.02 0.001 -0.002\n",
}


def run(words):
    """Run a command in this process; what it prints goes nowhere."""
    with Path(os.devnull).open("w") as nowhere, contextlib.redirect_stdout(nowhere):
        return main(words.split())


@pytest.fixture(scope="session")
def given(tmp_path_factory):
    """A folder of files of every kind that endolab reads."""
    folder = tmp_path_factory.mktemp("given")
    known = "--calibration endoscope.json --solver facing --out"
    with contextlib.chdir(folder):
        assert run("simulate colon --width 64 --out . --seed 1") == 0
        frame = cv2.imread("frame.png")
        Path("pictures").mkdir()
        for number in range(6):  # ever darker
            darker = np.uint8(frame * (1 - 0.01 * number))
            cv2.imwrite(f"pictures/{number}.png", darker)
        assert run(f"reconstruct frame.png {known} result") == 0
        shutil.copy("result/depth.npz", "depth.npz")
        shutil.copy("result/recording.rrd", "run.rrd")
        assert run(f"reconstruct pictures {known} video") == 0
        sheet = "--width 240 --frames 6 --target vicalib_small"
        assert run(f"simulate sheet {sheet} --out sheet") == 0
        for name, code in (("video.mkv", "FFV1"), ("video.avi", "MJPG")):
            fourcc = cv2.VideoWriter.fourcc(*code)
            writer = cv2.VideoWriter(name, fourcc, 30.0, frame.shape[1::-1])
            for _ in range(4):
                writer.write(frame)
            writer.release()
        cv2.imwrite("frame.jpg", frame)
        cv2.imwrite("deep.png", frame.astype(np.uint16) * 257)
        cv2.imwrite("mask.png", np.full(frame.shape[:2], 255, np.uint8))
        cv2.imwrite("0042_depth.png", np.full((96, 120), 13107, np.uint16))  # 20 mm
        z = np.full((48, 64), 20.0, np.float32)
        np.savez("other.npz", depth=z, other=z)
        np.save("other.npy", z)
        cv2.imwrite("other.tiff", z)
        shutil.copy(traced.FOLDER / "matt.npz", "traced.npz")
        Path("target.json").write_text(
            json.dumps(to_content(el.TARGETS["vicalib_grey"]))
        )
        wishes = SolvingSettings({"lam": 1.0, "xi": "d"}, {"k": 2.0})
        write_settings(wishes, "settings.json")
        for name, text in CALIBRATIONS.items():
            Path(name).write_text(text)
    return folder


def sentences(output):
    """Lines that were said, but for the one of a first run, whose loops are compiled."""
    return [line for line in output.splitlines() if not line.startswith("Compiling ")]


def whole(path):
    """Whether a result can be read back."""
    content = path.read_bytes()
    match path.suffix:
        case ".npz":
            with np.load(path) as archive:
                return all(len(archive[name].tobytes()) for name in archive.files)
        case ".json":
            return isinstance(json.loads(content), dict)
        case ".csv":
            return content.endswith(b"\n")
        case ".png":
            return cv2.imread(str(path)) is not None
        case ".mkv":
            return all(image is not None for _, image in el.open_frames(path))
        case ".rrd":
            return el.read_recording(path) is not None
        case ".html":
            return content.rstrip().endswith(b"</html>")
    return b"end_header" in content  # .ply

"""The good files that are damaged: made once in a folder, by the commands under test, then copied."""

import contextlib
import os
import shutil
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

WIDTH, HEIGHT = 32, 24
GEOMETRY = """<rig><camera>
<camera_model name="" index="0" serialno="0" type="calibu_fu_fv_u0_v0_kb4" version="8">
<width> 1440 </width> <height> 1080 </height>
<right> [ 1; 0; 0 ] </right> <down> [ 0; 1; 0 ] </down> <forward> [ 0; 0; 1 ] </forward>
<params> [ 717.6911; 718.0214; 734.7278; 552.0724; -0.1396589; -0.0003139987; 0.001505504;
-0.0001316715 ] </params>
</camera_model></camera></rig>
"""
PHOTOMETRY = """<rig><camera>
<camera_model index="0" name="" serialno="0" type="gamma" version="1.0">
<gamma> [ 2.2 ] </gamma> </camera_model>
</camera><light>
<light_model index="0" name="" serialno="0" type="sls" version="1.0">
<sigma> 1.000000 </sigma> <mu> 2.767302 </mu>
<P> [ -6.1e-05; -0.001135; -0.003612 ] </P> <D> [ 0.011092; 0.0; 0.999938 ] </D> </light_model>
</light></rig>
"""
PICTURES = (
    "frame.png",
    "frame.jpg",
    "frame.tif",
    "frame.bmp",
    "frame16.png",
    "frame16.tif",
    "grey.png",
    "alpha.png",
)
TARGET = {
    **{"endolab_target": 1, "kind": "dots", "columns": 19, "rows": 10, "spacing": 5.0},
    **{"small": 1.0, "large": 1.5, "seed": 71},
}


@dataclass(frozen=True)
class Given:
    """A folder of good files, to take copies of into the folder of a case, where one is."""

    folder: Path

    def read(self, name):
        """Bytes of a file."""
        return (self.folder / name).read_bytes()

    def take(self, *names):
        """Copy files or folders into the working folder; their names."""
        for name in names:
            if (self.folder / name).is_dir():
                shutil.copytree(self.folder / name, name, dirs_exist_ok=True)
            else:
                Path(name).parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(self.folder / name, name)
        return names


def make(folder):
    """Write all of them, in a folder, by endolab itself; this warms it up, too."""
    before = os.getcwd()
    os.chdir(folder)
    try:
        with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
            _make()
    finally:
        os.chdir(before)
    return Given(Path(folder))


def run(*argv):
    """Run a command that must succeed."""
    from endolab.cli.main import main

    status = main([str(word) for word in argv])
    if status != 0:
        raise RuntimeError(f"the good files cannot be made: endolab {' '.join(map(str, argv))}")


def _make():
    import endolab as el

    known = el.load_calibration("paper", width=WIDTH)
    known.save("cal.json")
    run("simulate", "colon", "--calibration", "cal.json", "--width", WIDTH, "--out", ".", "--seed", 1)
    frame = cv2.imread("frame.png")
    for name in PICTURES:
        picture = frame
        if "16" in name:
            picture = frame.astype(np.uint16) * 257
        elif name.startswith("grey"):
            picture = frame[..., 1]
        elif name.startswith("alpha"):
            picture = np.dstack([frame, np.full(frame.shape[:2], 255, np.uint8)])
        cv2.imwrite(name, picture)
    mask = np.zeros((HEIGHT, WIDTH), np.uint8)
    mask[3:-3, 4:-4] = 255
    cv2.imwrite("mask.png", mask)
    for solver in ("facing", "fast_marching", "gauss_newton", "primal_dual"):  # and the loops are compiled
        how = ("--solver", solver, "--lam", "0.1,1", "--truth", "truth.npz")
        run("sweep", "frame.png", "--calibration", "endoscope.json", "--out", "table.csv", *how)
    run(
        "reconstruct",
        "frame.png",
        "--calibration",
        "endoscope.json",
        "--out",
        "result",
        "--mesh",
        "--prepare",
    )
    shutil.copy("result/depth.npz", "depth.npz")
    with contextlib.suppress(FileNotFoundError):  # without Rerun there is none
        shutil.copy("result/recording.rrd", "run.rrd")
    _make_videos(el, known)
    Path("geometry.xml").write_text(GEOMETRY)
    Path("photometry.xml").write_text(PHOTOMETRY)
    _make_published()


def _make_videos(el, known):
    Path("pictures").mkdir()
    seen = [
        el.render(el.SCENES["colon"], known.camera, known.photometry, noise=1, bits=8, seed=s).image
        for s in range(4)
    ]
    for number, image in enumerate(seen):
        cv2.imwrite(f"pictures/{number:03d}.png", np.round(255 * image[..., ::-1]).astype(np.uint8))
    for name, code in (("video.mkv", "FFV1"), ("video.avi", "MJPG")):
        writer = cv2.VideoWriter(name, cv2.VideoWriter.fourcc(*code), 30.0, (WIDTH, HEIGHT))
        for number in range(4):
            writer.write(cv2.imread(f"pictures/{number:03d}.png"))
        writer.release()
    how = ("--calibration", "cal.json", "--solver", "facing")
    run("reconstruct", "pictures", *how, "--out", "done")
    sheet = ("--calibration", "paper", "--width", 240, "--frames", 4, "--target", "vicalib_small")
    run("simulate", "sheet", *sheet, "--out", "sheet")
    from endolab.calibration.targets import TARGETS
    from endolab.io.detection_cache import detect_cached
    from endolab.io.video import open_frames

    detect_cached(open_frames("sheet"), TARGETS["vicalib_small"], "detections.jsonl")


def _make_published():
    """Frames in the layouts of three data sets."""
    for folder in ("c3vd", "simcol3d", "ucl2019"):
        Path(folder).mkdir()
    depth = np.full((96, 120), round(20 * 655.35), np.uint16)
    depth[:, 0] = 0
    cv2.imwrite("c3vd/0042_depth.png", depth)
    cv2.imwrite("c3vd/0042_color.png", np.full((96, 120, 3), 90, np.uint8))
    cv2.imwrite("simcol3d/Depth_0007.png", np.full((475, 475), 13_056, np.uint16))
    cv2.imwrite("simcol3d/FrameBuffer_0007.png", np.full((475, 475, 3), 90, np.uint8))
    cv2.imwrite("ucl2019/T1_Depth_0012.png", np.full((256, 256), 51, np.uint8))
    cv2.imwrite("ucl2019/T1_FrameBuffer_0012.png", np.full((256, 256, 3), 90, np.uint8))

"""Classes of cases: files that are damaged, given to the commands and functions that read them."""

import json
import os
from pathlib import Path

import cv2
import numpy as np

from tests.hostile import damage, given
from tests.hostile.case import call, command
from tests.hostile.damage import pick

QUICK = ("--solver", "facing")
RESULT = ("depth.npz", "cloud.ply", "overview.png", "report.json")


def _solved(frame, calibration, rng, *, mask=None):
    """Read a frame and a calibration, reconstruct, and write the depth map: most of a command, and quick."""
    solver = pick(rng, ["facing", "facing", "fast_marching", "gauss_newton"])

    def work():
        import endolab as el
        from endolab.io.surfaces import save_depth

        known = el.load_calibration(calibration)
        result = el.reconstruct(el.read_frame(frame, known, mask), known, solver=solver)
        save_depth("depth.npz", result, result.metric)

    told = f"el.reconstruct(el.read_frame({frame!r}, {calibration!r}, {mask!r}), solver={solver!r})"
    return call(told, work, new=("depth.npz",))


def _rarely(rng, argv, case, *, share=0.04, new=("out",)):
    """The whole command instead, for a share of the cases: it draws, which takes most of a second."""
    return command(*argv, new=new) if rng.random() < share else case


# Descriptions -----------------------------------------------------------------------------------
def _write_json(rng, good, name, content):
    document = json.loads(content)
    if rng.random() < 0.25:
        Path(name).write_bytes(damage.damaged_bytes(rng, content))
    else:
        text = damage.damaged_json(rng, document)
        Path(name).write_bytes(text.encode(pick(rng, ["utf-8"] * 19 + ["utf-16"]), errors="surrogatepass"))


def calibration(rng, good):
    """An endoscope.json in which something is wrong."""
    good.take("frame.png", "mask.png")
    tabulated = {"model": "tabulated", "theta": [0, 0.5, 1, 1.5], "value": [0.3, 0.28, 0.2, 0.1]}
    light = {"position": [3.0, 0, 0], "direction": [0, 0, 1.0], "exponent": 1.0, "weight": 1.0}
    document = json.loads(good.read("endoscope.json"))
    if rng.random() < 0.3:
        document["photometry"]["brdf"] = tabulated
    if rng.random() < 0.3:
        document["photometry"]["lights"] = [light, light]
    kind = pick(rng, ["kannala_brandt"] * 3 + ["pinhole", "scaramuzza"])
    size = {"model": kind, "width": 32, "height": 24}
    if kind == "pinhole":
        document["camera"] = {**size, "fx": 16.0, "fy": 16.0, "cx": 15.5, "cy": 11.5}
    elif kind == "scaramuzza":
        affine = {"cx": 16.0, "cy": 12.8, "c": 1.0, "d": 0.0, "e": 0.0}
        document["camera"] = {**size, **affine, "a": [18.2, 0.0, -0.0343, 0.0011, -8.9e-5]}
    _write_json(rng, good, "bad.json", json.dumps(document).encode())
    how = pick(rng, ["solve", "solve", "solve", "simulate", "sweep", "command"])
    if how == "simulate":
        argv = ("simulate", "tube", "--calibration", "bad.json", "--width", 24, "--out", "out")
        return command(*argv, new=("out",))
    if how == "sweep":
        argv = ("sweep", "frame.png", "--calibration", "bad.json", *QUICK, "--out", "t.csv")
        return command(*argv, new=("t.csv",), kept=("t.csv",))  # a row that failed is in it, too
    argv = ("reconstruct", "frame.png", "--calibration", "bad.json", *QUICK, "--out", "out")
    return _rarely(rng, argv, _solved("frame.png", "bad.json", rng), share=0.02)


def target(rng, good):
    """The description of a target in which something is wrong."""
    document = dict(given.TARGET)
    if rng.random() < 0.3:
        kind = pick(rng, ["charuco", "chessboard", "circles"])
        document = {"endolab_target": 1, "kind": kind, "columns": 7, "rows": 5, "spacing": 5.0}
        document |= {"circles": {"radius": 1.0}, "charuco": {"marker": 3.5}}.get(kind, {})
    elif rng.random() < 0.5:
        document |= {"greys": 0.8, "fold": 9, "margin": 8.0}
    _write_json(rng, good, "bad.json", json.dumps(document).encode())
    return command("target", "bad.json", "--out", "sheet.svg", new=("sheet.svg",), names=("bad.json",))


def endomapper(rng, good):
    """EndoMapper's XML files in which something is wrong."""
    good.take("geometry.xml", "photometry.xml")
    name = pick(rng, ["geometry.xml", "photometry.xml"])
    text, how = good.read(name).decode(), pick(rng, ["text", "text", "bytes", "entity", "deep", "big"])
    if how == "text":
        content = damage.damaged_text(rng, text)
    elif how == "bytes":
        content = damage.damaged_bytes(rng, text.encode())
    elif how == "entity":
        entity = pick(
            rng, ['<!DOCTYPE r [<!ENTITY a "b">]>', '<!DOCTYPE r SYSTEM "file:///etc/passwd">', "<!-- x -->"]
        )
        content = (entity + text).encode(pick(rng, ["utf-8", "utf-16", "utf-7"]))
    elif how == "deep":
        content = b"<rig>" * 50_000
    else:
        content = text.encode() + b" " * 2_000_000
    Path(name).write_bytes(content)
    argv = ("convert", "geometry.xml", "photometry.xml")[
        : 2 + (rng.random() < 0.9 or name == "photometry.xml")
    ]
    return command(*argv, "--out", "cal.json", new=("cal.json",), names=(name,))


# Pictures ---------------------------------------------------------------------------------------
def _bad_picture(rng, good, name):
    """Content of a damaged picture."""
    content, suffix = good.read(name), Path(name).suffix
    how = pick(rng, ["bytes", "bytes", "odd", "odd", "other"])
    if how == "bytes" or (how == "odd" and suffix == ".bmp"):
        return damage.damaged_bytes(rng, content)
    if how == "odd":
        odd = {".png": lambda: damage.odd_png(rng), ".tif": lambda: damage.odd_tiff(rng, content)}
        return odd.get(suffix, lambda: damage.odd_jpeg(rng, content))()
    stored = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_UNCHANGED)
    odd = {
        "float": lambda: stored.astype(np.float32) / 255,
        "nan": lambda: np.full(stored.shape, np.nan, np.float32),
        "double": lambda: stored.astype(np.float64),
        "black": lambda: stored * 0,
        "white": lambda: stored * 0 + np.iinfo(stored.dtype).max,
        "pixel": lambda: stored[:1, :1],
        "row": lambda: stored[:1],
        "turned": lambda: np.ascontiguousarray(np.swapaxes(stored, 0, 1)),
        "doubled": lambda: np.repeat(np.repeat(stored, 2, 0), 2, 1),
        "noise": lambda: rng.integers(0, 256, stored.shape).astype(np.uint8),
        "signed": lambda: stored.astype(np.int16) - 100,
    }
    changed = odd[pick(rng, list(odd))]()
    done, encoded = cv2.imencode(".tif" if changed.dtype not in (np.uint8, np.uint16) else suffix, changed)
    return encoded.tobytes() if done else b""


def image(rng, good):
    """A frame that is damaged, or another kind of picture than expected."""
    name = pick(rng, given.PICTURES)
    good.take("endoscope.json")
    bad = "bad" + pick(rng, [Path(name).suffix] * 9 + [".png", ".jpg", ""])
    Path(bad).write_bytes(_bad_picture(rng, good, name))
    argv = ("reconstruct", bad, "--calibration", "endoscope.json", *QUICK, "--out", "out")
    return _rarely(rng, argv, _solved(bad, "endoscope.json", rng)).but(names=(bad,))


def mask(rng, good):
    """A mask that is damaged."""
    good.take("endoscope.json", "frame.png")
    Path("bad.png").write_bytes(_bad_picture(rng, good, pick(rng, ["mask.png", "mask.png", *given.PICTURES])))
    argv = (
        "reconstruct",
        "frame.png",
        "--mask",
        "bad.png",
        "--calibration",
        "endoscope.json",
        *QUICK,
        "--out",
        "out",
    )
    names = "bad.png", "frame.png"  # which has no light where the mask is
    return _rarely(rng, argv, _solved("frame.png", "endoscope.json", rng, mask="bad.png")).but(names=names)


def published(rng, good):
    """Frames of the published data sets, one file of which is damaged, missing or of another size."""
    folder = pick(rng, ["c3vd", "c3vd", "simcol3d", "ucl2019"])
    good.take(folder)
    name = pick(rng, sorted(os.listdir(folder)))
    if rng.random() < 0.1:
        os.remove(f"{folder}/{name}")
    else:
        stored = cv2.imread(f"{folder}/{name}", cv2.IMREAD_UNCHANGED)
        changed = pick(
            rng, [stored[:-1], stored * 0, stored.astype(np.uint8), stored[..., None].repeat(3, -1)]
        )
        content = Path(f"{folder}/{name}").read_bytes()
        Path(f"{folder}/{name}").write_bytes(
            damage.damaged_bytes(rng, content)
            if rng.random() < 0.5 or changed.ndim > 3
            else pick(rng, [damage.odd_png(rng), cv2.imencode(".png", changed)[1].tobytes()])
        )

    def work():
        import endolab as el

        camera = el.Pinhole(256, 256, 128.0, 128.0, 127.5, 127.5) if folder == "ucl2019" else None
        sample = el.open_dataset(folder, camera)[0]
        if not np.isfinite(sample.distance).any() or np.nanmin(sample.distance) <= 0:
            raise ZeroDivisionError("a truth that is none")

    return call(f"el.open_dataset({folder!r})[0], with a bad {name}", work, names=(folder,))


# Depth maps and recordings ------------------------------------------------------------------------
def depth(rng, good):
    """A depth.npz or truth.npz that is damaged, to be evaluated."""
    good.take("depth.npz", "truth.npz")
    name = pick(rng, ["depth.npz", "truth.npz"])
    content = good.read(name)
    if rng.random() < 0.35:
        Path(name).write_bytes(damage.damaged_bytes(rng, content))
    else:
        with np.load(good.folder / name) as archive:
            arrays = {key: archive[key] for key in archive.files}
        Path(name).write_bytes(damage.odd_npz(rng, arrays))
    how = [(), ("--json",), ("--scale", "median"), ("--scale", "none"), ("--max-angle", 40)]
    names = "depth.npz", "truth.npz", "no pixel has both"
    return command("evaluate", "depth.npz", "truth.npz", *pick(rng, how), names=names)


def recording(rng, good):
    """A recording that is damaged, all of which is read."""
    if not (good.folder / "run.rrd").exists():
        return call("there is no Rerun here", lambda: None)
    Path("bad.rrd").write_bytes(damage.damaged_bytes(rng, good.read("run.rrd")))

    def work():
        import endolab as el

        read = el.read_recording("bad.rrd")
        for run in read.runs.values():
            run.table(), run.stages, run.unit, run.mask, run.picture, run.settings
            for iteration in run.pictured:
                run.depth(iteration), run.normals(iteration)

    return call("el.read_recording('bad.rrd') and all that it holds", work, names=("bad.rrd",))


# What is gone on with -----------------------------------------------------------------------------
def table(rng, good):
    """The table of a sweep, damaged, with which a sweep goes on."""
    good.take("endoscope.json", "frame.png", "truth.npz")
    Path("table.csv").write_bytes(damage.damaged_table(rng, good.read("table.csv").decode()))
    how = ("--calibration", "endoscope.json", *QUICK, "--lam", "0.1,1,10", "--truth", "truth.npz")
    return command("sweep", "frame.png", *how, "--out", "table.csv", new=("table.csv",), names=("table.csv",))


def resumed(rng, good):
    """The results of a video, damaged, with which the same command goes on."""
    good.take("cal.json", "done", "pictures")
    report = json.loads(good.read("done/report.json"))
    report["sequence"] = str(Path("pictures").resolve())
    Path("done/report.json").write_text(json.dumps(report))
    files = sorted(path for path in Path("done").rglob("*") if path.is_file())
    # Those few that decide what is done come as often as all the depth maps.
    path = pick(rng, [*files, *[file for file in files if file.suffix in (".csv", ".json")] * 3])
    content = path.read_bytes()
    if path.suffix == ".csv":
        path.write_bytes(damage.damaged_table(rng, content.decode()))
    elif path.suffix == ".json" and rng.random() < 0.8:
        path.write_text(damage.damaged_json(rng, report), errors="surrogatepass")
    elif path.suffix == ".npz" and rng.random() < 0.6:
        with np.load(good.folder / path) as archive:
            path.write_bytes(damage.odd_npz(rng, {key: archive[key] for key in archive.files}))
    else:
        path.write_bytes(damage.damaged_bytes(rng, content))
    if rng.random() < 0.5:  # so that there is something to do
        done = pick(rng, sorted(os.listdir("done/frames")))
        os.replace(f"done/frames/{done}/depth.npz", "moved.npz")
        os.remove("moved.npz")
    argv = ("reconstruct", "pictures", "--calibration", "cal.json", *QUICK, "--out", "done")
    return command(*argv, new=("done",), kept=("done",), names=("done",))


def detections(rng, good):
    """What was found in a calibration video, damaged, with which the search goes on."""
    good.take("sheet")
    from endolab.calibration.targets import TARGETS
    from endolab.io.detection_cache import detect_cached
    from endolab.io.video import open_frames

    frames, target = open_frames("sheet"), TARGETS["vicalib_small"]
    head, *lines = good.read("detections.jsonl").decode().split("\n")
    told = json.loads(head)
    told["files"] = frames.stamp
    if rng.random() < 0.2:
        head = damage.damaged_json(rng, told)
    else:
        head, at = json.dumps(told), int(rng.integers(len(lines) - 1))
        lines[at] = damage.damaged_json(rng, json.loads(lines[at]))
    content = "\n".join([head, *lines]).encode(errors="surrogatepass")
    Path("d.jsonl").write_bytes(damage.damaged_bytes(rng, content) if rng.random() < 0.3 else content)

    def work():
        from endolab.calibration.session import locate

        found, size = detect_cached(frames, target, "d.jsonl")
        camera = __import__("endolab").load_calibration("paper", width=240).camera
        if size != (camera.width, camera.height):
            raise ZeroDivisionError(f"a size that is none: {size}")
        locate(found, target, camera, lambda *_: None)

    return call("detect_cached(open_frames('sheet'), vicalib_small, 'd.jsonl')", work, new=("d.jsonl",))


# Videos -------------------------------------------------------------------------------------------
def video(rng, good):
    """A video or a folder of pictures that is damaged, or holds other things."""
    good.take("cal.json")
    if rng.random() < 0.4:
        name = pick(rng, ["video.mkv", "video.avi"])
        source = "bad" + pick(rng, [Path(name).suffix] * 5 + [".mp4", ".mov", ".webm"])
        Path(source).write_bytes(damage.damaged_bytes(rng, good.read(name)))
    else:
        source = "pictures"
        good.take("pictures")
        for _ in range(int(rng.integers(1, 4))):
            _odd_picture(
                rng, good, pick(rng, ["000", "001", "002", "003", "004", "x", "1", "٣", "-1", "9" * 30])
            )
    argv = ("reconstruct", source, "--calibration", "cal.json", *QUICK, "--out", "out")
    argv += pick(rng, [(), (), ("--every", 2), ("--limit", 2), ("--every", 3, "--limit", 1)])
    return command(*argv, new=("out",), names=(source, "no frame could be reconstructed"))


def _odd_picture(rng, good, stem):
    """Put something into the folder of pictures that is none."""
    path = Path("pictures") / (stem + pick(rng, [".png", ".png", ".png", ".jpg", ".PNG", ".tif", ".txt"]))
    how = pick(rng, ["picture", "picture", "gone", "folder", "link", "loop", "empty", "twin", "pipe"])
    if path.is_dir() and not path.is_symlink():
        return
    path.unlink(missing_ok=True)
    if how == "picture":
        path.write_bytes(_bad_picture(rng, good, pick(rng, given.PICTURES)))
    elif how == "folder":
        path.mkdir()
    elif how == "link":
        path.symlink_to(pick(rng, ["nothing.png", "/dev/null", "../cal.json", "/"]))
    elif how == "loop":
        path.symlink_to(path.name)
    elif how == "empty":
        path.touch()
    elif how == "twin":
        path.write_bytes(good.read("frame.png"))
        path.with_suffix(".jpg").unlink(missing_ok=True)  # it may be a pipe
        path.with_suffix(".jpg").write_bytes(good.read("frame.jpg"))
    elif how == "pipe":
        os.mkfifo(path)

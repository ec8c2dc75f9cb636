"""What a person gets wrong, typed or called: one sentence that has the word, and nothing is written."""

import contextlib
import io
import json
import re
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest
import tifffile

import endolab as el
from endolab.calibration.simulation.trajectory import trajectory
from endolab.calibration.targets import Charuco, DotGrid
from endolab.cli.main import main
from endolab.io.video import write_video
from endolab.numerics.iteration import finish
from endolab.numerics.threads import limit_threads
from endolab.reconstruction.pipeline import find
from endolab.reconstruction.settings import Settings
from endolab.synthetic.scenes import Tube


class Row(NamedTuple):
    """Words of the command line, a function of the library, or both; and the word that must appear."""

    name: str
    call: str | Callable | tuple
    word: str


FILES = {}  # of the folder, by name, beside a simulated frame
KNOWN = "--calibration endoscope.json"
FRAME = f"reconstruct frame.png {KNOWN} --out o"
FILM = f"reconstruct film {KNOWN} --out o"
SHEET = "--target chessboard --out"


# How a row is made ----------------------------------------------------------------------
def solve(frame="frame.png", mask=None, **options):
    known = el.load_calibration("endoscope.json")
    return el.reconstruct(el.read_frame(frame, known, mask), known, **options)


def solve_found(**options):
    known = el.load_calibration("endoscope.json")
    found = finish(find(el.read_frame("frame.png", known), known, Settings()))
    return el.solve_found(found, known, **options)


def film(**options):
    return el.reconstruct_video(
        "film", el.load_calibration("endoscope.json"), "o", **options
    )


def sweep(frames=("frame.png",), **options):
    return el.sweep(frames, el.load_calibration("endoscope.json"), **options)


def option(typed, word, **options):
    """An option of reconstruct, and the keyword argument."""
    return Row(typed[:30], (f"{FRAME} {typed}", lambda: solve(**options)), word)


def picture(name, content, word):
    FILES[name] = content
    typed = f"reconstruct {name} {KNOWN} --out o"
    return Row(name, (typed, lambda: solve(name, channel="green")), word)


def raw(tags, **how):
    """A TIFF that is a raw picture's, or its preview."""
    stream = io.BytesIO()
    with tifffile.TiffWriter(stream) as file:
        for _ in range(1 + how.get("subifds", 0)):
            file.write(np.zeros((48, 64), np.uint16), extratags=tags, **how)
            how = {}
    return stream.getvalue()


def calibration(name, content, word):
    FILES[name] = content
    typed = f"reconstruct frame.png --calibration {name} --out o"
    return Row(f"{name} {word}", (typed, lambda: el.load_calibration(name)), word)


def endoscope(key, value, word):
    """The frame's endoscope.json with another value at a dotted key; without it for an ellipsis."""

    def change():
        whole = place = json.loads(Path("endoscope.json").read_text())
        *path, last = key.split(".")
        for part in path:
            place = place[part]
        place[last] = value
        if value is ...:
            del place[last]
        return whole

    return calibration(f"endoscope{len(FILES)}.json", change, word)


def settings(content, word):
    name = f"settings{len(FILES)}.json"
    FILES[name] = content
    return Row(f"settings {word}", f"{FRAME} --settings {name}", word)


def target(key, value):
    name = f"target{len(FILES)}.json"
    dots = {"endolab_target": 1, "kind": "dots", "columns": 5, "rows": 4, "spacing": 6}
    FILES[name] = dots | {"small": 1, "large": 2, key: value}
    return Row(f"target {key}", f"target {name} --out t.pdf", key)


def half(name):
    return lambda: Path(name).read_bytes()[: Path(name).stat().st_size // 2]


# The rows -------------------------------------------------------------------------------
ONES = np.ones((48, 64))
PAPR = "reconstruct frame.png --calibration papr"
TWICE = {"known_distance": (30, 1, 2), "median_distance": 30}
OPTIONS = [
    option("--solver gaus_newton", "gauss_newton", solver="gaus_newton"),
    option("--snapshots 3", "snapshots", snapshots=3),
    option("--channel pink", "channel", channel="pink"),
    option("--lam nan", "lam", lam=float("nan")),
    option("--epsilon 0", "epsilon", epsilon=0.0),
    option("--threshold inf", "threshold", threshold=float("inf")),
    option("--xi z", "xi", xi="z"),
    option("--regulariser third", "regulariser", regulariser="third"),
    option("--lam=" + "7" * 10**6 + "x", "lam", lam="7" * 10**6 + "x"),
    option("--max-iterations -1", "iterations", max_iterations=-1),
    option("--contours perhaps", "contours", contours="perhaps"),
    option("--known-distance 30,a,2", "distance", known_distance=(30, "a", 2)),
    option("--known-distance 30,64,6", "64", known_distance=(30, 64, 6)),
    option("--known-diameter 9,1,2", "diameter", known_diameter=(9, 1, 2)),
    option("--known-distance 9,2", "distance", known_distance=(9, 2)),
    option("--threads 0", "threads", threads=0),
    option("--known-distance 30,1,2 --median-distance 30", "median", **TWICE),
    Row("--albedo", (f"{FRAME} --albedo 2", lambda: el.Lambertian(2.0)), "albedo"),
    Row(
        "--uncertainty",
        (
            f"{FRAME} --solver facing --uncertainty",
            lambda: el.uncertainty_of(solve(solver="facing")),
        ),
        "facing",
    ),
    Row("start", lambda: solve(start=solve(width=48)), "start"),
    Row("options", lambda: solve(solver_options={"tolerance": 1}), "solver_options"),
    Row("inflow", lambda: solve(inflow=ONES[1:]), "inflow"),
    Row("cuts", lambda: solve(cuts=np.zeros((2, 3, 3), bool)), "cuts"),
]
PICTURES = [
    picture("flat.png", np.full((48, 64, 3), 120), "constant"),
    picture("black.png", np.zeros((48, 64, 3)), "black.png"),
    picture("white.png", np.full((48, 64, 3), 255), "saturated"),
    picture("words.png", b"hello", "words.png"),
    picture("half.png", half("frame.png"), "half.png"),
    picture("float.tif", np.ones((48, 64), np.float32), "float.tif"),
    picture("float.hdr", np.ones((48, 64, 3), np.float32), "float.hdr"),
    picture("phone.heic", b"\0\0\0\x18ftypmif1\0\0\0\0mif1heic" * 9, "HEIC"),
    picture("preview.dng", raw([(50706, 1, 4, b"\1\4\0\0")]), "raw"),
    picture("mosaic.tif", raw([], photometric="cfa"), "raw"),
    picture("preview.nef", raw([], subfiletype=1, subifds=1), "raw"),
    picture("new.jxl", b"\xff\x0a" * 99, "JPEG XL"),
    picture("small.png", np.full((32, 32), 120), "32x32"),
    picture("clear.png", np.zeros((48, 64, 4)), "transparent"),
    option("--mask small.png", "32x32", mask="small.png"),
    option("--mask black.png", "black.png", mask="black.png"),
    Row("no pink", lambda: el.Frame(ONES / 2, ONES > 0).channel("pink"), "pink"),
    Row("0 to 255", lambda: el.Frame(255 * ONES, ONES > 0), "1]"),
    Row("doubtful mask", lambda: el.Frame(ONES, ONES / 2), "mask"),
    Row("unknown mask", lambda: el.Frame(ONES, ONES * np.nan), "mask"),
    Row("turned mask", lambda: el.Frame(ONES, ONES.T > 0), "48x64"),
]
OPENCV = {"image_width": 64, "image_height": 48, "K": [20, 0, 31, 0, 20, 23, 0, 0, 1]}
CALIBRATIONS = [
    endoscope("photometry.gama", 2.0, "did you mean gamma"),
    endoscope("albdo", 0.5, "albdo is unknown"),
    endoscope("endolab", 2, "endolab"),
    endoscope("camera.f", 100.0, "camera.f"),
    endoscope("camera.fx", ..., "camera.fx"),
    endoscope("camera.fx", -1.0, "fx"),
    endoscope("camera.model", "fisheye", "kannala_brandt"),
    endoscope("photometry.gamma", float("nan"), "photometry.gamma"),
    endoscope("photometry.k", 10**400, "photometry.k"),
    endoscope("camera.width", 64.5, "camera.width"),
    endoscope("photometry.brdf", {"model": "phong"}, "photometry.brdf"),
    endoscope("photometry.brdf.albedo", [0.5, 0.5], "albedo"),
    endoscope("photometry.lights", [{"pos": [0, 0, 0]}], "pos"),
    Row("papr", (f"{PAPR} --out o", lambda: el.load_calibration("papr")), "paper"),
    calibration("deep.json", "[" * 100_000, "deep.json"),
    calibration("list.json", "[]", "list.json"),
    calibration("matlab.json", {"RadialDistortion": [0.1], "K": [[300]]}, "COLMAP"),
    calibration("matlab.mat", "MATLAB 5.0 MAT-file\0\1\2", "bring_your_own"),
    calibration("ocam.txt", "5 -206.5 0 2.2e-03\n1 294.18\n480 752\n", "COLMAP"),
    calibration("latin.json", b'{"endolab": "\xe9"}', "latin.json"),
    calibration("half.json", half("endoscope.json"), "half.json"),
    calibration("wide.json", OPENCV | {"image_width": 10**400}, "wide.json"),
    calibration("binned.json", OPENCV | {"binning_x": 2}, "binning"),
    calibration("cut.json", OPENCV | {"roi": {"x_offset": 8}}, "roi"),
    calibration("lens.json", OPENCV | {"lensNumbers": [0.1] * 4}, "lensNumbers"),
    calibration("radial.json", OPENCV | {"lens": {"k1": 0.1}}, "lens.k1"),
    calibration("kc.json", OPENCV | {"kc": [0.1] * 4}, "fisheye"),
    calibration("shape.json", {"K": OPENCV["K"], "shape": [48, 64]}, "shape"),
    calibration("prism.json", OPENCV | {"D": [0.1] * 12}, "PRISM"),
    calibration("skew.json", OPENCV | {"K": [20, 1, 31, 0, 20, 23, 0, 0, 1]}, "skew"),
    calibration("zeros.json", OPENCV | {"K": [0] * 9}, "never calibrated"),
    calibration(
        "parts.json", OPENCV | {"K": [0.5, 0, 0.5, 0, 0.5, 0.5, 0, 0, 1]}, "norm"
    ),
    calibration("off.json", OPENCV | {"K": [20, 0, 70, 0, 20, 23, 0, 0, 1]}, "outside"),
    calibration(
        "ds.yaml",
        "cam0: {camera_model: ds, intrinsics: [1, 1, 1, 1, 1, 1]}\n",
        "pinhole-equi",
    ),
    calibration(
        "meta.xml", "<calibration><projection>f</projection></calibration>", "OpenCV"
    ),
    calibration("cameras.bin", bytes(64), "model_converter"),
    calibration("ost.txt", "# oST\n[image]\nwidth\n64\n", "camera_calibration_parsers"),
    calibration("other.yaml", "a: 1\nb: [2, 3]\n", "Kalibr"),
    calibration("code.yaml", "cam0: !!python/object/apply:os.system [a]\n", "YAML"),
    calibration("bomb.xml", '<!DOCTYPE r [<!ENTITY a "a">]><r>&a;</r>', "bomb.xml"),
    Row("size", lambda: el.Pinhole(0, 24, 20, 20, 15, 11), "width"),
    Row("gain", lambda: el.Photometry(gain=0.0), "gain"),
    Row("brdf", lambda: el.TabulatedBRDF((1.0, 0.0), (1.0, 1.0)), "theta"),
    Row("lamp", lambda: el.SpotLight(direction=(0.0, 0.0, 0.0)), "direction"),
    Row(
        "no Frame",
        lambda: el.reconstruct("a.png", el.load_calibration("c3vd")),
        "frame",
    ),
    Row(
        "no Calibration",
        lambda: el.reconstruct(el.Frame(ONES, ONES > 0), "c3vd"),
        "cal",
    ),
]
SETTINGS = [
    settings({}, "endolab_settings"),
    settings({"endolab_settings": 1, "lamb": 1}, "lamb"),
    settings({"endolab_settings": 1, "contours": "yes"}, "contours"),
    settings({"endolab_settings": 1, "known_distance": [1, 2]}, "known_distance"),
    settings({"endolab_settings": 1, "photometry": {"gamma": "2"}}, "gamma"),
    settings({"endolab_settings": 1, "held": "none.npz"}, "held"),
    settings(
        {"endolab_settings": 1, "solver_options": {"tolerance": 1}}, "solver_options"
    ),
]
TARGETS = [
    target("endolab_target", 2),
    target("kind", "squares"),
    target("spacing", -1),
    target("colour", "red"),
    Row("Kalibr's", "target board.yaml --out t.pdf", "chessboard:9x7:3mm"),
    Row("marker", lambda: Charuco(11, 8, 15.0, marker=15.0), "marker"),
    Row("small", lambda: DotGrid(5, 4, 6.0, small=2.0, large=1.0), "small"),
]
TYPED = {
    "frobnicate": "frobnicate",
    f"{FRAME} --bogus": "--bogus",
    f"{FRAME} --every 2": "every",
    f"{FILM} --every 0": "--every",
    f"{FILM} --limit 0": "--limit",
    f"{FRAME} --settings none.json": "none.json",
    f"reconstruct frame.png {KNOWN} --out mine.txt": "mine.txt",
    f"reconstruct frame.png {KNOWN} --out theirs": "--overwrite",
    f"reconstruct frame.png {KNOWN}": "--out",
    "reconstruct frame.png --crop 0,0,9,9 --out o": "--calibration",
    "reconstruct frame.png --fov 999 --out o": "999",
    f"reconstruct frame.png {KNOWN} --fov 140 --out o": "--fov",
    f"reconstruct frame.png {KNOWN} --crop 0,0,9 --out o": "WIDTH,HEIGHT, got 0,0,9",
    f"reconstruct frame.png {KNOWN} --crop 0,0,9,999 --out o": "9,999",
    f"reconstruct double.png {KNOWN} --crop 0,0,32,24 --out o": "cut the picture",
    f"reconstruct none.png {KNOWN} --out o": "none.png",
    "reconstruct half.png --out o": "half.png: not a whole picture",
    "reconstruct phone.heic --out o": "HEIC",
    "reconstruct telephone --out o": "HEIC",
    f"reconstruct telephone {KNOWN} --out o": "HEIC",
    "sweep phone.heic": "HEIC",
    f"tune phone.heic {KNOWN}": "HEIC",
    "tune phone.heic": "HEIC",
    f"reconstruct mine.mp4 {KNOWN} --out o": "mine.mp4",
    f"reconstruct empty {KNOWN} --out o": "empty",
    f"reconstruct film frame.png {KNOWN} --out o": "frame.png",
    f"reconstruct film {KNOWN} --out o --mesh": "--mesh",
    f"sweep frame.png {KNOWN} --out endoscope.json": "endoscope.json",
    f"sweep frame.png {KNOWN} --lam a,b": "lam",
    f"sweep frame.png {KNOWN} --jobs 0": "n_jobs",
    f"sweep small.png {KNOWN} --recording o.rrd": "small.png",
    f"sweep frame.png film/frame.png {KNOWN} --recording o.rrd": "one frame",
    f"sweep frame.png {KNOWN} --out empty": "empty",
    f"sweep frame.png {KNOWN} --out frame.png --overwrite": "frame.png is read",
    f"reconstruct overview.png {KNOWN} --out . --overwrite": "overview.png is read",
    "convert endoscope.json --out endoscope.json --overwrite": "endoscope.json is read",
    "convert endoscope.json --size 96 --out o": "COLUMNSxROWS",
    "simulate coln --out o": "colon",
    "simulate plane --frames 3 --out o": "--frames",
    "simulate sheet --frames 0 --out o": "--frames",
    "simulate sheet --highlights .1 --out o": "--highlights",
    "simulate plane --calibration endoscope.json --out . --overwrite": "endoscope.json",
    "simulate plane --noise -1 --out o": "noise",
    "simulate plane --lamp 4 --out o": "X,Y",
    "simulate sheet --lamp -60,0 --out o": "50 mm",
    "target chessbord --out t.pdf": "chessboard",
    "target chessboard:14x9 --out t.pdf": "add :SIZEmm",
    "target charuco:9x6:5mm:6mm:4X4_50 --out t.pdf": "marker",
    "target chessboard --out sheet.png": "sheet.png",
    "target chessboard --out mine.pdf": "--overwrite",
    f"calibrate film {SHEET} c.json": "none of 1",
    f"calibrate broken {SHEET} c.json": "not a whole picture",
    f"calibrate film {SHEET} c.json --gamma two": "gamma",
    f"calibrate film {SHEET} c.json --lamps three": "three",
    f"calibrate film {SHEET} mine.json": "--overwrite",
    "calibrate-light film --camera endoscope.json --gamma -1 --out c.json": "gamma",
    "calibrate-light film --camera endoscope.json --out none/c.json": "none",
    f"tune small.png {KNOWN}": "32x32",
    f"tune frame.png {KNOWN} --width 0 --html o.html": "--width",
    "lab --notebooks none": "none",
    "lab --port 70000": "port",
    "evaluate frame.png truth.npz": "frame.png",
    "evaluate square.npy truth.npz": "48x48",
    "evaluate two.npz truth.npz": "two.npz",
    "evaluate z.npy truth.npz --align none": "unit",
    "evaluate z.npy truth.npz --max-angle 0.001": "no pixel",
    "evaluate z.npy z.npy --max-angle 20": "calibration",
    "evaluate z.npy film": "film",
    "evaluate z.npy metres.npy": "--truth-unit",
    "evaluate metres.npy truth.npz --unit 1": "--unit",
    "evaluate film truth.npz": "truth.npz",
}
CALLED = [
    Row("evaluate", lambda: el.evaluate("half.npz", "truth.npz"), "half.npz"),
    Row("compare", lambda: el.metrics.compare(ONES, ONES[1:], ONES), "truth"),
    Row("align", lambda: el.metrics.compare(*[ONES] * 3, align="median"), "scale"),
    Row("coverage", lambda: el.metrics.coverage_of(ONES, ONES[1:], ONES), "sigma"),
    Row("prepare", lambda: el.prepare(el.Frame(ONES / 2, ONES > 0)), "Result"),
    Row("show_surface", lambda: el.show_surface("run.rrd"), "result"),
    Row("read_recording", lambda: el.read_recording("run.rrd"), "run.rrd"),
    Row("found", lambda: el.load_found("two.npz"), "two.npz"),
    Row("held", lambda: solve(held=1), "held"),
    Row("record", lambda: el.record("run.txt"), "run.txt"),
    Row("tune", lambda: el.tune("a.png", el.load_calibration("c3vd")), "frame"),
    Row("no folder", lambda: el.open_dataset("none"), "none"),
    Row("no data set", lambda: el.open_dataset("empty"), "C3VD"),
    Row("no unit", lambda: el.datasets.true_z("0001_depth.png"), "unit"),
    Row("lossy", lambda: write_video("v.mp4", []), "mp4"),
    Row("outside", lambda: Tube(10.0, offset=(8.0, 8.0)), "inside"),
    Row("threads", lambda: limit_threads(0).__enter__(), "threads"),
    Row("limit", lambda: film(limit=0), "limit"),
    Row("every", lambda: film(every=0), "every"),
    Row("one lam", lambda: sweep(lam=1.0), "lam must be a list"),
    Row("no lam", lambda: sweep(lam=[]), "lam must be a list"),
    Row("one xi", lambda: sweep(xi="1/d"), "xi must be a list"),
    Row("one order", lambda: sweep(regulariser="first"), "regulariser must be a list"),
    Row("one path", lambda: sweep("frame.png"), "frames must be a list"),
    Row("jobs", lambda: sweep(n_jobs=0), "n_jobs"),
    Row("sheets", lambda: trajectory(el.TARGETS["vicalib_small"], None, 0), "count"),
]
ANEW = {"width": 48, "channel": "red", "contours": True, "highlights": "keep"}
ANEW |= {"smooth": 1.0, "cuts": np.zeros((2, 48, 64), bool)}
CALLED += [
    Row(f"found {name}", partial(solve_found, **{name: value}), f"{name} belongs")
    for name, value in ANEW.items()
]
ROWS = [*OPTIONS, *PICTURES, *CALIBRATIONS, *SETTINGS, *TARGETS, *CALLED]
ROWS += [Row(words, words, word) for words, word in TYPED.items()]
FILES |= {
    "half.npz": half("truth.npz"),
    "square.npy": ONES[:, :48],
    "z.npy": 20 * ONES,
    "metres.npy": ONES / 50,
    "board.yaml": "target_type: checkerboard\ntargetCols: 8\ntargetRows: 6\n"
    "rowSpacingMeters: 0.003\n",
    "two.npz": {"a": ONES, "b": ONES},
    "0001_depth.png": np.zeros((48, 64), np.uint16),
    "run.rrd": b"hello" * 99,
    "broken/1.png": b"no picture",
    "telephone/1.heic": FILES["phone.heic"],
    "double.png": np.add.outer(np.arange(96), np.arange(128)),
} | {f"mine.{suffix}": b"mine" * 99 for suffix in ("txt", "mp4", "pdf")}
FILES |= dict.fromkeys(("mine.json", "theirs/report.json"), '{"mine": 1}')
FILES |= dict.fromkeys(
    ("film/frame.png", "overview.png"), lambda: Path("frame.png").read_bytes()
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A simulated frame with its truth, and the files of the rows."""
    folder = tmp_path_factory.mktemp("wrong")
    with contextlib.chdir(folder):
        words = "simulate curved --calibration simple --width 64 --out ."
        assert main(words.split()) == 0
        Path("empty").mkdir()
        for name, content in FILES.items():
            content = content() if callable(content) else content
            Path(name).parent.mkdir(exist_ok=True)
            match content, Path(name).suffix:
                case np.ndarray(), ".npy":
                    np.save(name, content)
                case np.ndarray(), _:
                    assert cv2.imwrite(name, content)
                case dict(), ".npz":
                    np.savez(name, **content)
                case dict(), _:
                    Path(name).write_text(json.dumps(content))
                case str(), _:
                    Path(name).write_text(content)
                case _:
                    Path(name).write_bytes(content)
    return folder


def contents(folder):
    return {path: path.is_file() and path.read_bytes() for path in folder.rglob("*")}


@pytest.mark.parametrize("row", ROWS, ids=lambda row: row.name)
def test_what_is_wrong_is_one_sentence(row, folder, tmp_path, monkeypatch, capfd):
    here = shutil.copytree(folder, tmp_path / "here")
    monkeypatch.chdir(here)
    before = contents(here)
    for call in row.call if isinstance(row.call, tuple) else (row.call,):
        capfd.readouterr()
        if callable(call):
            with pytest.raises((ValueError, OSError, TypeError)) as caught:
                call()
            sentence = str(caught.value)
        else:
            try:
                code = main(call.split())
            except SystemExit as end:
                code = end.code
            out, sentence = capfd.readouterr()
            assert (code, out) == (2, "")
            sentence = re.sub(r"^Compiling [^\n]*\n", "", sentence)  # in a first run
            assert sentence.startswith("endolab: ")
            sentence = sentence.removesuffix("\n")
        assert row.word in sentence
        assert "\n" not in sentence
        assert "Input should" not in sentence  # pydantic's English
        assert len(sentence) < 700
    assert contents(here) == before

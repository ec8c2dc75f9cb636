"""Classes of cases: odd options, odd names of files, odd arguments in Python, odd uploads into the tuner."""

import contextlib
import os
from pathlib import Path

import numpy as np

from tests.hostile import damage, given
from tests.hostile.case import call, command
from tests.hostile.damage import pick
from tests.hostile.damaged_files import QUICK, _bad_picture

LARGE = ("1000000", "100000", "99999999999")  # what would take the machine's memory, or a day

# Options ----------------------------------------------------------------------------------------
SOLVING = {
    "--solver": ["facing", "fast_marching", "gauss_newton", "primal_dual"],
    "--xi": ["1/z", "d", "1/d"],
    "--regulariser": ["first", "second", "curvature"],
    "--lam": ["0.1", "1", "1e-9", "1e9"],
    "--channel": ["red", "green", "blue", "grey"],
    "--albedo": ["0.5", "0.7,0.4,0.3", "1"],
    "--contours": ["auto", "yes", "no"],
    "--highlights": ["keep", "ignore", "inpaint"],
    "--median-distance": ["40", "1e-6", "1e6"],
    "--width": ["16", "24", "32", "1", *LARGE],
    "--smooth": ["0", "1", "50", *LARGE],
}
COMMANDS = {
    "sweep": (
        ("sweep", "frame.png", "--calibration", "endoscope.json", "--out", "out.csv"),
        {
            **SOLVING,
            "--lam": ["0.1,1", "1"],
            "--jobs": ["1", "0", "-2"],
            "--backend": ["threading", "sequential", "x"],
        },
        ("out.csv",),
    ),
    "reconstruct": (
        ("reconstruct", "frame.png", "--calibration", "endoscope.json", "--out", "out"),
        {
            **SOLVING,
            "--known-distance": ["30,10,12", "30,-1,5", "30,99,99", "0,10,12"],
            "--known-diameter": ["8,5,9,25,9", "8,5,9,5,9", "8,5,9"],
            "--mask": ["mask.png", "frame.png", "nothing.png", "endoscope.json"],
            "--snapshots": ["0", "1", "5", "-1"],
            "--every": ["1"],
            "--limit": ["1"],
        },
        ("out",),
    ),
    "video": (
        ("reconstruct", "pictures", "--calibration", "cal.json", "--out", "out"),
        {
            **SOLVING,
            "--every": ["1", "2", "9", *LARGE],
            "--limit": ["1", "2", *LARGE],
            "--mask": ["mask.png", "sheet"],
        },
        ("out",),
    ),
    "simulate": (
        ("simulate", "tube", "--calibration", "cal.json", "--out", "out", "--width", "24"),
        {
            "--width": ["16", "24", "15", *LARGE],
            "--noise": ["0", "3", "1e9"],
            "--bits": ["8", "16", "1"],
            "--texture": ["0.1", "50"],
            "--fog": ["0.01", "1e9"],
            "--highlights": ["0.1", "1", "2"],
            "--seed": ["0", "-1", *LARGE],
            "--calibration": ["paper", "simple", "c3vd", "simcol3d", "frame.png", "pictures"],
        },
        ("out",),
    ),
    "sheet": (
        ("simulate", "sheet", "--calibration", "cal.json", "--out", "out", "--width", "48", "--frames", "1"),
        {
            "--target": ["vicalib_big", "vicalib_folded", "charuco", "circles", "chessboard", "pig"],
            "--frames": ["1", "2", "0", "-1"],
            "--fold": ["0", "20", "89", "91", "180", "1e9"],
            "--outliers": ["0.1", "1", "2", "-1"],
            "--motion": ["1", "50", "-1", *LARGE],
            "--noise": ["0", "3", "1e9"],
        },
        ("out",),
    ),
    "calibrate": (
        ("calibrate", "sheet", "--target", "vicalib_small", "--out", "new.json"),
        {
            "--target": ["vicalib_big", "charuco", "pig", "endoscope.json"],
            "--every": ["1", "0", "-1", *LARGE],
            "--channel": ["grey", "red"],
            "--gamma": ["2.2", "free", "2.2,0.1", "0", "-1", "2.2,0", "1,2,3"],
            "--brdf": ["tabulated", "lambertian"],
            "--gain": ["free", "locked"],
            "--light": ["centred", "free"],
            "--reflectance": ["0.5", "free", "0.5,0.02"],
            "--camera": ["cal.json", "endoscope.json", "frame.png"],
        },
        ("new.json",),
    ),
    "evaluate": (
        ("evaluate", "depth.npz", "truth.npz"),
        {"--scale": ["none", "median"], "--max-angle": ["40", "0", "-1", "360", "90"]},
        (),
    ),
    "target": (
        ("target", "vicalib_small", "--out", "sheet.svg"),
        {"--out": ["sheet.svg", "sheet.svg.svg"]},
        (),
    ),
    "convert": (
        ("convert", "geometry.xml", "photometry.xml", "--out", "new.json"),
        {"--out": ["new.json"]},
        (),
    ),
}
FILES = (
    *("endoscope.json", "cal.json", "frame.png", "mask.png", "depth.npz", "truth.npz"),
    "geometry.xml",
    "photometry.xml",
)
FOLDERS = ("pictures", "sheet")


def options(rng, good):
    """A command with odd, repeated, abbreviated and contradicting options."""
    # Those that draw or search take most of a second where they are accepted.
    often = ["sweep"] * 6 + ["simulate"] * 4 + ["sheet"] * 3 + ["video"] * 4 + ["evaluate"] * 3
    name = pick(rng, [*often, "reconstruct", "reconstruct", "calibrate", "target", "convert"])
    base, choices, new = COMMANDS[name]
    good.take(*FILES, *FOLDERS)
    argv = list(base)
    if "--solver" in choices and rng.random() < 0.7:
        argv += QUICK
    for _ in range(int(rng.integers(1, 4))):
        option = pick(rng, list(choices))
        if option == "--out" and rng.random() < 0.9:
            continue
        usual = rng.random() < 0.6
        value = (
            pick(rng, choices[option])
            if usual
            else pick(rng, [text for text in damage.TEXTS if "\x00" not in text])
        )
        if option in ("--out", "--backend") and not usual:
            continue  # a name of a file, which is its own class; a backend may be installed by anyone
        argv += pick(
            rng,
            [[option, value], [f"{option}={value}"], [option[: max(4, len(option) - 2)], value], [option]],
        )
    return command(*argv, kept=_may_be_written(argv, new))


def _may_be_written(argv, new):
    """Whatever the last --out says, and what goes with it: a class of its own looks at names."""
    del argv
    return (*new, "sheet.svg", "sheet.svg.svg", "new.json", "new_report")


# Names of files -----------------------------------------------------------------------------------
NAMES = [
    *(
        "",
        ".",
        "..",
        "/",
        "nothing",
        "nothing.json",
        "nothing.png",
        "nothing.npz",
        "nothing.mkv",
        "no/such/thing.png",
    ),
    *(
        "/dev/null",
        "/dev/zero",
        "/dev/full",
        "/dev/stdin",
        "/proc/self/mem",
        "/proc/self/environ",
        "/dev/tty",
    ),
    *(
        "pipe",
        "pipe.png",
        "pipe.json",
        "pipe.npz",
        "pipe.mkv",
        "loop",
        "loop.png",
        "loop.json",
        "folder.png",
        "folder.json",
    ),
    *(
        "folder.npz",
        "folder.csv",
        "folder.xml",
        "folder.mkv",
        "dangling.png",
        "dangling.json",
        "dangling.csv",
        "cal.json",
    ),
    *(
        "frame.png",
        "frame.png/x",
        "a\nb.png",
        "\udcff.png",
        "é😀.png",
        "-x.png",
        "--out",
        "%s.png",
        "{0}.json",
    ),
    *(
        "y" * 300 + ".png",
        ("z" * 200 + "/") * 30 + "x.json",
        " ",
        "paper",
        "vicalib_small",
        "pictures",
        "sheet",
        "empty.png",
        "empty.json",
    ),
    *("empty.npz", "empty.csv", "empty.mkv", "empty.xml", "~", "$HOME", "*", "frame.png "),
]


def paths(rng, good):
    """A command one or two of whose files are something else: a folder, a device, a pipe, a loop, nothing."""
    good.take(*FILES, *FOLDERS, "table.csv")
    for kind in ("png", "json", "npz", "csv", "xml", "mkv"):
        Path(f"empty.{kind}").touch()
        Path(f"folder.{kind}").mkdir()
        with contextlib.suppress(OSError):
            os.mkfifo(f"pipe.{kind}")
            os.symlink(f"loop.{kind}", f"loop.{kind}")
            os.symlink(f"nothing.{kind}", f"dangling.{kind}")
    os.mkfifo("pipe"), os.symlink("loop", "loop")
    argv = pick(
        rng,
        [
            [
                "reconstruct",
                "frame.png",
                "--calibration",
                "endoscope.json",
                *QUICK,
                "--out",
                "out",
                "--mask",
                "mask.png",
            ],
            [
                "reconstruct",
                "pictures",
                "--calibration",
                "cal.json",
                *QUICK,
                "--out",
                "out",
                "--mask",
                "mask.png",
            ],
            [
                "sweep",
                "frame.png",
                "--calibration",
                "endoscope.json",
                *QUICK,
                "--out",
                "out.csv",
                "--truth",
                "truth.npz",
            ],
            ["simulate", "tube", "--calibration", "cal.json", "--width", "24", "--out", "out"],
            ["evaluate", "depth.npz", "truth.npz"],
            ["convert", "geometry.xml", "photometry.xml", "--out", "out.json"],
            ["target", "vicalib_small", "--out", "out.svg"],
            ["calibrate", "sheet", "--target", "vicalib_small", "--out", "out.json", "--camera", "cal.json"],
        ],
    )
    commands = [
        place for place, word in enumerate(argv) if "." in word or word in (*FOLDERS, "out", "vicalib_small")
    ]
    at = pick(rng, commands)
    writes = argv[at - 1] == "--out"
    # A name that a user may have meant for a new file or folder is not odd, and takes long.
    plain = (
        "nothing",
        "/dev",
        "/proc",
        "empty",
        "dangling",
        "paper",
        "frame.png",
        "pictures",
        "sheet",
        "cal.json",
    )
    names = [name for name in NAMES if not (writes and name.startswith(plain))]
    odd = pick(rng, names)
    argv[at] = odd
    if rng.random() < 0.15:
        other = pick(rng, [place for place in commands if argv[place - 1] != "--out"])
        argv[other] = pick(rng, names)
    kept = [
        *("out", "out.csv", "out.json", "out_report", "out_detections.jsonl", "out.svg"),
        *([odd] if writes and odd not in ("", ".", "/") else []),
    ]
    return command(*argv, kept=tuple(kept), any=(odd,))


# Python -------------------------------------------------------------------------------------------
ARRAYS = [
    np.array([]),
    np.array(np.nan),
    np.zeros((2, 2)),
    np.array(["a"]),
    np.array([None, 1]),
    np.full(3, np.inf),
]


def _odd_value(rng, usual):
    """What a caller may give by mistake instead of a usual value, and whether it is of another kind."""
    if rng.random() < 0.1:
        return pick(rng, [*damage.VALUES, *ARRAYS, b"x", {1, 2}, object(), 1j, range(3)]), True
    if isinstance(usual, np.ndarray):
        return damage.odd_array(rng, usual), False
    if isinstance(usual, bool):
        return not usual, False
    if isinstance(usual, int | float):
        number = damage.number_near(rng, usual)
        return pick(rng, [number, number, np.array(number), True, float(np.float32(1.5)), np.int64(3)]), False
    if isinstance(usual, str):
        return pick(rng, damage.TEXTS), False
    if isinstance(usual, tuple) and usual and isinstance(usual[0], float):
        values = [damage.number_near(rng, value) if rng.random() < 0.4 else value for value in usual]
        return pick(
            rng, [tuple(values), tuple(values[1:]), tuple(values * 2), np.array(values, object), values]
        ), False
    return None, False


def calls(rng, good):
    """A function of the public face, an argument or two of which are odd."""
    import endolab as el
    from endolab.metrics.depth_errors import compare

    known = el.load_calibration(str(good.folder / "endoscope.json"))
    scene = el.render(el.SCENES["colon"], known.camera, known.photometry)
    frame, light, camera = el.Frame(scene.image, scene.mask), known.photometry, known.camera
    cos_alpha = scene.z / scene.distance
    kannala = {name: getattr(camera, name) for name in ("width", "height", "fx", "fy", "cx", "cy", "k")}
    solving = {
        "solver": "facing",
        "xi": "d",
        "regulariser": "first",
        "lam": 1.0,
        "channel": "red",
        "width": 16,
    }
    solving |= {"smooth": 1.0, "highlights": "keep", "contours": False, "epsilon": 1e-3, "threshold": 0.1}
    scaling = [{"median_distance": 40.0}, {"known_distance": (30.0, 16.0, 12.0)}, {"max_iterations": 3}, {}]
    rendering = {"noise": 1.0, "bits": 8, "texture": 0.1, "fog": 0.01, "highlights": 0.1, "seed": 0}
    of_frame = {"frame": frame, "calibration": known}
    table = [
        ("Frame", el.Frame, {"image": scene.image, "mask": scene.mask, "name": "frame"}),
        ("Frame", el.Frame, {"image": scene.image, "mask": scene.mask, "silent": ~scene.mask}),
        ("Pinhole", el.Pinhole, {"width": 32, "height": 24, "fx": 16.0, "fy": 16.0, "cx": 15.5, "cy": 11.5}),
        ("KannalaBrandt", el.KannalaBrandt, kannala),
        ("Photometry", el.Photometry, {"k": 2.5, "gamma": 2.2, "gain": 1.0}),
        ("Lambertian", el.Lambertian, {"albedo": 0.5}),
        ("Lambertian", el.Lambertian, {"albedo": (0.5, 0.4, 0.3)}),
        ("TabulatedBRDF", el.TabulatedBRDF, {"theta": (0.0, 0.5, 1.5), "values": (0.3, 0.2, 0.1)}),
        (
            "SpotLight",
            el.SpotLight,
            {"position": (3.0, 0.0, 0.0), "direction": (0.0, 0.0, 1.0), "exponent": 1.0, "weight": 1.0},
        ),
        *[("reconstruct", el.reconstruct, of_frame | solving | pick(rng, scaling))] * 4,
        ("reconstruct", el.reconstruct, of_frame | solving | {"solver": "gauss_newton"}),
        (
            "render",
            el.render,
            {"scene": el.SCENES["tube"], "camera": camera, "photometry": light} | rendering,
        ),
        ("prepare", el.prepare, of_frame | {"highlights": "keep"}),
        (
            "compare",
            compare,
            {"distance": scene.distance, "truth": scene.distance, "cos_alpha": cos_alpha, "scale": "none"},
        ),
        ("load_calibration", el.load_calibration, {"name_or_path": "paper", "width": 32}),
        ("resize", known.resize, {"width": 16, "height": 12}),
        (
            "tune",
            lambda **how: el.tune(**how).close(),
            of_frame | {"truth": scene.distance, "scene": "colon"},
        ),
        (
            "calibrate_light",
            _calibrate_light,
            {"gamma": 2.2, "brdf": "tabulated", "gain": "free", "light": "centred"},
        ),
        ("open_frames", lambda path: el.open_frames(path), {"path": "pictures"}),
        ("read_frame", el.read_frame, {"path": "frame.png", "calibration": known}),
        (
            "sweep",
            el.sweep,
            {"frames": [frame], "calibration": known, "lam": (1.0,), "solver": "facing", "table": "t.csv"},
        ),
        (
            "record",
            lambda **how: el.record(**how).close(),
            {"path": "r.rrd", "max_width": 480, "live": False},
        ),
    ]
    name, function, usual = pick(rng, table)
    keys = [key for key, value in usual.items() if isinstance(value, str | int | float | tuple | np.ndarray)]
    odd, other_kind = {}, False
    for key in rng.choice(keys, size=min(len(keys), int(rng.integers(1, 3))), replace=False):
        odd[str(key)], another = _odd_value(rng, usual[key])
        other_kind |= another
    told = f"{name}({', '.join(f'{key}={_short(value)}' for key, value in odd.items())})"
    # A name of a file may be any text; a live recording opens a viewer.
    if odd.get("live") or any(key in odd for key in ("path", "table", "name_or_path")):
        odd = {
            key: value for key, value in odd.items() if key not in ("live", "path", "table", "name_or_path")
        }
    return call(told, lambda: _checked(function(**(usual | odd))), kept=("t.csv", "r.rrd"), loose=other_kind)


def _short(value):
    large = (isinstance(value, np.ndarray) and value.size > 9) or (
        isinstance(value, int) and abs(value) > 1e99
    )
    try:
        text = type(value).__name__ if large else repr(value)
    except ValueError:  # a whole number of thousands of digits is in it
        text = "something long"
    return text if len(text) < 80 else f"{text[:60]}… ({type(value).__name__})"


def _calibrate_light(**how):
    import endolab as el
    from tests.tools.simulated_session import simulated

    return el.calibrate_light(simulated()[0].samples, **how)


def _checked(result):
    """A result is finite and positive where it says that it is one."""
    for name in ("distance", "z"):
        values, mask = getattr(result, name, None), getattr(result, "mask", None)
        if (
            isinstance(values, np.ndarray)
            and isinstance(mask, np.ndarray)
            and not np.isfinite(values[mask]).all()
        ):
            raise ZeroDivisionError(f"{name} of a result is none")


# The tuner ----------------------------------------------------------------------------------------
def tuner(rng, good):
    """Uploads into the tuner: what cannot be used is said in its line, and it goes on."""
    files = {}
    for _ in range(int(rng.integers(1, 4))):
        if rng.random() < 0.5:
            name = "bad" + pick(rng, [".png", ".jpg", ".tif", ".JSON", "", ".exe"])
            files[name] = _bad_picture(rng, good, pick(rng, given.PICTURES))
        else:
            name = pick(
                rng,
                ["cal.json", "../../up.json", "/etc/x.json", "", ".", "..", "y" * 300 + ".png", "a/b.png"],
            )
            files[name] = damage.damaged_bytes(rng, good.read("endoscope.json"))
    if rng.random() < 0.3:
        files["frame.png"], files["endoscope.json"] = good.read("frame.png"), good.read("endoscope.json")

    def work():
        import endolab as el

        box = el.tune(scene="plane", width=32)
        try:
            before = box.engine.wait(30)
            entries = [{"name": name, "content": memoryview(content)} for name, content in files.items()]
            box._guarded(lambda: box.take({entry["name"]: bytes(entry["content"]) for entry in entries}))()
            line = box.status.value
            inward = [word for word in ("Errno", "Traceback", "object has", "/tmp") if word in line]
            if inward or len(line) > 600:
                raise ZeroDivisionError(f"the status line says {line[:300]}")
            box.knobs["lam"].value = 0.5
            outcome = box.engine.wait(30)
            if outcome.serial == before.serial or (outcome.result is None and not outcome.error):
                raise ZeroDivisionError("the tuner does not answer any more")
        finally:
            box.close()

    return call(f"tuner.take({ {name: len(content) for name, content in files.items()} })", work, status=0)


# What was there before ----------------------------------------------------------------------------
WRITING = (
    (
        ("reconstruct", "frame.png", "--calibration", "endoscope.json", *QUICK, "--out", "out"),
        ("out/depth.npz", "out/cloud.ply", "out/report.json", "out/overview.png", "out/recording.rrd", "out"),
    ),
    (
        ("reconstruct", "pictures", "--calibration", "cal.json", *QUICK, "--out", "out"),
        ("out/report.json", "out/frames.csv", "out/frames/000/depth.npz", "out/frames", "out/recording.rrd"),
    ),
    (
        ("simulate", "tube", "--calibration", "cal.json", "--width", "24", "--out", "out"),
        ("out/frame.png", "out/truth.npz", "out/endoscope.json", "out"),
    ),
    (
        ("simulate", "sheet", "--calibration", "cal.json", "--width", "48", "--frames", "1", "--out", "out"),
        ("out/000000.png", "out/truth.json"),
    ),
    (("sweep", "frame.png", "--calibration", "endoscope.json", *QUICK, "--out", "out.csv"), ("out.csv",)),
    (("target", "vicalib_small", "--out", "out.svg"), ("out.svg",)),
    (("convert", "geometry.xml", "photometry.xml", "--out", "out.json"), ("out.json",)),
    (
        ("calibrate", "sheet", "--target", "vicalib_small", "--out", "out.json"),
        ("out.json", "out_report/report.json", "out_detections.jsonl", "out_report/camera.json"),
    ),
)


def yours(rng, good):
    """A command whose results have the names of a user's files, which stay; and the user's umask."""
    words, names = pick(rng, WRITING)
    name, how = (
        Path(pick(rng, names)),
        pick(rng, ["text", "text", "empty", "link", "other", "folder", "nothing"]),
    )
    good.take(*FILES, *FOLDERS)
    name.parent.mkdir(parents=True, exist_ok=True)
    Path("mine.txt").write_text("mine")
    if how == "folder":
        name.mkdir()
        (name / "mine.txt").write_text("mine")
    elif how == "link":
        name.symlink_to(Path("mine.txt").resolve())
    elif how == "other":  # of the same kind, and not endolab's
        name.write_text(
            {".json": '{"my": "list"}', ".csv": "a,b\n1,2\n", ".jsonl": "{}\n"}.get(name.suffix, "mine")
        )
    elif how != "nothing":
        name.write_text("" if how == "empty" else "mine")
    safe = ("mine.txt",) if how == "nothing" else ("mine.txt", str(name), f"{name}/mine.txt")
    case = command(
        *words,
        kept=("out", "out.csv", "out.svg", "out.json", "out_report", "out_detections.jsonl"),
        safe=safe,
    )
    there = {path for path in Path().rglob("*") if path.is_file()}

    def run():
        before = os.umask(0o027)
        try:
            status = case.run()
        finally:
            os.umask(before)
        for path in Path().rglob("*"):
            if path.is_file() and path not in there and path.stat().st_mode & 0o777 != 0o640:
                raise ZeroDivisionError(
                    f"{path} has the mode {path.stat().st_mode & 0o777:o} where umask says 640"
                )
        return status

    return case.but(run=run)

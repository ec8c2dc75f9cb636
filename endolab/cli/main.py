"""The command line: python -m endolab reconstruct, sweep, calibrate, target, simulate, evaluate, lab."""

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import NoReturn

from endolab._deprecated import callable_as_before
from endolab._extras import MissingPackage
from endolab.cli.calibrate import SHEET, add_calibration_commands, add_sheet_options, simulate_sheet
from endolab.cli.reconstruct import add_reconstruct_commands


def _simulate(arguments: argparse.Namespace) -> None:
    import numpy as np

    from endolab.datasets.known_endoscopes import load_calibration
    from endolab.io.atomic import staged_folder
    from endolab.io.images import write_image
    from endolab.io.surfaces import save_depth
    from endolab.synthetic.rendering import render
    from endolab.synthetic.scenes import SCENES

    if arguments.scene not in (*SCENES, SHEET):
        raise ValueError(f"unknown scene {arguments.scene!r}; choose {', '.join(SCENES)} or {SHEET}")
    calibration = load_calibration(arguments.calibration)
    if arguments.width is not None:
        if arguments.width < 16:
            raise ValueError(f"--width must be at least 16 px, got {arguments.width}")
        height = calibration.camera.height * arguments.width / calibration.camera.width
        calibration = calibration.resize(arguments.width, max(1, round(height)))
    if arguments.scene == SHEET:
        simulate_sheet(arguments, calibration)
        return
    names = ("noise", "bits", "texture", "fog", "highlights", "seed")
    how = {name: getattr(arguments, name) for name in names}
    rendered = render(SCENES[arguments.scene], calibration.camera, calibration.photometry, **how)
    with staged_folder(arguments.out) as folder:
        write_image(folder / "frame.png", rendered.image, arguments.bits)
        replace(calibration, photometry=rendered.photometry).save(folder / "endoscope.json")
        save_depth(folder / "truth.npz", rendered, True)
    known = rendered.distance[rendered.mask]
    print(f"{arguments.scene}: {known.min():.1f} to {known.max():.1f} mm, median {np.median(known):.1f} mm")
    print(f"written to {arguments.out}: endoscope.json, frame.png, truth.npz")


def _evaluate(arguments: argparse.Namespace) -> None:
    import numpy as np

    from endolab.datasets.folders import true_z
    from endolab.io.surfaces import read_depth
    from endolab.metrics.depth_errors import compare

    depth = read_depth(arguments.depth)
    distance = depth["distance"].astype(np.float64)
    distance[~(distance > 0)] = np.nan
    cos_alpha = depth["z"] / distance
    maps: dict[str, np.ndarray] = {}
    if arguments.truth.endswith(".npz"):
        maps = read_depth(arguments.truth)
        truth = maps["distance"].astype(np.float64)
    else:
        z = true_z(arguments.truth)
        if z.shape != cos_alpha.shape:
            both = f"{arguments.depth} and {arguments.truth}"
            raise ValueError(f"{both} differ in size; reconstruct without --width to compare them")
        truth = z / cos_alpha
    mask = cos_alpha >= np.cos(np.deg2rad(arguments.max_angle))
    metric = bool(depth.get("metric", True))
    scale = arguments.scale or ("none" if metric else "median")
    if scale == "none" and not metric:
        raise ValueError(f"{arguments.depth} is in relative units: compare it with --scale median")
    known = {"normals": depth.get("normals"), "true_normals": maps.get("normals")}
    e = compare(distance, truth, cos_alpha, mask=mask, scale=scale, **known)
    if arguments.json:
        content = {key: None if np.isnan(value) else value for key, value in asdict(e).items()}
        print(json.dumps(content, indent=2))
        return
    print(f"{e.pixels} pixels, estimate multiplied by {e.scale:.4g} (scale: {scale})")
    print(f"distance  mean {e.mean_mm:.4g} mm, median {e.median_mm:.4g} mm, RMSE {e.rmse_mm:.4g} mm")
    print(f"          mean {e.mean_percent:.4g} % (AbsRel), median {e.median_percent:.4g} %")
    print(f"z         RMSE {e.rmse_z_mm:.4g} mm")
    if not np.isnan(e.mean_degrees):
        print(f"normals   mean {e.mean_degrees:.4g}°, median {e.median_degrees:.4g}°")


def _lab(arguments: argparse.Namespace) -> None:
    from endolab.cli.lab import open_lab

    open_lab(arguments.notebooks, arguments.port, arguments.jupyter)


class _Parser(argparse.ArgumentParser):
    """A parser whose complaint is one sentence."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"endolab: {message}; see {self.prog} --help\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="endolab", description="See how one endoscope frame becomes 3D.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    add_reconstruct_commands(commands)

    command = commands.add_parser("simulate", help="render a scene: a frame with its truth")
    option = command.add_argument
    option("scene", metavar="SCENE", help="plane, curved, tube or colon; sheet: a calibration video")
    option("--out", required=True, metavar="DIR")
    option("--calibration", default="paper", metavar="CAL", help="endoscope.json, or a name (default paper)")
    option("--width", type=int, default=640, metavar="PX", help="of the frame (default 640)")
    option("--noise", type=float, default=1.0, metavar="GREY", help="standard deviation (default 1 of 255)")
    option("--bits", type=int, default=8, choices=(8, 16))
    option("--texture", type=float, default=0.0, metavar="S", help="sd of the albedo's logarithm")
    option("--fog", type=float, default=0.0, metavar="PER_MM", help="attenuation")
    option("--highlights", type=float, default=0.0, metavar="S", help="share of light a wet film mirrors")
    option("--seed", type=int, default=0)
    add_sheet_options(command)
    command.set_defaults(run=_simulate)

    add_calibration_commands(commands)

    command = commands.add_parser("evaluate", help="compare a depth map with the truth")
    option = command.add_argument
    option("depth", metavar="DEPTH.npz")
    option("truth", metavar="TRUTH", help="truth.npz, or a depth map of C3VD, SimCol3D or UCL 2019")
    option("--scale", choices=("none", "median"), help="default: median for relative units, else none")
    option("--max-angle", type=float, default=90.0, metavar="DEG", help="only pixels this near the axis")
    option("--json", action="store_true", help="print JSON")
    command.set_defaults(run=_evaluate)

    command = commands.add_parser("lab", help="open JupyterLab on the notebooks")
    option = command.add_argument
    option("--notebooks", metavar="DIR", help="other notebooks than endolab's own")
    option("--port", type=int, default=8888, metavar="N", help="the next free one (default 8888)")
    option("jupyter", nargs="*", metavar="OPTION", help="passed on to JupyterLab, after --")
    command.set_defaults(run=_lab)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command: 0 when all is done, 2 after bad input, which is said in one sentence on stderr."""
    arguments = _parser().parse_args(argv)
    try:
        arguments.run(arguments)
    except (ValueError, OSError, MemoryError, MissingPackage) as error:
        print(f"endolab: {str(error) or 'out of memory'}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as interrupt:
        print(f"endolab: {str(interrupt) or 'interrupted; nothing was written'}", file=sys.stderr)
        return 130
    return 0


callable_as_before(__name__)

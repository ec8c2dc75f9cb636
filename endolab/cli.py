"""The command line: python -m endolab reconstruct | calibrate | target | simulate | evaluate | lab."""

from __future__ import annotations

import argparse
import json
import sys
import zipfile
import zlib
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from endolab.cli_calibration import SHEET, add_calibration_commands, add_sheet_options, simulate_sheet

SNAPSHOTS = 12  # of a march, in its recording


class _Progress:
    """An observer that shows a bar on stderr, of the iterations that are done."""

    def __init__(self, total: int | None) -> None:
        from tqdm import tqdm

        self.bar = tqdm(total=total, unit="it", leave=False, disable=None, desc="solving")

    def __call__(self, iterate: Any) -> None:
        self.bar.set_postfix_str(f"energy {iterate.energy:.3e}", refresh=False)
        self.bar.update(iterate.k - self.bar.n)  # the start is none

    def close(self) -> None:
        self.bar.close()


def _calibration(name: str) -> Any:
    """Return the calibration in a file, or one that endolab knows by name."""
    from endolab.datasets import CALIBRATIONS
    from endolab.endoscope import Calibration

    if name in CALIBRATIONS and not Path(name).exists():
        return CALIBRATIONS[name]
    return Calibration.load(name)


def _of_a_wall(calibration: Any, albedo: str | None) -> Any:
    """Replace the BRDF by that of a matt wall, as one must after calibrating on a sheet of paper."""
    from endolab.brdf import Lambertian

    if albedo is None:
        evidence = calibration.evidence.get("photometry")
        if isinstance(evidence, dict) and evidence.get("brdf_of"):
            print("The BRDF is that of the calibration sheet; --albedo 0.5 takes a matt wall instead.")
        return calibration
    try:
        values = tuple(float(part) for part in albedo.split(","))
        brdf = Lambertian(values[0] if len(values) == 1 else values)  # type: ignore[arg-type]
    except ValueError as error:
        raise ValueError(f"--albedo must be one number in (0, 1] or three (R,G,B), got {albedo}") from error
    return replace(calibration, photometry=replace(calibration.photometry, brdf=brdf))


def _reconstruct(arguments: argparse.Namespace) -> None:
    from endolab.files import read_frame, save_result, staged_folder
    from endolab.reconstruction import DEFAULT_SOLVER, reconstruct
    from endolab.recording import record

    calibration = _of_a_wall(_calibration(arguments.calibration), arguments.albedo)
    frame = read_frame(arguments.frame, calibration, arguments.mask)
    solver = DEFAULT_SOLVER if arguments.solver is None else arguments.solver
    snapshots = arguments.snapshots
    if snapshots is None and solver == "fast_marching":
        snapshots = SNAPSHOTS
    options = {} if snapshots is None else {"snapshots": snapshots}
    with staged_folder(arguments.out) as folder:
        result = reconstruct(
            frame,
            calibration,
            solver=solver,
            xi=arguments.xi,
            regulariser=arguments.regulariser,
            lam=arguments.lam,
            channel=arguments.channel,
            width=arguments.width,
            smooth=arguments.smooth,
            median_distance=arguments.median_distance,
            observers=[record(folder / "recording.rrd"), _Progress(snapshots)],
            **options,
        )
        save_result(result, folder)
        if arguments.mesh:
            from endolab.meshes import mesh_of, write_mesh

            write_mesh(folder / "mesh.ply", mesh_of(result))
    near, middle, far = np.percentile(result.distance[result.mask], [1, 50, 99])
    print(f"{result.status.name}: {result.status.value}")
    count, first = result.iterations, result.history[0]["energy"]
    print(
        f"{solver}, {count} iteration{'' if count == 1 else 's'}, {result.seconds:.2f} s, "
        f"energy {f'{first:.3e} to ' if count else ''}{result.energy:.3e}, {int(result.mask.sum())} pixels"
    )
    print(f"distance: median {middle:.4g}, 1 % below {near:.4g}, 1 % above {far:.4g} ({result.problem.unit})")
    if not result.metric:
        print("The gain is unknown, so distances have no unit; --median-distance MM fixes the scale.")
    mesh = "mesh.ply, " if arguments.mesh else ""
    print(f"written to {arguments.out}: cloud.ply, depth.npz, {mesh}overview.png, recording.rrd, report.json")


def _simulate(arguments: argparse.Namespace) -> None:
    from endolab.files import save_depth, staged_folder, write_image
    from endolab.rendering import render
    from endolab.scenes import SCENES

    if arguments.scene not in (*SCENES, SHEET):
        raise ValueError(f"unknown scene {arguments.scene!r}; choose {', '.join(SCENES)} or {SHEET}")
    calibration = _calibration(arguments.calibration)
    if arguments.width is not None:
        if arguments.width < 16:
            raise ValueError(f"--width must be at least 16 px, got {arguments.width}")
        camera = calibration.camera
        calibration = calibration.resize(
            arguments.width, max(1, round(camera.height * arguments.width / camera.width))
        )
    if arguments.scene == SHEET:
        simulate_sheet(arguments, calibration)
        return
    rendered = render(
        SCENES[arguments.scene],
        calibration.camera,
        calibration.photometry,
        noise=arguments.noise,
        bits=arguments.bits,
        texture=arguments.texture,
        fog=arguments.fog,
        highlights=arguments.highlights,
        seed=arguments.seed,
    )
    with staged_folder(arguments.out) as folder:
        write_image(folder / "frame.png", rendered.image, arguments.bits)
        replace(calibration, photometry=rendered.photometry).save(folder / "endoscope.json")
        save_depth(folder / "truth.npz", rendered.distance, rendered.z, rendered.normals, rendered.mask, True)
    known = rendered.distance[rendered.mask]
    print(f"{arguments.scene}: {known.min():.1f} to {known.max():.1f} mm, median {np.median(known):.1f} mm")
    print(f"written to {arguments.out}: endoscope.json, frame.png, truth.npz")


def _read_maps(path: str) -> dict[str, np.ndarray]:
    if not Path(path).is_file():
        raise FileNotFoundError(f"{path}: there is no such file")
    try:
        with open(path, "rb") as stream, np.load(stream, allow_pickle=False) as archive:
            maps = {name: archive[name] for name in archive.files}
    except (ValueError, OSError, EOFError, TypeError, zipfile.BadZipFile, zlib.error) as error:
        raise ValueError(f"{path}: not a depth.npz that endolab wrote") from error
    for name, tail in (("distance", ()), ("z", ()), ("normals", (3,))):
        if name not in maps and name != "normals":
            raise ValueError(f"{path}: {name} is missing")
        found = maps.get(name, np.empty((*maps["distance"].shape, *tail)))
        if found.dtype.kind != "f" or found.shape != (*maps["distance"].shape[:2], *tail) or found.ndim < 2:
            raise ValueError(f"{path}: {name} is not a map of the size of distance")
    return maps


def _evaluate(arguments: argparse.Namespace) -> None:
    from endolab.datasets import true_z
    from endolab.evaluation import compare

    depth = _read_maps(arguments.depth)
    distance = depth["distance"].astype(np.float64)
    distance[~(distance > 0)] = np.nan
    cos_alpha = depth["z"] / distance
    true_normals = None
    if arguments.truth.endswith(".npz"):
        known = _read_maps(arguments.truth)
        truth, true_normals = known["distance"].astype(np.float64), known.get("normals")
    else:
        z = true_z(arguments.truth)
        if z.shape != cos_alpha.shape:
            raise ValueError(
                f"{arguments.depth} and {arguments.truth} differ in size; "
                "reconstruct without --width to compare them"
            )
        truth = z / cos_alpha
    mask = cos_alpha >= np.cos(np.deg2rad(arguments.max_angle))
    metric = bool(depth.get("metric", True))
    scale = arguments.scale or ("none" if metric else "median")
    if scale == "none" and not metric:
        raise ValueError(f"{arguments.depth} is in relative units: compare it with --scale median")
    errors = compare(
        distance,
        truth,
        cos_alpha,
        normals=depth.get("normals"),
        true_normals=true_normals,
        mask=mask,
        scale=scale,
    )
    if arguments.json:
        content = {key: None if np.isnan(value) else value for key, value in asdict(errors).items()}
        print(json.dumps(content, indent=2))
        return
    e = errors
    print(f"{e.pixels} pixels, estimate multiplied by {e.scale:.4g} (scale: {scale})")
    print(f"distance  mean {e.mean_mm:.4g} mm, median {e.median_mm:.4g} mm, RMSE {e.rmse_mm:.4g} mm")
    print(f"          mean {e.mean_percent:.4g} % (AbsRel), median {e.median_percent:.4g} %")
    print(f"z         RMSE {e.rmse_z_mm:.4g} mm")
    if not np.isnan(e.mean_degrees):
        print(f"normals   mean {e.mean_degrees:.4g}°, median {e.median_degrees:.4g}°")


def _lab(arguments: argparse.Namespace) -> None:
    from endolab.lab import open_lab

    open_lab(arguments.notebooks, arguments.port, arguments.jupyter)


class _Parser(argparse.ArgumentParser):
    """A parser whose complaint is one sentence."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"endolab: {message}; see {self.prog} --help\n")


def _parser() -> argparse.ArgumentParser:
    parser = _Parser(prog="endolab", description="See how one endoscope frame becomes 3D.")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND")

    add = commands.add_parser("reconstruct", help="a frame and a calibration in, a surface out")
    add.add_argument("frame", metavar="FRAME", help="PNG, JPEG or TIFF, 8 or 16 bits")
    add.add_argument(
        "--calibration", required=True, metavar="CAL", help="endoscope.json, or a known endoscope's name"
    )
    add.add_argument("--out", required=True, metavar="DIR", help="folder for the results")
    add.add_argument("--mask", metavar="M.png", help="bright where the frame is to be used")
    add.add_argument("--solver", help="facing, fast_marching, gauss_newton (default) or primal_dual")
    add.add_argument("--xi", default="1/d", help="what the regulariser sees: 1/z, d or 1/d (default)")
    add.add_argument("--regulariser", default="second", help="first or second (default)")
    add.add_argument(
        "--lam", type=float, default=1.0, metavar="λ", help="its weight; larger is smoother (default 1)"
    )
    add.add_argument("--channel", help="red, green (default), blue or grey")
    add.add_argument(
        "--albedo", metavar="A", help="of a matt wall, or R,G,B, in place of the calibration's BRDF"
    )
    add.add_argument("--median-distance", type=float, metavar="MM", help="fix the scale of the result")
    add.add_argument("--width", type=int, metavar="PX", help="shrink the frame to this width first")
    add.add_argument(
        "--smooth", type=float, metavar="PX", help="blur the light first (default: by the noise)"
    )
    add.add_argument(
        "--snapshots", type=int, metavar="N", help=f"of fast_marching in the recording (default {SNAPSHOTS})"
    )
    add.add_argument("--mesh", action="store_true", help="write mesh.ply too: triangles, torn at folds")
    add.set_defaults(run=_reconstruct)

    add = commands.add_parser("simulate", help="render a scene: a frame with its truth")
    add.add_argument(
        "scene", metavar="SCENE", help="plane, curved, tube or colon; sheet: a calibration video"
    )
    add.add_argument("--out", required=True, metavar="DIR")
    add.add_argument(
        "--calibration", default="paper", metavar="CAL", help="endoscope.json, or a name (default paper)"
    )
    add.add_argument("--width", type=int, default=640, metavar="PX", help="of the frame (default 640)")
    add.add_argument(
        "--noise", type=float, default=1.0, metavar="GREY", help="standard deviation (default 1 of 255)"
    )
    add.add_argument("--bits", type=int, default=8, choices=(8, 16))
    add.add_argument("--texture", type=float, default=0.0, metavar="S", help="sd of the albedo's logarithm")
    add.add_argument("--fog", type=float, default=0.0, metavar="PER_MM", help="attenuation")
    add.add_argument(
        "--highlights", type=float, default=0.0, metavar="S", help="share of light a wet film mirrors"
    )
    add.add_argument("--seed", type=int, default=0)
    add_sheet_options(add)
    add.set_defaults(run=_simulate)

    add_calibration_commands(commands)

    add = commands.add_parser("evaluate", help="compare a depth map with the truth")
    add.add_argument("depth", metavar="DEPTH.npz")
    add.add_argument("truth", metavar="TRUTH", help="truth.npz, or a depth map of C3VD or SimCol3D")
    add.add_argument(
        "--scale", choices=("none", "median"), help="default: median for relative units, else none"
    )
    add.add_argument(
        "--max-angle", type=float, default=90.0, metavar="DEG", help="only pixels this near the axis"
    )
    add.add_argument("--json", action="store_true", help="print JSON")
    add.set_defaults(run=_evaluate)

    add = commands.add_parser("lab", help="open JupyterLab on the notebooks")
    add.add_argument("--notebooks", metavar="DIR", help="other notebooks than endolab's own")
    add.add_argument("--port", type=int, default=8888, metavar="N", help="the next free one (default 8888)")
    add.add_argument("jupyter", nargs="*", metavar="OPTION", help="passed on to JupyterLab, after --")
    add.set_defaults(run=_lab)
    return parser


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command.

    Returns
    -------
    int
        0 when all is done, 2 after bad input, which is said in one sentence on stderr.
    """
    arguments = _parser().parse_args(argv)
    try:
        arguments.run(arguments)
    except (ValueError, OSError, MemoryError) as error:
        print(f"endolab: {str(error) or 'out of memory'}", file=sys.stderr)
        return 2
    except KeyboardInterrupt as interrupt:
        print(f"endolab: {str(interrupt) or 'interrupted; nothing was written'}", file=sys.stderr)
        return 130
    return 0

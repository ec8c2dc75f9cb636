"""Tubes, which enter the picture over its border: `python -m tests.benchmarks.border [straight | bent]...`.

What is found by each regulariser, where the error lies, and whether the energy prefers it to the truth. No
test: it asserts nothing and takes minutes.
"""

import sys
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

import endolab as el
from endolab import datasets
from endolab.metrics.depth_errors import angle_between
from endolab.reconstruction.channels import make_problem
from endolab.solvers.energy import energy_terms
from endolab.solvers.solvers import solve
from endolab.synthetic.scenes import Colon, Tube, _tilt_matrix
from tests.benchmarks.report import table
from tests.tools.problems import Shot

WIDTH = 320
RIM = 20  # px, of that width
CAMERAS = ("simple", "paper")  # a pinhole of 90° and a fisheye
REGULARISERS = ("second", "curvature")
HEADS = ("mean %", "rim", "within", "°", "energy found", "from the truth", "of the truth")


@dataclass(frozen=True)
class Funnel(Tube):
    """A tube that narrows along its axis, by `narrowing` mm a mm."""

    narrowing: float = 0.1

    def normals(self, points):
        inside = points @ _tilt_matrix(self.tilt)
        out = inside[..., :2] + self.offset
        out /= np.linalg.norm(out, axis=-1, keepdims=True)
        normal = -np.append(out, np.full((*out.shape[:-1], 1), self.narrowing), axis=-1)
        is_wall = inside[..., 2:] > self.length * (1 - 1e-12)
        normal = np.where(is_wall, [0.0, 0.0, -1.0], normal / np.hypot(1, self.narrowing))
        return normal @ _tilt_matrix(self.tilt).T

    def distance(self, rays):
        inside = rays @ _tilt_matrix(self.tilt)
        offset = np.asarray(self.offset)
        along = inside[..., 2]
        a = np.sum(inside[..., :2] ** 2, axis=-1) - (self.narrowing * along) ** 2
        b = inside[..., :2] @ offset + self.radius * self.narrowing * along
        c = offset @ offset - self.radius**2
        root = -c / (b + np.sqrt(np.maximum(b * b - a * c, 0.0)))
        wall = np.where(along > 0, self.length / np.where(along > 0, along, 1.0), np.inf)
        return np.minimum(np.where(root > 0, root, np.inf), wall)


def random_tubes(count=20, seed=15, narrowing=None):
    """Radius 8 to 25 mm, tilted by up to 25°, the camera up to half the radius off centre."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        radius = rng.uniform(8, 25)
        tilt = rng.uniform(0, 25)
        length = rng.uniform(5, 9)
        away = rng.uniform(0, 0.5)
        towards = rng.uniform(0, 2 * np.pi)
        offset = (radius * away * np.cos(towards), radius * away * np.sin(towards))
        if narrowing is None:
            yield Tube(radius, radius * length, tilt, offset)
        else:
            yield Funnel(
                radius, radius * length, tilt, offset, rng.uniform(-narrowing, narrowing)
            )


def random_bends(count=6, seed=16):
    """Tubes without folds that swing to the side: a bend of 50 to 200 mm radius."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        radius = rng.uniform(10, 25)
        yield Colon(
            radius=radius, fold_height=0.0, winding=rng.uniform(6, 25), length=150.0
        )


def shot_of(scene, camera, noise, seed):
    """A frame as bright as it may be, whatever the tube's radius."""
    known = datasets.load_calibration(camera, WIDTH)
    known = replace(known, photometry=replace(known.photometry.channel("green"), gain=None))
    return Shot(scene, known, noise=noise, bits=8 if noise else None, seed=seed)


def measure(shot, regulariser):
    """What `HEADS` say."""
    problem = make_problem(shot.frame, shot.calibration, regulariser=regulariser)
    found = el.run(solve(problem))
    truth = shot.truth.distance
    mask = problem.mask & np.isfinite(truth)
    off = 100 * np.abs(found.distance / np.where(mask, truth, 1.0) - 1)
    inside = np.zeros_like(mask)
    inside[RIM:-RIM, RIM:-RIM] = mask[RIM:-RIM, RIM:-RIM]
    degrees = angle_between(found.normals, shot.truth.normals)[mask]
    start = np.where(problem.mask, problem.log_d0, 0.0)
    start[mask] = np.log(truth[mask])
    kept = el.run(solve(problem, start=start)).energy
    of_truth = sum(energy_terms(problem, start).values())
    energies = 1e5 * np.array([found.energy, kept, of_truth])
    errors = [off[mask].mean(), off[mask & ~inside].mean(), off[inside].mean()]
    return np.array([*errors, degrees.mean(), *energies])


def print_table(title, scenes, noises):
    """A row for each scene, and one for the mean and the largest of its kind."""
    rows = []
    for kind in product(CAMERAS, noises, REGULARISERS):
        camera, noise, regulariser = kind
        found = []
        for number, scene in enumerate(scenes):
            found.append(measure(shot_of(scene, camera, noise, number), regulariser))
        lines = dict(enumerate(found))
        lines |= {"mean": np.nanmean(found, axis=0), "most": np.nanmax(found, axis=0)}
        for name, figures in lines.items():
            rows.append([*map(str, kind), str(name), *(f"{x:.2f}" for x in figures)])
    heads = ("camera", "noise", "regulariser", "tube", *HEADS)
    table(f"{title}, {WIDTH} px; energies times 1e5", heads, rows)


def straight():
    """Twenty straight tubes."""
    print_table("Tubes, tilted and off centre", list(random_tubes()), (0.0, 1.0))


def bent():
    """What no sheet can be rolled into, and cones."""
    print_table("Funnels", list(random_tubes(6, 17, narrowing=0.2)), (0.0,))
    print_table("Bends", list(random_bends()), (0.0,))


PARTS = {"straight": straight, "bent": bent}

if __name__ == "__main__":
    for wanted in sys.argv[1:] or PARTS:
        PARTS[wanted]()

"""What CONVERGED leaves: how much further the energy falls when a run goes on, over random frames.

    python -m tests.benchmarks.converged [gauss_newton | primal_dual | separated] [RUNS]

Not a test: it asserts nothing. Gauss-Newton goes on from the answer, a hundred times as strict; primal-dual,
which would lose its dual there, begins again and is thirty times as strict.
"""

import sys
import time

import numpy as np

import endolab as el
from endolab import datasets
from endolab.depth.gauss_newton import gauss_newton
from endolab.depth.primal_dual import primal_dual
from endolab.numerics.iteration import Status

COLOURS = el.Lambertian((0.7, 0.35, 0.28))


def drawn(seed, colour):
    """A random frame with its calibration, and options of the energy."""
    rng = np.random.default_rng([15, seed])
    scene, camera = str(rng.choice([*el.SCENES, "colon"])), str(rng.choice(["simple", "paper"]))
    known = datasets.load_calibration(camera, int(rng.choice([80, 96, 120, 160])))
    how = {"noise": float(rng.choice([0, 0, 1, 3, 6])), "texture": float(rng.choice([0, 0, 0.1])), "bits": 8}
    photometry = el.Photometry(brdf=COLOURS if colour else el.Lambertian(0.5))
    shot = el.render(el.SCENES[scene], known.camera, photometry, seed=seed, **how)
    energy = {"lam": float(10 ** rng.uniform(-2, 2)), "xi": str(rng.choice(["1/z", "d", "1/d"]))}
    energy["regulariser"] = str(rng.choice(["first", "second"]))
    return el.Frame(shot.image, shot.mask, scene), el.Calibration(known.camera, shot.photometry), energy


def main(way, runs):
    """Print how runs ended, and the shares of the energy that those which converged had left."""
    options = {"channel": "separated"} if way == "separated" else {"solver": way}
    ended, left, seconds = dict.fromkeys(Status, 0), [], 0.0
    for seed in range(runs):
        frame, calibration, energy = drawn(seed, way == "separated")
        started = time.process_time()
        found = el.reconstruct(frame, calibration, **options, **energy)
        seconds += time.process_time() - started
        ended[found.status] += 1
        if found.status is Status.CONVERGED:
            problem, start = found.iterate.problem, found.iterate.log_distance
            if way == "primal_dual":
                further = primal_dual(problem, tolerance=2e-3 / 30, max_iterations=20_000)
            else:
                further = gauss_newton(problem, start=start, tolerance=1e-4, max_iterations=300)
            left.append(100 * (1 - el.run(further).energy / found.energy))
    counts = ", ".join(f"{count} {status.name}" for status, count in ended.items() if count)
    shares = ", ".join(f"{np.quantile(left, q):.2f}" for q in (0.5, 0.9, 1))
    many = sum(share > 10 for share in left)
    print(f"{way}: {counts}; {seconds / runs:.2f} CPU s a run")
    print(f"  left after CONVERGED, median, 90 %, worst: {shares} %; more than a tenth in {many}", flush=True)


if __name__ == "__main__":
    ways = [name for name in sys.argv[1:] if not name.isdigit()] or [
        "gauss_newton",
        "primal_dual",
        "separated",
    ]
    for name in ways:
        main(name, int(next((count for count in sys.argv[1:] if count.isdigit()), 60)))

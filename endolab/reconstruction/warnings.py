"""What makes a result doubtful, a sentence each. Nothing is refused: a frame may be a rare one."""

from collections.abc import Iterator

import numpy as np

from endolab.frames.frame import noise_level
from endolab.frames.surround import unclear_surround
from endolab.solvers.energy import contradicts, model_image
from endolab.solvers.result import Result

NARROW = 5.0  # degrees from the axis to the picture's rim; endoscopes see 35 to 85
DISTANCES = 2.0, 300.0  # mm, of the median
EXPLAINED = 0.97  # of the picture's variance; frames of cavities have 0.99 and more
DIM = (
    0.1  # of what the file can hold; the brightest pixel of a usual frame has 0.8 and more
)
BLACKEST = 0.05  # albedo of tissue and of phantoms


def warnings(result: Result) -> tuple[str, ...]:
    """List what can hardly be true of a result, a sentence each; usually nothing."""
    return tuple(_warnings(result))


def _warnings(result: Result) -> Iterator[str]:
    problem = result.problem
    mask = result.mask
    widest = float(
        np.degrees(np.arccos(np.clip(problem.field.cos_alpha[mask].min(), -1, 1)))
    )
    if widest < NARROW:
        yield f"The camera sees only {widest:.2g}° to the side: its focal length may be wrong."
    median = float(np.median(result.distance[mask]))
    if result.metric and not DISTANCES[0] <= median <= DISTANCES[1]:
        yield (
            f"The median distance is {median:.3g} mm, where endoscopes see {DISTANCES[0]:g} to "
            f"{DISTANCES[1]:g} mm: gain, k, γ, albedo or a given length may be wrong."
        )
    left = model_image(problem, result.iterate.log_distance) - problem.image
    compared = mask & contradicts(problem, left)
    spread = float(np.var(problem.image[compared])) if compared.any() else 0.0
    picture = problem.shown
    noise = noise_level(picture if picture.ndim == 2 else picture.mean(axis=-1), mask)
    explained = (
        1 - (float(np.var(left[compared])) + noise**2) / spread if spread > 0 else 1.0
    )
    if explained < EXPLAINED:
        yield (
            f"The surface explains {100 * max(explained, 0):.0f} % of the picture's contrast; 99 % is usual. "
            "This may not be an endoscope's frame, or λ is too large."
        )
    if picture.ndim == 3:
        red, _, blue = (
            float(np.median(picture[..., channel][mask])) for channel in range(3)
        )
        if blue > red:
            yield "Blue is brighter than red, unlike tissue: they may be swapped, or the picture inverted."
    brightest = float(picture[mask].max())
    if brightest < DIM:
        yield (
            f"The brightest pixel has {100 * brightest:.2g} % of what the file can hold: it may use fewer "
            "bits than the file, such as 12 of 16."
        )
    prepared = result.provenance.preparation
    if prepared is not None and prepared.misplaced:
        yield (
            f"{100 * prepared.misplaced:.0f} % of the mask lies beyond what the endoscope shows, and was "
            "left out: the mask may be another camera's."
        )
    if unclear_surround(picture, mask):
        yield (
            "Corners of the picture have one flat colour and no clear edge: if they surround what the "
            "endoscope shows, a mask must leave them out."
        )
    albedo = float(np.min(getattr(problem.photometry.brdf, "albedo", BLACKEST)))
    if albedo < BLACKEST:
        yield f"An albedo of {albedo:.2g} is too dark for tissue, which has 0.1 to 0.8."

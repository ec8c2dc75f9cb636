"""What makes a result doubtful, a sentence each. Nothing is refused: a frame may be a rare one."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from endolab.frames.surround import unclear_surround
from endolab.reconstruction.contrast import explained_contrast
from endolab.solvers.result import Result


@dataclass(frozen=True)
class Plausible:
    """What frames of endoscopes usually show."""

    # Degrees from the axis to the picture's rim; endoscopes see 35 to 85.
    least_angle: float = 5.0
    distances: tuple[float, float] = (2.0, 300.0)  # mm, of the median
    # Of the picture's variance; frames of cavities have 0.99 and more.
    explained: float = 0.97
    # Of what the file can hold; the brightest pixel of a usual frame has 0.8 and more.
    dim: float = 0.1
    darkest_albedo: float = 0.05  # of tissue and of phantoms


PLAUSIBLE = Plausible()


def warnings(result: Result) -> tuple[str, ...]:
    """List what can hardly be true of a result, a sentence each; usually nothing."""
    return tuple(_warnings(result))


def _warnings(result: Result) -> Iterator[str]:
    problem = result.problem
    mask = result.mask
    widest = float(
        np.degrees(np.arccos(np.clip(problem.field.cos_alpha[mask].min(), -1, 1)))
    )
    if widest < PLAUSIBLE.least_angle:
        yield f"The camera sees only {widest:.2g}° to the side: its focal length may be wrong."
    median = float(np.median(result.distance[mask]))
    if result.metric and not PLAUSIBLE.distances[0] <= median <= PLAUSIBLE.distances[1]:
        yield (
            f"The median distance is {median:.3g} mm, where endoscopes see {PLAUSIBLE.distances[0]:g} to "
            f"{PLAUSIBLE.distances[1]:g} mm: gain, k, γ, albedo or a given length may be wrong."
        )
    explained = explained_contrast(result)
    picture = problem.shown
    if explained < PLAUSIBLE.explained:
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
    if brightest < PLAUSIBLE.dim:
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
    albedo = float(
        np.min(getattr(problem.photometry.brdf, "albedo", PLAUSIBLE.darkest_albedo))
    )
    if albedo < PLAUSIBLE.darkest_albedo:
        yield f"An albedo of {albedo:.2g} is too dark for tissue, which has 0.1 to 0.8."

"""What was solved of a frame, for people: its picture, its pixels and why some are left out, its light."""

from dataclasses import dataclass

import numpy as np

from endolab.frames.frame import LEAST_COSINE
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.checks import check_kinds
from endolab.reconstruction.report import notes_on_pixels
from endolab.solvers.problem import LOWER_BOUND, NONE, Problem
from endolab.solvers.result import Result


@dataclass(frozen=True, eq=False)
class Prepared:
    """A frame as it was solved; maps are (H, W), of the result's size."""

    picture: FloatArray  # (H, W) or (H, W, 3), stored values as the frame has them
    canonical: FloatArray  # see `canonical_picture`
    # Stored values that were explained: one channel, or the light of all three that did not bounce, without
    # noise that was averaged and highlights that were filled in; nan where left out.
    solved: FloatArray
    field_of_view: BoolArray  # what the endoscope shows, and a mask that was given keeps
    without_ray: (
        BoolArray  # of these, left out: the camera has no ray within 80° of its axis
    )
    dark: BoolArray  # likewise: as good as black
    saturated: BoolArray  # solved as "at least this bright"
    highlights: BoolArray  # and overlays: ignored, the surface goes on beneath them
    notes: tuple[str, ...]  # the same in sentences


@check_kinds(result=Result)
def prepare(result: Result) -> Prepared:
    """Show what was solved of a frame, and what of it was left out.

    Parameters
    ----------
    result : Result
        Of `endolab.reconstruct`. Nothing is found anew.

    Returns
    -------
    Prepared
        The picture, the light that was explained, masks, and notes in sentences.

    Raises
    ------
    ValueError
        If it is given something else.

    Examples
    --------
    >>> import endolab as el
    >>> sample = el.load_traced("wet-1")  # a frame that comes with endolab
    >>> result = el.reconstruct(sample.frame, sample.calibration, channel="green", highlights="ignore")
    >>> prepared = el.prepare(result)
    >>> prepared.highlights.shape, bool(prepared.highlights.any())
    ((240, 320), True)
    """
    problem = result.problem
    mask = problem.mask
    field = mask if problem.seen is None else problem.seen
    with_ray = field & (problem.field.cos_alpha > LEAST_COSINE)
    evidence = np.zeros(mask.shape) if problem.evidence is None else problem.evidence
    return Prepared(
        picture=problem.shown,
        canonical=canonical_picture(problem),
        solved=np.where(mask, problem.image, np.nan),
        field_of_view=field,
        without_ray=field & ~with_ray,
        dark=with_ray & ~mask,
        saturated=mask & (evidence == LOWER_BOUND),
        highlights=mask & (evidence == NONE),
        notes=tuple(notes_on_pixels(problem, field, with_ray)),
    )


def canonical_picture(problem: Problem) -> FloatArray:
    """Take μ′ = cos^k α out of a problem's picture, for people to look at (paper, Section IV).

    I_c per channel to the power of 1/γ, in [0, 1]; the 90th percentile of the brightest channel is 0.9. nan
    outside the mask.
    """
    photometry = problem.photometry
    cosine = np.where(problem.mask, problem.field.cos_alpha, np.nan)
    factor = photometry.attenuation(cosine) ** (1 / photometry.gamma)
    picture = (problem.shown.T / factor.T).T
    brightest = np.atleast_3d(picture).max(axis=-1)[problem.mask]
    return np.clip(picture * (0.9 / np.percentile(brightest, 90)), 0.0, 1.0)

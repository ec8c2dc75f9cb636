"""What an overview shows, as plain values: of NumPy alone, so that another process can draw it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from endolab.model.cameras import RayField
from endolab.numerics.arrays import FloatArray
from endolab.plots.scales import VIEW_WIDTH

if TYPE_CHECKING:
    from endolab.depth.result import Iterate, Result
    from endolab.uncertainty.trust import Trust

PANEL = 430  # px across that a page has for a picture


@dataclass(frozen=True)
class Page:
    """The contents of `endolab.plots.overview`; maps are thinned to what a page can show, (h, w, ...)."""

    size: tuple[int, int]  # rows and columns before they were thinned
    picture: FloatArray  # (h, w) or (h, w, 3), stored values
    distance: FloatArray  # (h, w), in `unit`; nan where unknown
    normals: FloatArray  # (h, w, 3)
    error: FloatArray  # (h, w), model - frame, grey levels of 255
    points: FloatArray  # (m, n, 3), in `unit`; thinned for the view from the side
    colours: FloatArray  # (m, n) or (m, n, 3)
    column: int  # in the middle, along which the section is
    section: Mapping[str, FloatArray]  # (H, 1), distances there, by name
    field: RayField  # (H, 1), of that column
    unit: str
    title: str
    foot: str
    sigma: FloatArray | None = None  # (h, w), σ of the distance, %
    decided_by: np.ndarray | None = None  # (h, w), see `endolab.uncertainty`


def page_of(
    shown: Result | Iterate,
    picture: FloatArray | None = None,
    truth: FloatArray | None = None,
    trust: Trust | None = None,
) -> Page:
    """Collect what `endolab.plots.overview` shows; its parameters."""
    # Here, for who only draws a page needs no solver.
    from endolab.depth.energy import model_image
    from endolab.depth.result import Result
    from endolab.reconstruction.assumptions import meaning

    iterate = shown.iterate if isinstance(shown, Result) else shown
    problem, field = iterate.problem, iterate.problem.field
    picture = problem.shown if picture is None else picture
    rows, columns = problem.mask.shape
    column = columns // 2
    middle = np.s_[:, column : column + 1]
    curves = {"start": np.exp(np.where(problem.mask, problem.log_facing, np.nan)[middle])}
    curves["estimate"] = iterate.distance[middle]
    if truth is not None:
        scale = 1.0 if problem.metric else np.nanmedian((iterate.distance / truth)[problem.mask])
        curves = {"truth": np.where(problem.mask, scale * truth, np.nan)[middle], **curves}
    what = [f"iteration {iterate.k}", f"energy {iterate.energy:.4g}"]
    if isinstance(shown, Result):
        what.insert(0, shown.status.value.rstrip("."))
    if not problem.metric:
        what.append("relative units")
    thin, side = (np.s_[::step, ::step] for step in (max(1, columns // PANEL), -(-columns // VIEW_WIDTH)))
    rays, valid = field.rays[middle], field.valid[middle]
    return Page(
        size=(rows, columns),
        picture=picture[thin],
        distance=iterate.distance[thin],
        normals=iterate.normals[thin],
        error=255 * (model_image(problem, iterate.log_distance)[thin] - problem.image[thin]),
        points=iterate.distance[side][..., None] * field.rays[side],
        colours=picture[side],
        column=column,
        section=curves,
        field=RayField(rays, field.jacobian[middle], field.inverse_metric[middle], valid),
        unit=problem.unit,
        title="  ·  ".join(what),
        foot=meaning(shown)[0],
        sigma=None if trust is None else 100 * trust.sigma[thin] / iterate.distance[thin],
        decided_by=None if trust is None else trust.decided_by[thin],
    )

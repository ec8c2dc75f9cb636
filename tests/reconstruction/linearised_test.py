"""The linear answer of a surface, against solving again."""

import numpy as np

from endolab.solvers.linearised import far_end_by_gamma
from tests.tools.cases import traced


def test_what_gamma_does_to_the_far_end_is_what_solving_again_finds():
    case = traced("matt")
    options = {"width": 160, "channel": "green", "contours": False}
    before = case.solve(**options)
    gamma = case.calibration.photometry.gamma + 0.05
    after = case.relit(gamma=gamma).solve(**options)
    moved = np.log(after.distance / before.distance)[before.mask]
    far = before.distance[before.mask] >= np.percentile(
        before.distance[before.mask], 95
    )
    found = np.expm1(np.median(moved[far]) - np.median(moved))
    answer = far_end_by_gamma(before.iterate, 0.05)
    assert found > 0.005
    assert 0.6 < answer / found < 1.6

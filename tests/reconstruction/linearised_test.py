"""The linear answer of a surface, against solving again."""

from dataclasses import replace

import numpy as np

import endolab as el
from endolab.solvers.linearised import far_end_by_gamma


def test_what_gamma_does_to_the_far_end_is_what_solving_again_finds():
    sample = el.load_traced("matt")
    options = {"width": 160, "channel": "green", "contours": False}
    known = sample.calibration
    before = el.reconstruct(sample.frame, known, **options)
    light = replace(known.photometry, gamma=known.photometry.gamma + 0.05)
    after = el.reconstruct(sample.frame, replace(known, photometry=light), **options)
    moved = np.log(after.distance / before.distance)[before.mask]
    far = before.distance[before.mask] >= np.percentile(
        before.distance[before.mask], 95
    )
    found = np.expm1(np.median(moved[far]) - np.median(moved))
    answer = far_end_by_gamma(before.iterate, 0.05)
    assert found > 0.005
    assert 0.6 < answer / found < 1.6

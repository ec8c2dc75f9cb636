"""How far published frames are off, where they are here."""

import pytest

import endolab as el
from tests.tools.cases import Case


@pytest.mark.parametrize(
    ("name", "index", "solver", "most"),
    [
        ("c3vd_trans_t1_a", 0, "gauss_newton", 9.5),
        ("c3vd_trans_t1_a", 0, "facing", 15),
        ("simcol3d", 3, "gauss_newton", 10),
    ],
)
def test_errors_on_published_frames(data, name, index, solver, most):
    """Measured: over a phantom the default 8.3 to 9.1 %, d₀ 13.9; over a synthetic colon 9.0 to 10.9."""
    sample = el.open_dataset(data / name)[index]
    known = sample.frame, sample.calibration, sample.distance
    case = Case(name, *known, align="scale", max_angle=55.0).resize(675)
    errors = case.errors_of(case.solve(solver=solver))
    assert errors.pixels > 0.5 * case.scored.sum()
    assert errors.mean_percent < most

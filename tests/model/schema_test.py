"""Names that are none: all there is to choose, and the nearest of a misspelt one."""

import pytest

from endolab.model.schema import nearest, unknown_name


@pytest.mark.parametrize(
    ("found", "meant"),
    [
        ("gaus_newton", "gauss_newton"),
        ("Primal_Dual", "primal_dual"),
        ("magic", ""),
        ("x" * 1_000_000, ""),
    ],
)
def test_a_misspelt_name_has_a_nearest(found, meant):
    assert (
        nearest(found, ("facing", "fast_marching", "gauss_newton", "primal_dual"))
        == meant
    )


def test_all_there_is_to_choose_is_named():
    message = str(
        unknown_name("calibration", "papr", ("paper", "simple"), "a JSON file")
    )
    assert all(
        word in message for word in ("calibration", "papr", "paper", "simple", "JSON")
    )

"""Names and keys that are none: all there is to choose, and the nearest of a misspelt one."""

import pytest

from endolab.model.schema import nearest, unknown_name


@pytest.mark.parametrize(
    ("found", "meant"),
    [
        *(("gaus_newton", "gauss_newton"), ("Primal_Dual", "primal_dual"), ("fastmarching", "fast_marching")),
        *(("magic", ""), ("", ""), ("x" * 1_000_000, "")),
    ],
)
def test_a_misspelt_name_has_a_nearest(found, meant):
    assert nearest(found, ("facing", "fast_marching", "gauss_newton", "primal_dual")) == meant


def test_all_there_is_to_choose_is_named():
    names = ("paper", "simple", "c3vd")
    said = str(unknown_name("calibration", "papr", names, "a JSON file"))
    assert (
        said == "unknown calibration 'papr'; choose paper, simple, c3vd or a JSON file; did you mean paper?"
    )
    assert (
        str(unknown_name("scale", "both", ("none", "median")))
        == "unknown scale 'both'; choose none or median"
    )

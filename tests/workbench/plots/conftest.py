"""What the tests of figures share: a colon, and no figure that stays."""

import matplotlib.pyplot as plt
import pytest

import endolab as el
from tests.tools.problems import coloured_colon


@pytest.fixture(autouse=True)
def _no_figure_stays():
    yield
    plt.close("all")


@pytest.fixture(scope="package")
def colon():
    """The start of a reconstruction, and the rendering it is of."""
    problem, seen = coloured_colon(el.load_calibration("paper", width=80).camera)
    return el.Iterate.of(problem, problem.log_d0), seen

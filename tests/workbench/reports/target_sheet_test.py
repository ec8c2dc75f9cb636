"""Sheets: what is printed is where the target says, in millimetres."""

import re

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from endolab.calibration.targets import TARGETS, DotGrid
from endolab.workbench.reports.target_sheet import A4, draw_sheet, write_sheet
from tests.tools.sheet_views import OTHER_TARGETS as OTHERS
from tests.tools.sheet_views import reflectance

NAMES = ("vicalib_big", "vicalib_grey", "charuco")
BIG = DotGrid(40, 30, 9.0, small=1.5, large=2.2)


@pytest.mark.parametrize(
    ("target", "least", "most"),
    [
        (TARGETS["vicalib_folded"], A4, A4),
        (BIG, BIG.sheet[2:], np.add(BIG.sheet[2:], [20, 45])),
    ],
)
def test_a_page_is_a4_or_as_large_as_it_needs_has_no_pixels_and_knows_no_date(
    target, least, most, tmp_path
):
    path = tmp_path / "sheet.pdf"
    write_sheet(target, path)
    content = path.read_bytes()
    assert b"/Subtype /Image" not in content
    write_sheet(target, path)
    assert path.read_bytes() == content
    size = re.search(rb"/MediaBox \[ *0 0 ([\d.]+) ([\d.]+) *\]", content).groups()
    page = np.array(size, float) / 72 * 25.4
    assert np.all((page > np.subtract(least, 0.01)) & (page < np.add(most, 0.01)))


def picture(target, dpi=300):
    """The page as a printer of so many dots an inch prints it: values, and (x, y) in mm to pixel."""
    figure = draw_sheet(target)
    figure.set_dpi(dpi)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    image = np.asarray(canvas.buffer_rgba())[..., 0] / 255

    def pixel(xy):
        found = figure.axes[0].transData.transform(xy)
        return np.column_stack([found[:, 0] - 0.5, image.shape[0] - 0.5 - found[:, 1]])

    return image, pixel


@pytest.mark.parametrize("target", [*(TARGETS[name] for name in NAMES), *OTHERS])
def test_the_page_shows_the_reflectance(target, rng):
    image, pixel = picture(target)
    left, top, width, height = target.sheet
    low = np.array([left + 0.5, top + 4])
    high = np.array([left + width - 0.5, top + height - 4])
    places = rng.uniform(low, high, (2000, 2))
    grid = np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), axis=-1)
    around = places[:, None] + 0.12 * grid.reshape(-1, 2)
    value = reflectance(target, around, black=0.0)
    clear = np.ptp(value, axis=1) == 0  # off the rims
    column, row = np.round(pixel(places[clear])).astype(int).T
    shown = image[row, column]
    # SRGB.
    linear = np.where(shown > 0.04045, ((shown + 0.055) / 1.055) ** 2.4, shown / 12.92)
    assert clear.mean() > 0.5
    np.testing.assert_allclose(linear, value[clear, 4], atol=0.01)


def test_the_page_says_how_to_fold_and_its_ruler_measures_what_it_says():
    folded = draw_sheet(TARGETS["vicalib_folded"]).axes[0]
    plain = draw_sheet(TARGETS["vicalib_small"]).axes[0]
    assert "fold here" in folded.texts[0].get_text()
    words = " ".join(text.get_text() for text in plain.texts)
    assert "fold here" not in words
    assert "50 mm" in words
    lengths = [np.ptp(line.get_xdata()) for line in plain.lines]
    assert max(lengths) == pytest.approx(50, abs=1e-9)

"""Sheets: what is printed is where the target says, in millimetres."""

import re

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg

from endolab.calibration.targets import TARGETS, CircleGrid, DotGrid
from endolab.reports.target_sheet import A4, draw_sheet, write_sheet
from tests.tools.sheet_views import OTHER_TARGETS as OTHERS

BIG = DotGrid(40, 30, 9.0, small=1.5, large=2.2)


def size_of(path):
    """Width and height of a page, mm."""
    number = rb"([\d.]+)"
    pdf, svg = rb"/MediaBox \[ *0 0 %b %b *\]", rb'width="%bpt" height="%bpt"'
    found = re.search((pdf if path.suffix == ".pdf" else svg) % (number, number), path.read_bytes())
    return np.array([float(value) for value in found.groups()]) / 72 * 25.4


def picture(target, dpi=300):
    """The page as a printer of so many dots an inch prints it: values, and (x, y) in mm to pixel."""
    figure = draw_sheet(target)
    figure.set_dpi(dpi)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    image = np.asarray(canvas.buffer_rgba())[..., 0] / 255
    axes = figure.axes[0]

    def pixel(xy):
        found = axes.transData.transform(xy)
        return np.column_stack([found[:, 0] - 0.5, image.shape[0] - 0.5 - found[:, 1]])

    return image, pixel


@pytest.mark.parametrize("suffix", [".pdf", ".svg"])
@pytest.mark.parametrize("name", TARGETS)
def test_every_target_fits_an_a4_page_of_true_size(name, suffix, tmp_path):
    path = tmp_path / f"sheet{suffix}"
    write_sheet(TARGETS[name], path)
    np.testing.assert_allclose(size_of(path), A4, atol=0.01)
    assert not re.search(rb"/Subtype */Image|<image", path.read_bytes())  # no pixels


@pytest.mark.parametrize("suffix", [".pdf", ".svg"])
def test_a_large_sheet_gets_a_page_of_its_own_size(suffix, tmp_path):
    path = tmp_path / f"sheet{suffix}"
    write_sheet(BIG, path)
    size, (_, _, width, height) = size_of(path), BIG.sheet
    assert np.all(size >= [width, height])
    assert np.all(size <= [width + 20, height + 45])


@pytest.mark.parametrize("suffix", [".pdf", ".svg"])
def test_the_same_target_makes_the_same_bytes(suffix, tmp_path):
    for name in ("a", "b"):
        write_sheet(TARGETS["charuco"], tmp_path / f"{name}{suffix}")
    content = (tmp_path / f"a{suffix}").read_bytes()
    assert content == (tmp_path / f"b{suffix}").read_bytes()
    assert b"CreationDate" not in content
    assert b"dc:date" not in content


@pytest.mark.parametrize("name", ["vicalib_big", "vicalib_folded", "vicalib_grey", "circles"])
def test_printed_discs_are_where_the_target_says(name):
    target = TARGETS[name]
    image, pixel = picture(target)
    per_mm = 300 / 25.4
    for (x, y), radius in zip(pixel(target.points[:, :2]), target.radii, strict=True):
        half = int(np.ceil((radius + 0.3) * per_mm))
        left, top = int(x) - half, int(y) - half
        dark = 1 - image[top : top + 2 * half + 2, left : left + 2 * half + 2]
        rows, columns = np.indices(dark.shape)
        dark = np.where(np.hypot(columns + left - x, rows + top - y) < (radius + 0.2) * per_mm, dark, 0)
        centre = np.array([(dark * columns).sum(), (dark * rows).sum()]) / dark.sum() + [left, top]
        assert np.hypot(*(centre - [x, y])) / per_mm < 0.02
        assert np.sqrt(dark.sum() / np.pi) / per_mm == pytest.approx(radius, abs=0.02)


def test_a_millimetre_of_the_axes_is_a_millimetre_of_the_page():
    for target in (TARGETS["vicalib_big"], BIG):
        figure = draw_sheet(target)
        corners = figure.axes[0].transData.transform([[0, 0], [10, 0], [0, 10]])
        inches = (corners[1:] - corners[0]) / figure.dpi
        np.testing.assert_allclose(inches * 25.4, [[10, 0], [0, -10]], atol=1e-9)


@pytest.mark.parametrize("target", [*TARGETS.values(), *OTHERS])
def test_the_page_shows_the_reflectance(target):
    image, pixel = picture(target)
    left, top, width, height = target.sheet
    rng = np.random.default_rng(0)
    places = rng.uniform([left + 0.5, top + 4], [left + width - 0.5, top + height - 4], (2000, 2))
    around = places[:, None] + 0.2 * np.stack(np.meshgrid([-1, 0, 1], [-1, 0, 1]), axis=-1).reshape(-1, 2)
    value = target.reflectance(around, black=0.0)
    clear = np.ptp(value, axis=1) == 0  # off the rims
    column, row = np.round(pixel(places[clear])).astype(int).T
    shown = image[row, column]
    linear = np.where(shown > 0.04045, ((shown + 0.055) / 1.055) ** 2.4, shown / 12.92)  # sRGB
    assert clear.mean() > 0.5
    np.testing.assert_allclose(linear, value[clear, 4], atol=0.01)


def test_fold_marks_stay_off_the_dots():
    target, flat = TARGETS["vicalib_folded"], TARGETS["vicalib_small"]
    folded, plain = (draw_sheet(each).axes[0] for each in (target, flat))
    assert "fold here" in " ".join(text.get_text() for text in folded.texts)
    assert "fold" not in " ".join(text.get_text() for text in plain.texts)
    marks = [line.get_ydata() for line in folded.lines if np.all(line.get_xdata() == target.fold_x)]
    assert len(marks) == 2
    _, top, _, height = target.sheet
    for mark in marks:
        assert min(mark) >= top
        assert max(mark) <= top + height
        assert np.all((mark < -2.5) | (mark > target.points[:, 1].max() + 2.5))


@pytest.mark.parametrize("target", [*TARGETS.values(), *OTHERS, BIG, CircleGrid(2, 60, 4.0, radius=1.0)])
def test_words_lie_on_the_page_and_off_the_sheet(target):
    figure = draw_sheet(target)
    axes, renderer = figure.axes[0], FigureCanvasAgg(figure).get_renderer()
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    _x, y, _width, height = target.sheet
    boxes = []
    for text in axes.texts:
        (x0, y0), (x1, y1) = axes.transData.inverted().transform(text.get_window_extent(renderer))
        boxes.append((x0, x1, y1, y0))
        assert left + 2 < x0 < x1 < right - 2
        assert top + 2 < y1 < y0 < bottom - 2
        assert y0 < y or y1 > y + height
    for index, (a0, a1, b0, b1) in enumerate(boxes):
        assert all(a1 < c0 or c1 < a0 or b1 < d0 or d1 < b0 for c0, c1, d0, d1 in boxes[index + 1 :])


def test_the_ruler_measures_what_it_says_and_a_title_is_printed():
    axes = draw_sheet(TARGETS["vicalib_small"]).axes[0]
    lengths = [np.ptp(line.get_xdata()) for line in axes.lines]
    assert max(lengths) == pytest.approx(50, abs=1e-9)
    assert "50 mm" in " ".join(text.get_text() for text in axes.texts)
    assert "ward 7: 40 × 30 dots 9 mm apart" in draw_sheet(BIG, "ward 7").axes[0].texts[0].get_text()


@pytest.mark.parametrize("name", ["sheet.png", "sheet", "sheet.PDFX"])
def test_other_kinds_of_file_are_refused_and_a_folder_that_is_not_there_is_named(name, tmp_path):
    with pytest.raises(ValueError, match=r"\.pdf or \.svg"):
        write_sheet(BIG, tmp_path / name)
    assert not list(tmp_path.iterdir())
    with pytest.raises(OSError, match="cannot write"):
        write_sheet(TARGETS["circles"], tmp_path / "none" / "sheet.pdf")

"""The drawings: what is committed is what the code draws, and what is drawn is true."""

import re

import matplotlib
import numpy as np
import pytest

from endolab.plots import drawings, drawings_of_depth, pen
from tests.tools.draw_images import DRAWINGS, IMAGES, svg

MOST_BYTES = 60_000
RENDERER = "3.11"  # of matplotlib, which drew what is committed


def named(figure, name):
    """Places of the line that bears a name."""
    (line,) = [line for line in figure.axes[0].lines if line.get_gid() == name]
    return line.get_xydata()


def way(figure, name):
    """Direction of a straight line that bears a name."""
    places = named(figure, name)
    return pen.towards(places[0], places[-1])


def spread(figure, name, apex):
    """Angle that an arc spans about a place, degrees."""
    arc = named(figure, name)
    return pen.between(pen.towards(apex, arc[0]), pen.towards(apex, arc[-1]))


def skeleton(text):
    """Names and words of an SVG, which do not depend on how a version rounds."""
    return re.findall(r'<g id="([^"_]+)"|<!-- (.*?) -->|<title>(.*?)</title>', text)


@pytest.mark.parametrize("name", DRAWINGS)
def test_what_is_committed_is_what_the_code_draws(name):
    committed = (IMAGES / f"{name}.svg").read_text(encoding="utf-8")
    drawn = svg(DRAWINGS[name])
    assert skeleton(committed) == skeleton(drawn)
    assert len(skeleton(committed)) > 5
    if matplotlib.__version__.startswith(RENDERER):  # others may round and kern in their own way
        assert committed == drawn, 'drawn otherwise by now: "make drawings" renews it'


@pytest.mark.parametrize("name", DRAWINGS)
def test_a_drawing_is_small_has_a_title_and_bears_no_date(name):
    text = (IMAGES / f"{name}.svg").read_text(encoding="utf-8")
    assert len(text.encode()) <= MOST_BYTES
    assert re.search(r"<title>\w.{20,}</title>", text)
    assert "dc:date" not in text
    assert "<text" not in text  # fonts are outlines, as no page has ours


@pytest.mark.parametrize("name", DRAWINGS)
def test_no_word_leaves_the_page_or_covers_another(name):
    figure = DRAWINGS[name]()
    figure.canvas.draw()
    boxes = [text.get_window_extent() for text in figure.axes[0].texts]
    assert boxes
    for number, box in enumerate(boxes):
        assert figure.bbox.x0 <= box.x0
        assert box.x1 <= figure.bbox.x1
        assert figure.bbox.y0 <= box.y0
        assert box.y1 <= figure.bbox.y1
        assert not any(box.overlaps(other) for other in boxes[:number])


def test_the_angles_of_one_pixel_are_those_between_what_is_drawn():
    figure = drawings.pixel()
    eye, place = named(figure, "ray")
    light = named(figure, "way of the light")[1]
    normal, shines = way(figure, "normal"), way(figure, "where the lamp points")
    wall = named(figure, "wall")
    nearest = np.argmin(np.hypot(*(wall - place).T))
    along = pen.towards(wall[nearest - 1], wall[nearest + 1])
    assert np.hypot(*(wall - place).T).min() < 0.5
    assert abs(along @ normal) < np.sin(np.deg2rad(0.6))  # the wall is a polygon of half degrees
    angles = {
        "alpha": (eye, way(figure, "axis"), place - eye),
        "theta": (place, normal, eye - place),
        "theta of the lamp": (place, normal, light - place),
        "psi": (light, shines, place - light),
    }
    for name, (apex, first, second) in angles.items():
        assert spread(figure, name, apex) == pytest.approx(pen.between(first, second), abs=1e-6), name


def test_the_far_wall_tells_three_lights_less_from_one():
    lit = np.linspace(-15, 15, 31)
    near, far = (np.ptp(np.log(np.divide(*drawings.light_on(lit, d)))) for d in (drawings.NEAR, drawings.FAR))
    assert far < near / 5


def test_mirrored_light_obeys_the_law_of_the_mirror_and_no_way_crosses_a_wall():
    figure = drawings.bounces()
    wall = named(figure, "wall")
    light, shiny = named(figure, "mirrored 1")
    eye = named(figure, "mirrored 2")[1]
    normal = pen.normal_at(shiny, wall)
    to_light, to_eye = pen.towards(shiny, light), pen.towards(shiny, eye)
    assert pen.between(normal, to_light) == pytest.approx(pen.between(normal, to_eye), abs=1.5)
    assert pen.between(to_light, to_eye) > 1
    for name in (
        "straight 1",
        "straight 2",
        "bounced 1",
        "bounced 2",
        "bounced 3",
        "mirrored 1",
        "mirrored 2",
    ):
        start, end = named(figure, name)
        met = pen.hits(start, pen.towards(start, end), wall)
        inside = np.hypot(*(end - start)) - 0.05
        assert not any(0.05 < distance < inside for distance in met), name


def test_the_fold_hides_the_wall_between_the_pixels_that_part():
    figure = drawings_of_depth.fold()
    hidden, wall = named(figure, "hidden"), drawings_of_depth.folded_wall()
    before, after = named(figure, "ray -1"), named(figure, "ray 0")
    assert before[1, 0] <= hidden[0, 0] + 0.5
    assert after[1, 0] >= hidden[-1, 0] - 0.5
    for number in range(-5, 5):
        eye, place = named(figure, f"ray {number}")
        first = pen.hits(eye, pen.towards(eye, place), wall)[0]
        assert first == pytest.approx(np.hypot(*(place - eye)), abs=1e-6)
    middle = hidden[len(hidden) // 2]
    assert pen.hits(eye, pen.towards(eye, middle), wall)[0] < np.hypot(*(middle - eye)) - 5


def test_the_march_of_the_drawing_solves_the_equation_and_stays_too_near():
    angle = np.linspace(-0.5, 0.5, 2001)
    distance = 1 / np.cos(angle)  # of a plane: from its foot the march climbs both ways
    y = drawings_of_depth.marched(distance**2 / np.cos(angle), angle[1] - angle[0])
    np.testing.assert_allclose(y, distance**2, rtol=1e-3)
    figure = drawings_of_depth.fold()
    slid, (eye, beyond) = named(figure, "marched"), named(figure, "ray 2")
    ray = pen.towards(eye, beyond)
    there = slid[np.argmin([pen.between(ray, place - eye) for place in slid])]
    assert np.hypot(*(there - eye)) < 0.95 * np.hypot(*(beyond - eye))


def test_the_front_separates_what_is_final_from_what_is_untouched():
    row, column = np.indices((drawings_of_depth.ROWS, drawings_of_depth.COLUMNS)).astype(float)
    y, facing = drawings_of_depth.tilted_plane(column, row)
    final, beside = drawings_of_depth.states(y, drawings_of_depth.DONE)
    assert final.sum() == drawings_of_depth.DONE
    assert y[final].max() < y[~final].min()
    untouched = ~(final | beside)
    assert not (final[1:] & untouched[:-1]).any()
    assert not (final[:, 1:] & untouched[:, :-1]).any()
    assert (facing >= y).all()
    lowest = np.argmin(y)
    assert lowest == np.argmin(facing)
    assert facing.flat[lowest] == pytest.approx(y.flat[lowest], rel=1e-2)


def test_bump_and_dent_shade_alike_under_a_far_lamp_alone():
    bump, dent = (drawings_of_depth.relief(height) for height in (4.0, -4.0))
    far = [drawings_of_depth.shading(wall, near=False) for wall in (bump, dent)]
    near = [drawings_of_depth.shading(wall, near=True) for wall in (bump, dent)]
    np.testing.assert_allclose(*far, atol=1e-12)
    middle = len(bump) // 2
    assert near[0][middle] > 1.5 > 1 > near[1][middle]


def test_the_sheet_is_the_sheet_as_the_camera_projects_it():
    camera, target = (
        drawings_of_depth.CAMERA,
        drawings_of_depth.TARGETS["vicalib_small"],
    )
    turn, shift = drawings_of_depth.pose()
    np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)
    seen = target.points @ turn.T + shift
    assert seen[:, 2].min() > 0
    pixels = camera.project(seen)
    assert (pixels > 0).all()
    assert (pixels < [1439, 1079]).all()
    rims = drawings_of_depth.rims(target, 9)
    np.testing.assert_allclose(np.linalg.norm(rims - target.points[:, None], axis=-1).T[0], target.radii)
    assert len(np.unique(target.radii)) == 2

"""What an endoscope shows is found in a surround of any level; a wall that fills the picture has none."""

import cv2
import numpy as np
import pytest

import endolab as el
from endolab import datasets
from endolab.frames.surround import field_of_view, unclear_surround

HIGH = 360
WIDE = 480
BLUE = (20, 20, 160)


@pytest.fixture(scope="module")
def wall():
    """A colon that fills the picture, grey levels."""
    camera = el.Pinhole(WIDE, HIGH, 230.0, 230.0, 239.5, 179.5)
    light = datasets.load_calibration("paper", width=WIDE).photometry
    return 255 * el.render(el.SCENES["colon"], camera, light, bits=8, texture=0.1).image


def shape(name):
    row, column = np.indices((HIGH, WIDE), dtype=float)
    down = np.abs(row - (HIGH - 1) / 2)
    across = np.abs(column - (WIDE - 1) / 2)
    if name == "disc":
        return np.hypot(across, down) < 165
    if name == "cut disc":
        return np.hypot(across, down) < 215
    if name == "octagon":
        return (across < 225) & (down < 170) & (across + down < 300)
    # Rounded rectangle.
    return np.hypot(np.maximum(across - 150, 0), np.maximum(down - 90, 0)) < 75


def framed(wall, inside, level, rng, noise=0.0, soft=0.0, jpeg=False, draw=None):
    """A wall in a surround of one colour with an edge that is `soft` px wide; text and boxes drawn on it."""
    around = np.full(wall.shape, level, dtype=np.uint8)
    share = inside.astype(float)
    if soft:
        share = cv2.GaussianBlur(share, (0, 0), soft / 2)
    if draw is not None:
        draw(around)
    image = share[..., None] * wall + (1 - share[..., None]) * around
    image += (
        rng.normal(size=image.shape)
        * np.where(inside, min(noise, 3.0), noise)[..., None]
    )
    stored = np.clip(np.round(image), 0, 255).astype(np.uint8)
    if jpeg:
        stored = cv2.imdecode(
            cv2.imencode(".jpg", stored, (cv2.IMWRITE_JPEG_QUALITY, 75))[1],
            cv2.IMREAD_COLOR,
        )
    return stored / 255


def assert_found(image, inside, soft=0.0):
    """Nearly nothing of the surround is taken for wall, and of the wall little more than its edge is lost."""
    shown = field_of_view(image)
    depth = cv2.distanceTransform(
        np.pad(inside, 1, mode="edge").astype(np.uint8), cv2.DIST_L2, 5
    )[1:-1, 1:-1]
    assert (shown & ~inside).sum() <= 0.004 * shown.sum()
    assert (~shown & (depth > 4 + soft)).sum() <= 0.02 * inside.sum()


@pytest.mark.parametrize("level", [0, 4, 8, 16, 32, 64, 128, 200, 255, BLUE])
@pytest.mark.parametrize("name", ["disc", "cut disc", "octagon", "rounded"])
def test_a_surround_of_any_level_is_left_out(wall, rng, name, level):
    inside = shape(name)
    assert_found(framed(wall, inside, level, rng), inside)


@pytest.mark.parametrize("level", [0, 16, 255])
@pytest.mark.parametrize(
    ("noise", "soft", "jpeg"),
    [(3, 0, False), (8, 2, True), (13, 0, False), (0, 6, False), (3, 6, True)],
)
def test_noise_soft_edges_and_codecs_do_not_hide_it(
    wall, rng, level, noise, soft, jpeg
):
    inside = shape("disc")
    assert_found(framed(wall, inside, level, rng, noise, soft, jpeg), inside, soft)


def text(image):
    for line, words in enumerate(("NAME J D", "12/04/26", "ID 0042")):
        cv2.putText(
            image,
            words,
            (6, 30 + 22 * line),
            cv2.FONT_HERSHEY_SIMPLEX,
            0.4,
            (230, 230, 230),
            1,
        )


def column(image):
    image[:, :50] = (60, 60, 90)
    text(image)


def scale_bar(image):
    cv2.line(image, (440, 60), (440, 300), (230, 230, 230), 2)


def corner_box(image):
    image[300:, :60] = (200, 120, 30)


def bars(image):
    image[:, :30] = 0
    image[:, -30:] = 0


@pytest.mark.parametrize("draw", [text, column, scale_bar, corner_box, bars])
@pytest.mark.parametrize("level", [0, 16, 128])
def test_what_is_drawn_on_the_surround_belongs_to_it(wall, rng, draw, level):
    inside = shape("disc")
    assert_found(framed(wall, inside, level, rng, draw=draw), inside)


@pytest.mark.parametrize("level", [0, 16, 64, 200])
def test_a_dark_wall_at_the_edge_stays(wall, rng, level):
    """By and by it becomes as dark as a surround, and darker."""
    row, column = np.indices((HIGH, WIDE))
    away = np.clip((np.hypot(row - 250, column - 350) - 40) / 60, 0, 1)
    dark = np.maximum(wall * away[..., None] ** 1.5, (11, 9, 8))
    inside = shape("disc")
    assert_found(framed(dark, inside, level, rng, noise=1.0), inside)


def test_a_picture_that_a_wall_fills_has_no_surround(wall):
    row, column = np.indices((HIGH, WIDE))
    vignette = (
        np.clip(1 - np.hypot(row - 180, column - 240) / 300, 0, 1)[..., None] ** 2
    )
    for picture in (
        wall,
        wall * vignette,
        np.minimum(3 * wall * vignette[::-1, ::-1] ** 0.2, 255),
    ):
        assert field_of_view(np.round(picture) / 255).all()
    plane = np.round(250 - 0.5 * column) / 255
    assert field_of_view(plane).all()


def test_a_mask_that_keeps_a_crescent_of_the_surround_loses_it(wall, rng):
    inside = shape("disc")
    shifted = np.roll(inside, -40, axis=1)
    frame = el.Frame(framed(wall, inside, 16, rng), shifted)
    assert (frame.pixels_to_use() & ~inside).sum() <= 0.004 * inside.sum()
    assert frame.pixels_to_use().sum() > 0.94 * (inside & shifted).sum()
    assert frame.misplaced == pytest.approx(
        (shifted & ~inside).sum() / shifted.sum(), abs=0.03
    )
    assert el.Frame(frame.image, inside).misplaced == 0


@pytest.mark.parametrize(("soft", "named"), [(0.0, False), (0.47, True), (1.0, False)])
def test_a_surround_that_is_unsure_is_kept_and_named(soft, named):
    """The wall fades into a surround of 16 along a share of the rim, as shading does."""
    light = datasets.load_calibration("paper", width=WIDE).photometry
    calibration = el.Calibration(el.Pinhole(240, 180, 200.0, 200.0, 119.5, 89.5), light)
    seen = el.render(el.SCENES["tube"], calibration.camera, light, bits=8)
    row, column = np.indices((180, 240))
    away = 85 - np.hypot(row - 89.5, column - 119.5)
    fades = np.abs(np.arctan2(row - 89.5, column - 119.5)) < soft * np.pi
    share = np.where(fades, np.clip(away / 70, 0, 1) ** 2, away > 0)
    image = 16 / 255 + (seen.image - 16 / 255) * share[..., None]
    frame = el.Frame(np.clip(image, 0, 1), np.ones_like(seen.mask))
    assert frame.pixels_to_use().all() == (soft > 0)
    assert unclear_surround(frame.image, frame.pixels_to_use()) == named


def test_a_picture_of_few_pixels_has_no_surround():
    """In one of 12 x 9 px each pixel has edges; half of a tube's wall was taken for a surround."""
    known = el.load_calibration("simple", width=12)
    tube = el.render(el.SCENES["tube"], known.camera, known.photometry).image
    assert field_of_view(tube).all()
    assert not unclear_surround(tube, np.ones(tube.shape[:2], bool))

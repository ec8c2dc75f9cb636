"""What an endoscope shows is found in a surround of any level; a wall that fills the picture has none."""

import cv2
import numpy as np
import pytest

import endolab as el
from endolab.frames.surround import field_of_view, surround_doubts

HIGH = 360
WIDE = 480
BLACK = (0, 0, 0)
ROW, COLUMN = np.indices((HIGH, WIDE))
DOWN = np.abs(ROW - (HIGH - 1) / 2)
ACROSS = np.abs(COLUMN - (WIDE - 1) / 2)
DISC = np.hypot(ACROSS, DOWN) < 165
SHAPES = {
    "disc": DISC,
    "cut disc": np.hypot(ACROSS, DOWN) < 215,
    "octagon": (ACROSS < 225) & (DOWN < 170) & (ACROSS + DOWN < 300),
    "small octagon": (ACROSS < 168) & (DOWN < 168) & (ACROSS + DOWN < 240),
    "third": np.hypot(ACROSS, DOWN) < 75,
    "aside": np.hypot(COLUMN - 130, ROW - 140) < 75,
    "rounded": np.hypot(np.maximum(ACROSS - 150, 0), np.maximum(DOWN - 90, 0)) < 75,
}


@pytest.fixture(scope="module")
def wall():
    """A colon that fills the picture, grey levels."""
    camera = el.Pinhole(WIDE, HIGH, 230.0, 230.0, 239.5, 179.5)
    light = el.load_calibration("paper", width=WIDE).photometry
    return 255 * el.render(el.SCENES["colon"], camera, light, bits=8, texture=0.1).image


def surrounded(wall, inside, around, soft=0.0):
    """A wall in a surround, or a level, with an edge that is `soft` px wide, grey levels."""
    share = inside.astype(float)
    if soft:
        share = cv2.GaussianBlur(share, (0, 0), soft / 2)
    return np.round(around + share[..., None] * (wall - around))


def assert_found(levels, inside, soft=0):
    """Nearly nothing of the surround is taken for wall, and of the wall little more than its edge is lost."""
    shown = field_of_view(np.clip(levels, 0, 255) / 255)
    reach = (9 + 2 * soft,) * 2
    edge = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, reach)
    deep = cv2.erode(inside.astype(np.uint8), edge) > 0
    assert (shown & ~inside).sum() <= 0.004 * shown.sum()
    assert (deep & ~shown).sum() <= 0.02 * inside.sum()


def show(
    wall,
    rng,
    level,
    shape="disc",
    fades=False,
    boxes=(),
    text=(),
    size=0.4,
    soft=0,
    noise=0.0,
    quality=None,
):
    """A wall, which may fade, in a surround with boxes and text; noise, and the marks of a codec."""
    inside = SHAPES[shape]
    if fades:  # by and by as dark as a surround, and darker
        away = np.clip((np.hypot(ROW - 250, COLUMN - 350) - 40) / 60, 0, 1)
        wall = np.maximum(wall * away[..., None] ** 1.5, (11, 9, 8))
    around = np.full(wall.shape, level, np.uint8)
    for *box, colour in boxes:
        cv2.rectangle(around, box, colour, cv2.FILLED)
    for place in text:
        font = cv2.FONT_HERSHEY_SIMPLEX
        cv2.putText(around, "12/04/26", place, font, size, (230,) * 3)
    image = surrounded(wall, inside, around, soft)
    if quality is None:
        return image
    image += np.where(inside, min(noise, 3), noise)[..., None] * rng.normal(
        size=wall.shape
    )
    grey_levels = np.uint8(np.clip(np.round(image), 0, 255))
    jpeg = cv2.imencode(".jpg", grey_levels, (cv2.IMWRITE_JPEG_QUALITY, quality))[1]
    return cv2.imdecode(jpeg, cv2.IMREAD_COLOR)


TOP_LEFT = {"text": [(6, 30), (6, 52), (6, 74)]}
CORNERS = [(x, y) for x in (0, WIDE - 90) for y in (0, HIGH - 30)]
IN_CORNERS = {"shape": "small octagon", "size": 0.6}
IN_CORNERS["text"] = [(x + 2, y + 14) for x, y in CORNERS]
SHOWN = {
    **{shape: {"shape": shape} for shape in SHAPES},
    "noise": {"noise": 3, "quality": 100},
    "a codec": {"noise": 8, "soft": 2, "quality": 75},
    "more noise": {"noise": 13, "quality": 100},
    "soft": {"soft": 6, "quality": 100},
    "soft, a codec": {"noise": 3, "soft": 6, "quality": 75},
    "text": TOP_LEFT,
    "column": TOP_LEFT | {"boxes": [(0, 0, 50, HIGH, (60, 60, 90))]},
    "scale bar": TOP_LEFT | {"boxes": [(439, 60, 2, 240, (230, 230, 230))]},
    "corner": TOP_LEFT | {"boxes": [(0, 300, 60, 60, (200, 120, 30))]},
    "bars": TOP_LEFT | {"boxes": [(x, 0, 30, HIGH, BLACK) for x in (0, WIDE - 30)]},
    "fading": {"fades": True, "noise": 1, "quality": 100},
    "text in corners": IN_CORNERS,
    "boxes in corners": IN_CORNERS
    | {"boxes": [(*corner, 90, 30, (50, 80, 200)) for corner in CORNERS]},
}


@pytest.mark.parametrize("name", SHOWN)
def test_a_surround_of_any_level_is_left_out_and_the_wall_stays(wall, rng, name):
    how = SHOWN[name]
    for level in (0, 4, 8, 16, 32, 64, 128, 200, 255, (20, 20, 160)):
        image = show(wall, rng, level, **how)
        assert_found(image, SHAPES[how.get("shape", "disc")], how.get("soft", 0))


def test_a_picture_that_a_wall_fills_has_no_surround(wall):
    fall = np.clip(1 - np.hypot(ROW - 180, COLUMN - 240) / 300, 0, 1)[..., None]
    lit_aside = np.minimum(3 * wall * fall[::-1, ::-1] ** 0.4, 255)
    # In one of 12 x 9 px each pixel has edges; half of a tube was taken for a surround.
    known = el.load_calibration("simple", width=12)
    few = 255 * el.render(el.SCENES["tube"], known.camera, known.photometry).image
    for picture in (wall, wall * fall**2, lit_aside, 250 - 0.5 * COLUMN, few):
        assert field_of_view(np.round(picture) / 255).all()
    assert not any(surround_doubts(few / 255, np.ones(few.shape[:2], bool)))


def test_of_two_fields_one_is_taken_and_both_are_named(wall):
    one, other = (np.hypot(COLUMN - at, DOWN) < 105 for at in (120, 359))
    image = surrounded(wall, one | other, 8)
    shown = field_of_view(image / 255)
    assert surround_doubts(image / 255, shown) == (False, True)
    assert (
        min((shown & one).sum(), (shown & other).sum())
        == 0
        < 0.9 * one.sum()
        < shown.sum()
    )


def test_a_mask_that_keeps_a_crescent_of_the_surround_loses_it(wall):
    shifted = np.roll(DISC, -40, axis=1)
    frame = el.Frame(surrounded(wall, DISC, 16) / 255, shifted)
    used = frame.selection.pixels
    assert (used & ~DISC).sum() <= 0.004 * DISC.sum()
    assert used.sum() > 0.94 * (DISC & shifted).sum()
    beyond = (shifted & ~DISC).sum() / shifted.sum()
    assert frame.selection.misplaced == pytest.approx(beyond, abs=0.03)
    assert el.Frame(frame.image, DISC).selection.misplaced == 0
    tenth = DISC & (ROW < 76)
    assert el.Frame(frame.image, tenth).selection.shown_share == pytest.approx(
        tenth.sum() / DISC.sum(), abs=0.02
    )


@pytest.mark.parametrize(("soft", "named"), [(0.0, False), (0.47, True), (1.0, False)])
def test_a_surround_that_is_unsure_is_kept_and_named(soft, named):
    """The wall fades into a surround of 16 along a share of the rim, as shading does."""
    light = el.load_calibration("paper", width=WIDE).photometry
    camera = el.Pinhole(240, 180, 200.0, 200.0, 119.5, 89.5)
    image = 255 * el.render(el.SCENES["tube"], camera, light, bits=8).image
    row, column = np.indices(image.shape[:2])
    away = 85 - np.hypot(row - 89.5, column - 119.5)
    fades = np.abs(np.arctan2(row - 89.5, column - 119.5)) < soft * np.pi
    share = np.where(fades, np.clip(away / 70, 0, 1) ** 2, away > 0)
    levels = 16 + (image - 16) * share[..., None]
    frame = el.Frame(levels / 255, np.ones(row.shape, bool))
    assert frame.selection.pixels.all() == (soft > 0)
    assert surround_doubts(frame.image, frame.selection.pixels) == (named, False)

"""Draw the vector figures of notebooks and README, and write them to notebooks/images.

`python -m tests.tools.draw_images` writes all of them: the same bytes on each run.
"""

import re
from collections.abc import Callable
from io import BytesIO
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure

from tests.tools import drawings, drawings_of_depth

IMAGES = Path(__file__).resolve().parents[2] / "notebooks" / "images"
DRAWINGS: dict[str, Callable[[], Figure]] = {
    draw.__name__: draw
    for draw in (
        *(drawings.pixel, drawings.lights, drawings.bounces),
        *(drawings_of_depth.fold, drawings_of_depth.front, drawings_of_depth.bump_and_dent),
        drawings_of_depth.sheet,
    )
}
DIGITS = {"sheet": 1}  # of places in points, for its hundreds of dots; elsewhere 2
NUMBERS = re.compile(r'( d="|translate\(| [xy]=")([^")]*)')


def svg(draw: Callable[[], Figure]) -> str:
    """A drawing as SVG: text as outlines, no date, and places to a hundredth of a point or so."""
    digits = DIGITS.get(draw.__name__, 2)
    with matplotlib.rc_context({"svg.hashsalt": draw.__name__, "svg.fonttype": "path"}):
        into = BytesIO()
        draw().savefig(into, format="svg", metadata={"Date": None, "Creator": None, "Title": title(draw)})
    return NUMBERS.sub(lambda match: match[1] + _shorter(match[2], digits), into.getvalue().decode())


def title(draw: Callable[[], Figure]) -> str:
    """What a drawing shows, in a sentence."""
    return (draw.__doc__ or "").splitlines()[0].rstrip(".")


def _shorter(places: str, digits: int) -> str:
    """Places in fewer letters; along a path of lines alone, a place without a letter is a line, too."""
    rounded = re.sub(r"-?\d+\.\d+", lambda number: f"{float(number[0]):.{digits}f}", places)
    return rounded if re.search("[CQ]", rounded) else re.sub(r"\s*\n(L )?", " ", rounded)


def main() -> None:
    """Write every drawing."""
    for name, draw in DRAWINGS.items():
        text = svg(draw)
        (IMAGES / f"{name}.svg").write_text(text, encoding="utf-8")
        print(f"{name}.svg: {len(text.encode()) / 1000:.0f} kB")


if __name__ == "__main__":
    main()

"""Draw the vector figures of notebooks and README into notebooks/images: the same bytes on each run."""

from io import BytesIO
from pathlib import Path

import matplotlib

from endolab.plots.style import house
from tests.tools import drawings, drawings_of_depth

IMAGES = Path(__file__).resolve().parents[2] / "notebooks" / "images"
DRAWINGS = (
    *(drawings.pixel, drawings.lights, drawings.bounces),
    *(drawings_of_depth.fold, drawings_of_depth.front, drawings_of_depth.bump_and_dent),
    drawings_of_depth.sheet,
)


def svg(draw):
    """A drawing as SVG: text as outlines, no date."""
    title = draw.__doc__.splitlines()[0].rstrip(".")
    into = BytesIO()
    with house(), matplotlib.rc_context({"svg.hashsalt": draw.__name__, "svg.fonttype": "path"}):
        draw().savefig(into, format="svg", metadata={"Date": None, "Creator": None, "Title": title})
    return into.getvalue()


if __name__ == "__main__":
    for draw in DRAWINGS:
        (IMAGES / f"{draw.__name__}.svg").write_bytes(svg(draw))

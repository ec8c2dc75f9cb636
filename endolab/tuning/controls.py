"""What the tuner's knobs are made of."""

from collections.abc import Callable, Sequence
from typing import Any

import ipywidgets as w

FULL = {"width": "auto", "min_width": "0"}
STYLE = {"description_width": "74px"}


def choice(label: str, options: Sequence[Any], tip: str = "", **value: Any) -> w.Dropdown:
    """One of some options, the first one unless there is a `value`."""
    how = {"description": label, "tooltip": tip, "layout": FULL, "style": STYLE}
    return w.Dropdown(options=options, **how, **value)


def slider(label: str, value: float, low: float, high: float, step: float, tip: str) -> w.FloatSlider:
    """A number between two others."""
    how = {"description": label, "tooltip": tip, "layout": FULL, "style": STYLE}
    return w.FloatSlider(value, min=low, max=high, step=step, **how)


def log_slider(label: str, value: float, low: float, high: float, tip: str) -> w.FloatLogSlider:
    """A number between two powers of ten."""
    how = {"description": label, "tooltip": tip, "readout_format": ".2g", "layout": FULL, "style": STYLE}
    return w.FloatLogSlider(value, min=low, max=high, step=0.05, **how)


def line(label: str, hint: str, tip: str) -> w.Text:
    """A line that may stay empty, read when it is done."""
    how = {"description": label, "tooltip": tip, "layout": FULL, "style": STYLE}
    return w.Text(placeholder=hint, continuous_update=False, **how)


def button(label: str, tip: str, action: Callable[..., object]) -> w.Button:
    """A button as wide as its name."""
    made = w.Button(description=label, tooltip=tip, layout=w.Layout(width="auto"))
    made.on_click(action)
    return made


def group(name: str, knobs: Sequence[w.Widget]) -> w.VBox:
    """Knobs below a heading."""
    heading = w.HTML(f"<b>{name}</b>", layout=w.Layout(margin="2px 0 0 4px"))
    return w.VBox([heading, *knobs], layout=w.Layout(min_width="0", overflow="visible"))


def numbers(text: str, name: str, count: int, separator: str = ",") -> tuple[float, ...] | None:
    """So many numbers of a line, or None of an empty one; ValueError, in one sentence, otherwise."""
    if not text.strip():
        return None
    try:
        found = tuple(float(one) for one in text.split(separator))
    except ValueError:
        found = ()
    if len(found) != count:
        expected = "a number" if count == 1 else f"{count} numbers with commas between"
        raise ValueError(f"{name}: expected {expected}, found {text!r}")
    return found


def close_parts(widget: w.Widget) -> None:
    """Close all that a widget is made of: Jupyter keeps what is open, and with it all that it knows."""
    parts = [
        *getattr(widget, "children", ()),
        getattr(widget, "layout", None),
        getattr(widget, "style", None),
    ]
    for part in parts:
        if isinstance(part, w.Widget):
            close_parts(part)
            part.close()

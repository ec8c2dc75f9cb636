"""What the tuner is made of: choices, sliders, and a picture that can be pointed at."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import anywidget
import ipywidgets as w
import traitlets as t

THIRD = w.Layout(width="32%", min_width="240px")


def choice(label: str, options: Sequence[Any], value: Any = None) -> w.Dropdown:
    """One of some options, the first one by default."""
    first = options[0][1] if isinstance(options[0], tuple) else options[0]
    return w.Dropdown(
        options=options, value=first if value is None else value, description=label, layout=THIRD
    )


def slider(label: str, value: float, low: float, high: float, step: float, tip: str) -> w.FloatSlider:
    """A number between two others."""
    return w.FloatSlider(value, min=low, max=high, step=step, description=label, tooltip=tip, layout=THIRD)


def log_slider(label: str, value: float, low: float, high: float, tip: str) -> w.FloatLogSlider:
    """A number between two powers of ten."""
    return w.FloatLogSlider(
        value, min=low, max=high, step=0.05, description=label, tooltip=tip,
        readout_format=".2g", layout=THIRD,
    )  # fmt: skip


# Lives in the page. Jupyter holds a change back while the kernel still works on the last one, and then
# sends the latest only: a drag builds up no queue.
SCRIPT = """
function render({ model, el }) {
  const add = (tag, name) => {
    const made = el.appendChild(document.createElement(tag));
    made.className = name;
    return made;
  };
  const lost = add("div", "endolab-lost");
  lost.textContent = "The kernel that drew this is gone: run the cell again.";
  const caption = add("div", "endolab-caption"), image = add("img", "endolab-picture");
  image.draggable = false;
  let url, held;
  const show = () => {
    const old = url;
    url = URL.createObjectURL(new Blob([model.get("value")], { type: "image/jpeg" }));
    image.src = url;
    if (old) URL.revokeObjectURL(old);
  };
  const name = () => { caption.textContent = image.alt = model.get("caption"); };
  const place = ({ clientX, clientY }) => {
    const box = image.getBoundingClientRect();
    return [(clientX - box.left) / box.width, (clientY - box.top) / box.height];
  };
  const spotAt = ([x, y]) => model.get("spots").find(
    ([left, top, right, bottom]) => left <= x && x <= right && top <= y && y <= bottom);
  const clip = (share) => Math.min(Math.max(share, 0), 1);
  const tell = (event) => {
    const [x, y] = place(event), [left, top, right, bottom] = held;
    const at = [clip((x - left) / (right - left)), clip((y - top) / (bottom - top))];
    model.set("point", [...at, event.timeStamp]);  // the time, so that a second click is a change too
    model.save_changes();
  };
  image.onpointerdown = (event) => {
    held = event.button === 0 ? spotAt(place(event)) : undefined;
    if (!held) return;
    event.preventDefault();
    image.setPointerCapture(event.pointerId);
    tell(event);
  };
  image.onpointermove = (event) => {
    if (held) tell(event);
    else image.style.cursor = spotAt(place(event)) ? "crosshair" : "";
  };
  image.onpointerup = image.onpointercancel = () => { held = undefined; };
  model.on("change:value", show);
  model.on("change:caption", name);
  show();
  name();
  return () => {
    model.off("change:value", show);
    model.off("change:caption", name);
    URL.revokeObjectURL(url);
  };
}
export default { render };
"""
# Jupyter marks widgets that have lost their kernel with this class.
STYLE = """
.endolab-picture { display: block; width: 100%; touch-action: pan-y; }
.endolab-caption { min-height: 0; font-weight: bold; }
.endolab-lost { display: none; color: #C0392B; }
.jupyter-widgets-disconnected .endolab-lost { display: block; }
"""


class Pointed(anywidget.AnyWidget):
    """A JPEG with a caption, on parts of which one can click and drag.

    Attributes
    ----------
    value : bytes
        The JPEG.
    caption : str
    spots : list of four floats each
        The parts: left, top, right, bottom, as shares of the picture in [0, 1].
    point : list of three floats
        Where the pointer last was in the part where it was pressed: to the right and down, as
        shares of the part in [0, 1], and when; empty before.
    """

    _esm, _css = SCRIPT, STYLE
    value = t.Bytes().tag(sync=True)
    caption = t.Unicode().tag(sync=True)
    spots: t.List[Any] = t.List().tag(sync=True)
    point: t.List[Any] = t.List().tag(sync=True)

"""What the tuner is made of: choices and sliders, and its two pictures, which can be pointed at."""

import threading
from collections.abc import Callable, Sequence
from typing import Any

import anywidget
import ipywidgets as w
import traitlets as t

from endolab.tuning.engine import Outcome
from endolab.tuning.panels import Cut, Shared, contrast, error_of, limits_of, outcome_board, spots
from endolab.tuning.pictures import jpeg

THIRD = {"width": "32%", "min_width": "240px"}


def choice(label: str, options: Sequence[Any], **value: Any) -> w.Dropdown:
    """One of some options, the first one unless there is a `value`."""
    return w.Dropdown(options=options, description=label, layout=THIRD, **value)


def slider(label: str, value: float, low: float, high: float, step: float, tip: str) -> w.FloatSlider:
    """A number between two others."""
    return w.FloatSlider(value, min=low, max=high, step=step, description=label, tooltip=tip, layout=THIRD)


def log_slider(label: str, value: float, low: float, high: float, tip: str) -> w.FloatLogSlider:
    """A number between two powers of ten."""
    how = {"description": label, "tooltip": tip, "readout_format": ".2g", "layout": THIRD}
    return w.FloatLogSlider(value, min=low, max=high, step=0.05, **how)


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


ALONE = {"flex": "0 1 1176px", "min_width": "0"}
BESIDE = {"flex": "1 1 370px", "min_width": "0", "max_width": "784px"}  # one below the other if narrow
HIDDEN = {"display": "none"}


class Pair(w.HBox):
    """What is shown now and, if there is one, A: side by side, of one size, with the same limits.

    `cut` tells where the section lies, `third` what the third panel shows.
    """

    def __init__(self, cut: Callable[[], Cut], third: Callable[[], str]) -> None:
        self.shown: Outcome | None = None
        self.kept: Outcome | None = None  # A
        self.picture, self.picture_kept = Pointed(), Pointed()
        # The page follows a new layout of a box; a picture of one's own would keep its first.
        self._now, self._a = w.VBox([self.picture], layout=ALONE), w.VBox([self.picture_kept], layout=HIDDEN)
        self._now.add_class("endolab-now")
        self._a.add_class("endolab-kept")
        self._cut, self._third = cut, third
        self._drawing = threading.RLock()  # the solver's thread shows, the kernel's moves the section
        super().__init__([self._a, self._now], layout=w.Layout(flex_flow="row wrap", grid_gap="0 8px"))

    def show(self, outcome: Outcome, said: Callable[[], object] | None = None) -> None:
        """Draw an outcome; `said` is called when it is drawn, before it is sent."""
        with self._drawing:
            content = self._drawn(outcome)
            self.shown = outcome
            if said is not None:
                said()
            self._name()
            self.picture.spots = spots(outcome, self._columns)
            self.picture.value = content

    def redraw(self) -> None:
        """Draw both again, with another section."""
        with self._drawing:
            if self.kept is not None:
                self.picture_kept.spots = spots(self.kept, self._columns)
                self.picture_kept.value = self._drawn(self.kept)
            if self.shown is not None:
                self.show(self.shown)

    def keep(self) -> Outcome:
        """Make A of what is shown; ValueError if nothing is."""
        with self._drawing:
            if self.shown is None:
                raise ValueError("there is no result to keep yet")
            self.kept = self.shown
            self.redraw()
            self._now.layout, self._a.layout = BESIDE, BESIDE
            return self.kept

    def drop(self) -> None:
        """Forget A."""
        with self._drawing:
            self.kept = None
            self._now.layout, self._a.layout = ALONE, HIDDEN
            self.redraw()

    def limits(self, outcome: Outcome) -> Shared | None:
        """Limits of A, if there is one and it shows the same scene."""
        kept = self.kept
        return None if kept is None or kept.settings.scene != outcome.settings.scene else limits_of(kept)

    @property
    def _columns(self) -> int:
        return 3 if self.kept is None else 2  # two boards of half the width remain readable

    def _drawn(self, outcome: Outcome) -> bytes:
        limits = self.limits(outcome)
        return jpeg(outcome_board(outcome, self._cut(), limits, self._columns, self._third()))

    def _name(self) -> None:
        """Say what each is, and how they differ."""
        now, kept, caption = self.shown, self.kept, ""
        if now is not None and kept is not None:
            self.picture_kept.caption = f"A: {contrast(kept.settings, now.settings)} · {error_of(kept)}"
            caption = f"B (now): {contrast(now.settings, kept.settings)} · {error_of(now)}"
        self.picture.caption = caption


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
    """A JPEG with a caption, on parts of which one can click and drag."""

    _esm, _css = SCRIPT, STYLE
    value = t.Bytes().tag(sync=True)
    caption = t.Unicode().tag(sync=True)
    # The parts: left, top, right, bottom, as shares of the picture in [0, 1].
    spots: t.List[Any] = t.List().tag(sync=True)
    # Where the pointer last was in the part where it was pressed: to the right and down, as shares of
    # the part in [0, 1], and when; empty before.
    point: t.List[Any] = t.List().tag(sync=True)

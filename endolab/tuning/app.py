"""The tuner as an app: one frame, or the frames of a folder, one after the other."""

from __future__ import annotations

import html
from pathlib import Path
from typing import Any

import anywidget
import ipywidgets as w

from endolab.io.descriptions import Calibration
from endolab.io.images import read_frame
from endolab.numerics.arrays import FloatArray
from endolab.preprocessing.frame import Frame
from endolab.tuning.widget import tune

# N and P, wherever no text is typed: arrows belong to the slider in focus.
SCRIPT = """
function render({ model }) {
  const steps = { n: 1, p: -1 };
  const press = (event) => {
    const step = steps[event.key];
    const typing = event.target.matches("select, textarea, input, [contenteditable=true]");
    if (!step || typing || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    model.send({ step });
  };
  document.addEventListener("keydown", press);
  return () => document.removeEventListener("keydown", press);
}
export default { render };
"""


class _Keys(anywidget.AnyWidget):
    """Tells which way a key goes."""

    _esm = SCRIPT


class App(w.VBox):
    """The tuner, and above it, if there is more than one frame, what leads from one to the next.

    `first` is the frame to begin with, which is read already. `tuner` is what `tune` makes.
    """

    def __init__(
        self,
        pictures: list[Path],
        calibration: Calibration,
        first: Frame,
        truth: FloatArray | None = None,
        **how: Any,
    ) -> None:
        self.pictures, self._calibration = pictures, calibration
        self.tuner = tune(first, calibration, truth, **how)
        self.index = 0
        parts: list[w.Widget] = [self.tuner]
        if len(pictures) > 1:
            parts.insert(0, self._make_switch())
        super().__init__(parts)
        self.add_class("endolab-app")

    def _make_switch(self) -> w.HBox:
        def button(label: str, tip: str, step: int) -> w.Button:
            made = w.Button(description=label, tooltip=tip, layout=w.Layout(width="auto"))
            made.on_click(lambda _: self.go(self.index + step))
            return made

        names = [
            (f"{path.name} ({i + 1} of {len(self.pictures)})", i) for i, path in enumerate(self.pictures)
        ]
        self.chosen = w.Dropdown(options=names, value=0, layout=w.Layout(width="auto", max_width="45%"))
        self.chosen.observe(lambda change: self.go(change["new"]), "value")
        self.said = w.HTML()
        self.pressed = _Keys(layout=w.Layout(display="none"))
        self.pressed.on_msg(lambda _, content, __: self.go(self.index + int(content.get("step", 0))))
        back = button("◀ previous", "the frame before: key P", -1)
        forth = button("next ▶", "the frame after: key N", 1)
        row = w.HBox([back, self.chosen, forth, self.said, self.pressed])
        row.layout.align_items = "center"
        row.add_class("endolab-frames")
        return row

    def go(self, index: int) -> None:
        """Look at another frame; one that cannot be used is passed by with a sentence, and the last stays."""
        index = min(max(index, 0), len(self.pictures) - 1)
        if index == self.index:
            return
        self.index, self.chosen.value = index, index
        try:
            self.tuner.look_at(read_frame(self.pictures[index], self._calibration))
        except (OSError, ValueError, MemoryError) as error:
            said = f"{str(error).splitlines()[0]}: the frame before is still shown."
            self.said.value = f'<span style="color: #C0392B">{html.escape(said)}</span>'
            return
        self.said.value = ""

    def close(self) -> None:
        """Close the tuner, and end its threads."""
        if hasattr(self, "tuner"):
            self.tuner.close()
        super().close()

"""Films: figures drawn beforehand, through which a slider and ▶ go, in a notebook as in its page."""

import base64
import inspect
import io
import itertools
import json
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from IPython.display import HTML
from matplotlib import pyplot
from matplotlib.backends.backend_agg import FigureCanvasAgg

SLIDER = """<label style="flex: 1; display: flex; gap: 6px">{name}
<input type="range" max="{last}" value="{first}" style="flex: 1">
<output style="min-width: 4em"></output></label>"""
PAGE = """<div style="max-width: {width}px; font: 14px sans-serif">
<img alt="film" style="max-width: 100%; background: white">
<div style="display: flex; gap: 14px"><button style="width: 3em">▶</button>{sliders}</div></div>
<script>{script}(document.currentScript.previousElementSibling, {labels}, {pictures});</script>"""
SCRIPT = """((host, labels, pictures) => {
  const sliders = [...host.querySelectorAll("input")], button = host.querySelector("button");
  const show = () => {
    let number = 0;
    sliders.forEach((slider, i) => {
      number = number * labels[i].length + slider.valueAsNumber;
      slider.nextElementSibling.textContent = labels[i][slider.value];
    });
    host.firstElementChild.src = "data:image/webp;base64," + pictures[number];
  };
  let playing = 0;
  const stop = () => { playing = clearInterval(playing); button.textContent = "▶"; };
  const step = () => {
    if (sliders[0].value === sliders[0].max) return stop();
    sliders[0].valueAsNumber += 1;
    show();
  };
  button.onclick = () => {
    if (playing) return stop();
    if (sliders[0].value === sliders[0].max) sliders[0].value = 0;
    button.textContent = "❚❚";
    playing = setInterval(step, 150);
    show();
  };
  sliders.forEach((slider) => { slider.oninput = show; });
  show();
})"""


GREEK = {"beta": "β", "gamma": "γ", "omega": "ω"}


def film(
    draw: Callable[..., object], **positions: Iterable[Any] | Mapping[str, Any]
) -> HTML:
    """Make a film of what a function draws, one figure for each position of its sliders.

    Parameters
    ----------
    draw : callable
        Draws a new figure with Matplotlib's pyplot for the values of the sliders; its defaults, if
        it has any, are shown at first.
    **positions : iterable of values, or mapping of names to values
        A slider, with a Greek letter where its name is one's; ▶ moves the first.

    Returns
    -------
    HTML
        What a notebook shows. The pictures lie in it, so that they follow the hand and no kernel is needed.
    """
    sliders = {
        name: values
        if isinstance(values, Mapping)
        else {f"{one:.4g}" if isinstance(one, float) else str(one): one for one in values}
        for name, values in positions.items()
    }
    pictures = []
    places: list[Any] = []  # of axes
    for given in itertools.product(*(slider.values() for slider in sliders.values())):
        draw(**dict(zip(sliders, given, strict=True)))
        figure = pyplot.gcf()
        figure.set_dpi(100)
        if len(places) != len(figure.axes):
            figure.draw_without_rendering()
            places = [ax.get_position(original=True) for ax in figure.axes]
        # As in the one before, so that nothing jumps; to lay each out anew takes half of the time.
        figure.set_layout_engine("none")
        for ax, place in zip(figure.axes, places, strict=True):
            ax.set_position(place)
        stream = io.BytesIO()
        quick: Any = {"quality": 80, "method": 0}
        FigureCanvasAgg(figure).print_webp(
            stream, pil_kwargs=quick
        )  # `savefig` draws twice
        pyplot.close(figure)
        pictures.append(base64.b64encode(stream.getvalue()).decode())
    usual = inspect.signature(draw).parameters
    parts = []
    for name, slider in sliders.items():
        values = list(slider.values())
        first = values.index(usual[name].default) if usual[name].default in values else 0
        shown = GREEK.get(name, name)
        parts.append(SLIDER.format(name=shown, last=len(values) - 1, first=first))
    labels = json.dumps([list(slider) for slider in sliders.values()])
    return HTML(
        PAGE.format(
            width=round(100 * figure.get_figwidth()),
            sliders="".join(parts),
            script=SCRIPT,
            labels=labels.replace("</", "<\\/"),
            pictures=json.dumps(pictures),
        )
    )

"""What a page shows of controls, where no kernel is behind it; kernels that run for pages have this first.

A slider becomes pictures of a few of its positions, the tuner what it shows first and a strip of λ, a
recording some of its steps, to be chosen from by HTML alone. What the page draws by itself, such as a
surface, it still draws, from numbers that lie in it.
"""

import base64
import html
import io
import itertools
import json
import zlib
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import ipywidgets
import numpy as np
from IPython import get_ipython
from IPython.display import HTML, display
from IPython.utils.capture import capture_output

import endolab

MOST = 5  # pictures to choose from
STRIP = (0.01, 0.1, 1.0, 10.0)  # times the tuner's λ
PATIENCE = 120.0  # s, for the tuner's answer
# A widget's own script, and a model for it that knows no kernel. Arrays come packed, all else as it is.
ALIVE = """<div class="endolab-alive" id="%(name)s">%(still)s</div>
<style>%(style)s</style>
<script type="module">
const place = document.getElementById("%(name)s"), heard = {}, state = %(state)s;
for (const [name, packed] of Object.entries(%(packed)s)) {
  const bytes = Uint8Array.from(atob(packed), (letter) => letter.charCodeAt(0));
  const plain = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  state[name] = new DataView(await new Response(plain).arrayBuffer());
}
const model = {
  get: (name) => state[name],
  set: (name, value) => { state[name] = value; heard[`change:${name}`]?.forEach((told) => told()); },
  on: (name, told) => { (heard[name] ??= []).push(told); },
  off: () => {},
  save_changes: () => {},
};
const script = new Blob([%(script)s], { type: "text/javascript" });
const { default: widget } = await import(URL.createObjectURL(script));
if (!%(webgl)s || document.createElement("canvas").getContext("webgl2")) {
  place.replaceChildren();
  widget.render({ model, el: place });
}
</script>
"""
_serial = itertools.count()


def chosen_from(name: str, pieces: Sequence[tuple[str, str]], first: int = 0) -> str:
    """HTML of one of several pieces of HTML, which are chosen by their labels."""
    group, parts = f"endolab-{next(_serial)}", []
    for i, (label, _) in enumerate(pieces):
        checked = " checked" if i == first else ""
        parts.append(f'<input type="radio" name="{group}" id="{group}-{i}"{checked}>')
        parts.append(f'<label for="{group}-{i}">{html.escape(label)}</label>')
    shown = "".join(f"<div>{piece}</div>" for _, piece in pieces)
    named = f"<b>{html.escape(name)}</b>" if name else ""
    return f'<div class="endolab-chosen">{named}{"".join(parts)}<div>{shown}</div></div>'


def piece(content: str) -> str:
    """HTML that is a thing by itself: a slide may take it, and another one the next."""
    return f'<div class="endolab-piece">{content}</div>'


def embedded(content: bytes, kind: str, alt: str = "") -> str:
    """HTML of a picture, "png" or "jpeg", that lies in the page."""
    data = base64.b64encode(content).decode()
    return f'<img src="data:image/{kind};base64,{data}" alt="{html.escape(alt)}">'


def alive(widget: Any, still: str = "", webgl: bool = False) -> str:
    """HTML in which a widget's own script draws it as it is now; until it does, a still."""
    state, packed = {}, {}
    for name, trait in widget.traits(sync=True).items():
        value = trait.get(widget)
        if isinstance(value, bytes):
            packed[name] = base64.b64encode(zlib.compress(value, 9)).decode()
        elif isinstance(value, int | float | str | list) and not name.startswith("_"):
            state[name] = value
    texts = {"state": state, "packed": packed, "script": str(widget._esm)}
    inside = {name: json.dumps(text).replace("</", "<\\/") for name, text in texts.items()}
    more = {"name": f"endolab-{next(_serial)}", "still": still, "style": str(widget._css)}
    return ALIVE % (inside | more | {"webgl": json.dumps(webgl)})


def spread(count: int, own: int) -> list[int]:
    """Numbers below a count: its ends and some between them, their nearest replaced by one of them."""
    if count <= MOST:
        return list(range(count))
    found = np.round(np.linspace(0, count - 1, MOST)).astype(int)
    inner = found[1:-1] if 0 < own < count - 1 else found
    inner[np.argmin(np.abs(inner - own))] = own
    return found.tolist()


def positions(control: Any) -> tuple[list[tuple[str, Any]], int]:
    """What a control can be set to, a few of it, each by its name; and which of them it is set to."""
    if hasattr(control, "options"):
        every = list(zip(control._options_labels, control._options_values, strict=True))
        own = control.index
    elif hasattr(control, "step"):
        count = 1 + round((control.max - control.min) / control.step)
        values = [control.min + i * control.step for i in range(count)]
        every = [(f"{value:.6g}", value) for value in values]
        own = int(np.argmin([abs(value - control.value) for value in values]))
        every[own] = (every[own][0], control.value)
    else:
        return [(str(control.value), control.value)], 0
    kept = spread(len(every), own)
    return [every[i] for i in kept], kept.index(own)


def as_html(shown: Any) -> str:
    """HTML of what a function has printed and displayed."""
    pieces = []
    if shown.stdout:
        pieces.append(f"<pre>{html.escape(shown.stdout)}</pre>")
    for output in shown.outputs:
        picture = output.data.get("image/png")
        if picture is not None:
            content = base64.b64decode(picture) if isinstance(picture, str) else picture
            pieces.append(embedded(content, "png"))
        else:
            told = f"<pre>{html.escape(output.data.get('text/plain', ''))}</pre>"
            pieces.append(output.data.get("text/html", told))
    return "".join(pieces)


def at(control: Any) -> str:
    """Where a control stands, in words."""
    value = control.label if hasattr(control, "label") else control.value
    return (
        f"{control.description} = {value:.6g}"
        if isinstance(value, float)
        else f"{control.description} = {value}"
    )


def interact(*functions: Callable[..., Any], **sliders: Any) -> Any:
    """In place of ipywidgets' own: pictures for some positions of the first slider, or choice."""

    def shown(function: Callable[..., Any]) -> Callable[..., Any]:
        made = ipywidgets.interactive(function, {"manual": True}, **sliders)
        controls = made.kwargs_widgets
        moved = next((one for one in controls if "Slider" in type(one).__name__), controls[0])
        places, own = positions(moved)
        usual = {control._kwarg: control.get_interact_value() for control in controls}
        pieces = []
        for label, value in places:
            with capture_output() as captured:
                result = function(**usual | {moved._kwarg: value})
                if result is not None:
                    display(result)
            pieces.append((label, as_html(captured)))
        rest = ", ".join(at(control) for control in controls if control is not moved)
        note = f"<small>Here with {html.escape(rest)}.</small>" if rest else ""
        display(HTML(chosen_from(f"{moved.description} =", pieces, own) + note))
        return function

    return shown(functions[0]) if functions else shown


def of_recording(recording: Any, **_: Any) -> None:
    """In place of `endolab.show`: a few of the steps of each run of a recording."""
    from endolab.recording import show

    path = getattr(recording, "path", recording)
    kept = endolab.read_recording(path)
    if not kept.runs:
        show.show(path)
        return
    steps = sorted({k for run in kept.runs.values() for k in run.pictured})
    pieces = []
    wished = (steps[-1] + 1) ** np.linspace(0, 1, MOST) - 1  # news comes early in a run
    for k in sorted({min(steps, key=lambda k: abs(k - wish)) for wish in wished}):
        content = io.BytesIO()
        show.picture_of(kept, k).savefig(content, format="png")
        pieces.append((str(k), embedded(content.getvalue(), "png", f"iteration {k}")))
    note = f"<small>The viewer has all {len(steps)} steps that were pictured.</small>"
    display(HTML(chosen_from("iteration", pieces, len(pieces) - 1) + note))


def of_tuner(box: Any) -> str:
    """HTML of the tuner's answer, and of those to other λ."""
    from endolab.tuning.boards import of_one
    from endolab.tuning.panels import Cut, View, limits_of
    from endolab.tuning.pictures import Look, jpeg
    from endolab.tuning.sentences import error_of, summary

    now = box.engine.wait(PATIENCE)
    if now.result is None:
        return f"<p>{html.escape(now.error or '')}</p>"
    said = html.escape(summary(now).partition(" · solved in")[0])
    board = embedded(jpeg(box.screen.picture()), "jpeg", said)
    view, strip = View(Cut(), Look(0.9, bars=False), limits_of(now)), []
    for times in STRIP:
        asked = replace(now.settings, lam=now.settings.lam * times)
        outcome = now if times == 1 else box.engine.cold(asked)
        named = html.escape(f"λ = {asked.lam:g}: {error_of(outcome)}")
        picture = embedded(jpeg(of_one(outcome, ("section", "normals"), view, 1).picture), "jpeg", named)
        strip.append(f"<figure><figcaption>{named}</figcaption>{picture}</figure>")
    return piece(f"<p><small>{said}</small></p>{board}") + piece(
        f'<div class="endolab-row">{"".join(strip)}</div>'
    )


def of_surface(view: Any) -> str:
    """HTML of a surface, to be turned there as well."""
    return alive(view, embedded(view.still(), "png", "the surface, from the side"), webgl=True)


def install() -> None:
    """Have a kernel show these."""
    ipywidgets.interact = interact
    endolab.show = of_recording
    formatter = get_ipython().display_formatter.formatters["text/html"]
    for module, name, made in (
        ("endolab.tuning.widget", "TunerBox", of_tuner),
        ("endolab.tuning.surface_view", "SurfaceView", of_surface),
    ):
        formatter.for_type_by_name(module, name, made)

"""What a page shows of sliders without a kernel: pictures of a few positions, chosen by HTML alone.

Kernels that run for pages call `install` first.
"""

import base64
import html
import itertools

import ipywidgets
import numpy as np
from IPython.display import HTML, display
from IPython.utils.capture import capture_output

MOST = 5  # positions of a slider; page.html.j2 has tabs for one more, its own
_serial = itertools.count()


def chosen_from(name, pieces, first):
    """HTML of one of several labelled pieces of HTML, which are chosen by their labels."""
    group = f"endolab-{next(_serial)}"
    parts = []
    for i, (label, _) in enumerate(pieces):
        checked = " checked" if i == first else ""
        parts.append(f'<input type="radio" name="{group}" id="{group}-{i}"{checked}>')
        parts.append(f'<label for="{group}-{i}">{html.escape(label)}</label>')
    shown = "".join(f"<div>{piece}</div>" for _, piece in pieces)
    return f'<div class="endolab-chosen"><b>{html.escape(name)}</b>{"".join(parts)}<div>{shown}</div></div>'


def positions(control):
    """A few of the values of a control, each with its name, and which of them it is set to."""
    if hasattr(control, "options"):
        every = list(zip(control._options_labels, control._options_values, strict=True))
        own = control.index
    else:
        values = np.arange(
            control.min, control.max + control.step / 2, control.step
        ).tolist()
        every = [(f"{value:.6g}", type(control.value)(value)) for value in values]
        own = int(np.argmin(np.abs(np.array(values) - control.value)))
    kept = sorted(
        {
            own,
            *np.linspace(0, len(every) - 1, min(MOST, len(every))).astype(int).tolist(),
        }
    )
    return [every[i] for i in kept], kept.index(own)


def as_html(shown):
    """HTML of what a function has printed and displayed."""
    pieces = [f"<pre>{html.escape(shown.stdout)}</pre>"] if shown.stdout else []
    for output in shown.outputs:
        picture = output.data.get("image/png")
        if picture is not None:
            content = (
                base64.b64encode(picture).decode()
                if isinstance(picture, bytes)
                else picture
            )
            pieces.append(f'<img src="data:image/png;base64,{content}">')
        else:
            plain = f"<pre>{html.escape(output.data.get('text/plain', ''))}</pre>"
            pieces.append(output.data.get("text/html", plain))
    return "".join(pieces)


def interact(**sliders):
    """In place of ipywidgets' own: pictures for some positions of the first slider, or choice."""

    def shown(function):
        controls = ipywidgets.interactive(
            function, {"manual": True}, **sliders
        ).kwargs_widgets
        moved = next(
            (one for one in controls if "Slider" in type(one).__name__), controls[0]
        )
        usual = {control._kwarg: control.get_interact_value() for control in controls}
        places, own = positions(moved)
        pieces = []
        for label, value in places:
            with capture_output() as captured:
                result = function(**usual | {moved._kwarg: value})
                if result is not None:
                    display(result)
            pieces.append((label, as_html(captured)))
        rest = ", ".join(
            f"{one.description} = {one.value}" for one in controls if one is not moved
        )
        note = f"<small>Here with {html.escape(rest)}.</small>" if rest else ""
        display(HTML(chosen_from(f"{moved.description} =", pieces, own) + note))
        return function

    return shown


def install():
    """Have a kernel show these positions."""
    ipywidgets.interact = interact

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


def positions(control):
    """A few of the values of a control, each with its name, and the name of the one it is set to."""
    if hasattr(control, "options"):
        every = list(zip(control._options_labels, control._options_values, strict=True))
        own = control.index
    else:
        values = np.arange(control.min, control.max + control.step / 2, control.step)
        every = [(f"{v:.6g}", type(control.value)(v)) for v in values.tolist()]
        own = int(np.argmin(np.abs(values - control.value)))
    few = np.linspace(0, len(every) - 1, min(MOST, len(every))).astype(int).tolist()
    return [every[i] for i in sorted({own, *few})], every[own][0]


def as_html(shown):
    """HTML of what a function has printed and displayed."""
    pieces = [f"<pre>{html.escape(shown.stdout)}</pre>"] if shown.stdout else []
    for output in shown.outputs:
        picture = output.data.get("image/png")
        if picture is not None:
            if isinstance(picture, bytes):
                picture = base64.b64encode(picture).decode()
            pieces.append(f'<img src="data:image/png;base64,{picture}">')
        else:
            plain = f"<pre>{html.escape(output.data.get('text/plain', ''))}</pre>"
            pieces.append(output.data.get("text/html", plain))
    return "".join(pieces)


def interact(**sliders):
    """In place of ipywidgets' own: pictures for some positions of the first slider."""

    def shown(function):
        box = ipywidgets.interactive(function, {"manual": True}, **sliders)
        controls = box.kwargs_widgets
        is_slider = ["Slider" in type(one).__name__ for one in controls]
        moved = controls.pop(is_slider.index(True))
        usual = {one._kwarg: one.get_interact_value() for one in controls}
        places, own = positions(moved)
        group = f"endolab-{next(_serial)}"
        tabs = []
        pieces = []
        for label, value in places:
            with capture_output() as captured:
                result = function(**usual, **{moved._kwarg: value})
                if result is not None:
                    display(result)
            tab = f"{group}-{len(pieces)}"
            checked = " checked" if label == own else ""
            tabs.append(f'<input type="radio" name="{group}" id="{tab}"{checked}>')
            tabs.append(f'<label for="{tab}">{html.escape(label)}</label>')
            pieces.append(f"<div>{as_html(captured)}</div>")
        name = html.escape(f"{moved.description} =")
        held = ", ".join(f"{one.description} = {one.value}" for one in controls)
        note = f"<small>Here with {html.escape(held)}.</small>" if held else ""
        page = f"<b>{name}</b>{''.join(tabs)}<div>{''.join(pieces)}</div>"
        display(HTML(f'<div class="endolab-chosen">{page}</div>{note}'))
        return function

    return shown


def install():
    """Have a kernel show these positions."""
    ipywidgets.interact = interact

"""Notebooks that somebody else wrote, in which a script waits to be run when they are opened."""

import json
from pathlib import Path

QUICKSTART = Path(__file__).resolve().parents[2] / "notebooks" / "00_quickstart.ipynb"
TAKEN = "window.takenOver = (window.takenOver || 0) + 1;"
WIDGET = {  # as ipywidgets keeps them; its front end fetches and runs what stands in _esm
    "model_module": "anywidget",
    "model_module_version": "~0.9.*",
    "model_name": "AnyModel",
    "state": {
        "_anywidget_id": "foreign.Widget",
        "_esm": f"{TAKEN} export default {{ initialize() {{ {TAKEN} }}, render() {{ {TAKEN} }} }};",
        "_model_module": "anywidget",
        "_model_module_version": "~0.9.*",
        "_model_name": "AnyModel",
        "_view_module": "anywidget",
        "_view_module_version": "~0.9.*",
        "_view_name": "AnyView",
    },
}
STATE = {"version_major": 2, "version_minor": 0, "state": {"w": WIDGET}}
OUTPUTS = {
    "script": {
        "text/html": f"<b>an output</b><script>{TAKEN}</script><img src=x onerror='{TAKEN}'>"
    },
    "javascript": {"application/javascript": TAKEN},
    "svg": {
        "image/svg+xml": f"<svg xmlns='http://www.w3.org/2000/svg' onload='{TAKEN}'></svg>"
    },
    "widget": {
        "application/vnd.jupyter.widget-view+json": {"model_id": "w", "version_major": 2}
    },
}


def foreign_notebooks():
    """Their contents by their names."""

    def cell(data):
        output = {
            "output_type": "display_data",
            "data": data | {"text/plain": "an output"},
            "metadata": {},
        }
        how = {"execution_count": None, "metadata": {"trusted": True}}
        return {"cell_type": "code", "id": "a", "source": "1", "outputs": [output], **how}

    def copy():
        return json.loads(QUICKSTART.read_text(encoding="utf-8"))

    names = {
        "02_foreign.ipynb": copy(),
        "00_quickstart_again.ipynb": copy(),
        "03_widgets.ipynb": copy(),
    }
    names["02_foreign.ipynb"]["cells"] = [
        cell(data) | {"id": name} for name, data in OUTPUTS.items()
    ]
    first = next(
        cell
        for cell in names["00_quickstart_again.ipynb"]["cells"]
        if cell["cell_type"] == "code"
    )
    first["outputs"] = cell(OUTPUTS["script"])["outputs"]
    names["03_widgets.ipynb"]["metadata"]["widgets"] = {
        "application/vnd.jupyter.widget-state+json": STATE
    }
    return names

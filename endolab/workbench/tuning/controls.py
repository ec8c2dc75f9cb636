"""The tuner's controls: one for each option of a reconstruction, and some of its own.

`knobs.json` says how those are labelled and what their handles reach that a hand turns often, in order; any
other option is a line to type into, or a choice, as `Settings` describes it.
"""

import json
from pathlib import Path
from typing import Any, get_args

from endolab.reconstruction.settings import Settings, option_types


def knob_specs() -> list[dict[str, Any]]:
    """Return what the page needs of each control, in order."""
    layout = Path(__file__).with_name("knobs.json")
    specs = json.loads(layout.read_text(encoding="utf-8"))
    derived = _derived_specs()
    named = [derived.pop(spec["name"], {}) | {"hidden": False} | spec for spec in specs]
    return [*named, *derived.values()]


def _derived_specs() -> dict[str, dict[str, Any]]:
    """Return the controls that follow from `Settings`, by their names."""
    specs: dict[str, dict[str, Any]] = {}
    for name, kind in option_types().items():
        if name == "known_diameter":  # no line can hold it
            continue
        spec: dict[str, Any] = {
            "name": name,
            "label": name.replace("_", " "),
            "tip": "",
            "hidden": True,
        }
        parts = [part for one in (kind, *get_args(kind)) for part in get_args(one)]
        choices: list[Any] = [part for part in parts if isinstance(part, str)]
        if bool in parts:
            choices = [["yes", True], ["no", False]]
        if choices:
            automatic = [["auto", None]] if getattr(Settings, name) is None else []
            spec["options"] = [*automatic, *choices]
        specs[name] = spec
    return specs

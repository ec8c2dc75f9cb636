"""The tuner's controls: one for each option of a reconstruction, and some of its own.

`knobs.json` says how those are labelled and what their handles reach that a hand turns often, in order; any
other option is a line to type into, or a choice, as `Settings` describes it.
"""

import json
from pathlib import Path
from typing import Any

from endolab.reconstruction.settings import DIAMETER, MAP, SWITCH, option_fields


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
    for part in option_fields():
        facts = part.metadata["option"]
        if facts.kind in (MAP, DIAMETER):  # no line can hold them
            continue
        spec: dict[str, Any] = {
            "name": part.name,
            "label": part.name.replace("_", " "),
            "tip": facts.help,
            "hidden": True,
        }
        automatic = [["auto", None]] if part.default is None else []
        if facts.kind == SWITCH:
            spec["options"] = [["auto", None], ["yes", True], ["no", False]]
        elif facts.choices:
            spec["options"] = [*automatic, *facts.choices]
        else:
            spec["hint"] = facts.form
        specs[part.name] = spec
    return specs

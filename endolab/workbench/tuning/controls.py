"""The tuner's controls: `knobs.json` says how they are labelled, what they offer and how far they reach."""

import json
from pathlib import Path
from typing import Any


def knob_specs() -> list[dict[str, Any]]:
    """Return what the page needs of each control, in order."""
    layout = Path(__file__).with_name("knobs.json").read_text(encoding="utf-8")
    specs: list[dict[str, Any]] = json.loads(layout)
    return specs

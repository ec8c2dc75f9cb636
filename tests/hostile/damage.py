"""Strategies: what can befall the content of a file."""

import io
import json

import numpy as np
from hypothesis import strategies as st

ODD = (None, True, "", "\ud800", "x" * 3000, -1, 0, 0.5, 1e308, -1e-320, 10**400)
ODD += ([], {}, [1, 2], {"a": 1})


@st.composite
def damaged_bytes(draw, path):
    """Bytes that are cut off, flipped, or there twice."""
    damaged = bytearray(path.read_bytes())
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(damaged)))
        end = start + draw(st.integers(1, 64))
        match draw(st.sampled_from(["cut", "flip", "repeat"])):
            case "cut":
                del damaged[start:]
            case "flip":
                mask = draw(st.integers(1, 255))
                damaged[start:end] = bytes(value ^ mask for value in damaged[start:end])
            case "repeat":
                damaged[start:start] = damaged[start:end]
    return bytes(damaged)


@st.composite
def damaged_json(draw, path):
    """A document in which one value is another, or missing, or of another name."""
    document = place = json.loads(path.read_bytes())
    while True:
        keys = list(place) if isinstance(place, dict) else range(len(place))
        key = draw(st.sampled_from(keys))
        below = place[key]
        if not isinstance(below, dict | list) or not below or draw(st.booleans()):
            break
        place = below
    place[key] = draw(st.sampled_from(ODD))
    if isinstance(place, dict) and draw(st.booleans()):
        name = draw(st.sampled_from(["", "endolab", "gain ", "x" * 3000]))
        place[name] = place.pop(key)
    return json.dumps(document).encode()


@st.composite
def damaged_arrays(draw, path):
    """An archive in which an array has other numbers, another shape, or another kind, or is missing."""
    with np.load(path) as archive:
        arrays = dict(archive)
    name = draw(st.sampled_from(sorted(arrays)))
    values = arrays.pop(name)
    odd = [values[..., None], np.array(3), np.array("text"), np.array([{}], object)]
    if values.dtype.kind != "U":
        odd += [values.astype(complex), values * np.nan, values * np.float32(-1e30)]
    changed = draw(st.sampled_from([None, *odd]))
    saved = io.BytesIO()
    np.savez(saved, **arrays, **({} if changed is None else {name: changed}))
    return saved.getvalue()

"""Files as JSON would hold them: JSON itself, YAML, XML, NumPy's .npz, and rows of words."""

from __future__ import annotations

import io
import json
import re
from contextlib import suppress
from typing import Any
from xml.etree import ElementTree

import numpy as np

from endolab.io.atomic import PathLike, read_bytes
from endolab.numerics.checks import shorten

ROWS = "rows of words"  # key of a file that holds nothing else
INI = ".ini"  # likewise, of what is not read


def read_document(path: PathLike) -> Any:
    """Read a file by its content, whatever it is called; None is of a file of no such kind.

    Nothing in it is run or constructed: there are numbers, text, lists, and objects by name. Rows of words
    are under the key `ROWS`. Where text is not in Unicode, what is not ASCII becomes "?". OSError or
    ValueError in one sentence, if it cannot be read.
    """
    content = read_bytes(path, "calibration file")
    kind = "text"
    try:
        if content.startswith(b"PK\3\4"):
            kind = "NumPy's .npz"
            with np.load(io.BytesIO(content), allow_pickle=False) as archive:
                found = {}
                for name in archive.files:
                    with suppress(ValueError):  # Python's objects, which are left alone
                        found[name] = archive[name].tolist()
                return found
        text = _decode(content).lstrip("\ufeff \t\r\n")
        lines = [line for line in text.splitlines() if not re.match(r"\s*(#|$)", line)]
        if text.startswith("<"):
            kind = "XML"
            top = ElementTree.fromstring(text)
            return {top.tag: _values(top)}
        if any(re.match(r"\[[A-Za-z]\w*\]\s*$", line) for line in lines):
            return {INI: None}
        if text.startswith(("{", "[")):
            kind = "JSON"
            return json.loads(text)
        if lines and all(re.match(r"\s*[-+.\d][^\s,;]*[\s,;]+\S", line) for line in lines):
            words = [re.findall(r"[^\s,;]+", line) for line in lines]
            return {ROWS: [[_as_number(word) for word in row] for row in words]}
        kind = "YAML"
        return _read_yaml(text)
    except Exception as error:  # packages promise nothing about which, if a file is damaged
        if kind == "text" or (kind == "YAML" and not str(path).endswith((".yaml", ".yml"))):
            return None
        reason = shorten(str(error), 300)
        raise ValueError(f"{path}: not valid {kind}: {reason}") from error


def _decode(content: bytes) -> str:
    encoding = json.detect_encoding(content)
    try:
        return content.decode(encoding)
    except UnicodeDecodeError:
        # The second byte of a letter in two, or a letter after one in one; no bracket or quotation mark.
        return re.sub(
            rb"[\x80-\xff][\x40-\x5a\\\x61-\x7a\x80-\xff]?", b"?", content
        ).decode()


def _as_number(word: str) -> float | str:
    try:
        return float(word)
    except ValueError:
        return word


def _read_yaml(text: str) -> Any:
    """Read the first document of YAML 1.1 or 1.2, or of OpenCV's dialect."""
    import yaml

    class Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
        """Also takes 1e-5 for a number, and OpenCV's matrices for objects."""

    number = re.compile(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+$")
    Loader.add_implicit_resolver("tag:yaml.org,2002:float", number, list("-+0123456789"))
    for tag in ("opencv-matrix", "opencv-nd-matrix"):
        Loader.add_constructor(f"tag:yaml.org,2002:{tag}", Loader.construct_yaml_map)
    text = re.sub(r"^%YAML[^\n]*", "", text)
    text = re.sub(r"^(\s*data):\[", r"\1: [", text, flags=re.MULTILINE)  # as ORB-SLAM's own
    return next(iter(yaml.load_all(text, Loader)), None)


def _values(element: ElementTree.Element) -> Any:
    """Return an element as JSON would hold it.

    That is its type and its children, of which several of one name are a list, or numbers: of
    `[ a; b; … ]`, `a b …`, or one.
    """
    if len(element):
        values: dict[str, Any] = {"type": element.get("type")}
        for name in dict.fromkeys(child.tag for child in element):
            found = [_values(child) for child in element.findall(name)]
            values[name] = found[0] if len(found) == 1 else found
        return values
    text = (element.text or "").strip()
    numbers = [_as_number(word) for word in re.split(r"[\s;,]+", text.strip("[] \t\r\n"))]
    if any(isinstance(number, str) for number in numbers):
        return text
    return numbers[0] if len(numbers) == 1 else numbers

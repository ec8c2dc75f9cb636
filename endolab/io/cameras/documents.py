"""Files as JSON would hold them: JSON itself, YAML, XML, MATLAB's arrays, and rows of words."""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from endolab.io.atomic import PathLike, read_bytes
from endolab.model.schema import shorten

MOST_BYTES = 10_000_000  # of any file; a calibration has some kB
MOST_TEXT = 1_000_000  # of YAML and XML, whose readers take a hundred times that
ROWS = "rows of words"  # key of a file that holds nothing else


def read_document(path: PathLike) -> Any:
    """Read a file by its content, whatever it is called.

    Nothing in it is run or constructed: there are numbers, text, lists, and objects by name. Rows of words
    are under the key `ROWS`; None is of a file of no such kind. OSError or ValueError in one sentence, if it
    cannot be read.
    """
    source = Path(path)
    content = read_bytes(path, "calibration file", MOST_BYTES)
    kind = "MAT-file"
    try:
        if content.startswith(b"MATLAB"):
            return _plain(_read_mat(content), {})
        try:
            text = content.decode(json.detect_encoding(content))
        except UnicodeDecodeError:
            return None
        kind, read = _kind_of(text)
        return _plain(read(text), {})
    except Exception as error:  # packages promise nothing about which, if a file is damaged
        is_named = source.suffix.lower() in (".yaml", ".yml")
        if kind == "YAML" and not is_named:
            return None
        # YAML's has several lines.
        mark = getattr(error, "problem_mark", None)
        what = str(getattr(error, "problem", None) or error)
        where = f" in line {mark.line + 1}" if mark else ""
        raise ValueError(
            f"{source}: not valid {kind}: {shorten(what, 300)}{where}"
        ) from error


def _kind_of(text: str) -> tuple[str, Callable[[str], Any]]:
    """Say what a text is, and what reads it."""
    text = text.lstrip("\ufeff \t\r\n")
    if text.startswith("<"):
        return "XML", _read_xml
    if text.startswith(("{", "[")) and "'lensmodel'" not in text:
        return "JSON", lambda text: json.loads(text.removeprefix("\ufeff"))
    rows = [line.split() for line in text.splitlines() if not re.match(r"\s*(#|$)", line)]
    if rows and all(len(row) > 1 and re.fullmatch(r"[-+.\d]\S*", row[0]) for row in rows):
        return "table", lambda _: {
            ROWS: [[_as_number(word) for word in row] for row in rows]
        }
    return "YAML", _read_yaml


def _plain(value: Any, seen: dict[int, Any]) -> Any:
    """Return a value as JSON would hold it; what is none of JSON's is text."""
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, dict | list | tuple):
        # Else a short file can be exponentially large, or endless.
        if id(value) in seen:
            raise ValueError("an anchor is used again")
        seen[id(value)] = value
    if isinstance(value, dict):
        return {str(name): _plain(part, seen) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(part, seen) for part in value]
    return value if isinstance(value, str | int | float | None) else str(value)


def _as_number(word: str) -> float | str:
    try:
        return float(word)
    except ValueError:
        return word


# Formats -------------------------------------------------------------------------------
def _check_length(text: str) -> None:
    if len(text) > MOST_TEXT:
        raise ValueError(f"expected at most {MOST_TEXT / 1e6:g} MB")


def _read_yaml(text: str) -> Any:
    """Read the first document of YAML 1.1 or 1.2, of OpenCV's dialect, or a Python dictionary of mrcal's."""
    import yaml

    class Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
        """Also takes 1e-5 for a number, and OpenCV's matrices for objects."""

    number = re.compile(r"[-+]?\d+(\.\d*)?[eE][-+]?\d+$")
    Loader.add_implicit_resolver("tag:yaml.org,2002:float", number, list("-+0123456789"))
    for tag in ("opencv-matrix", "opencv-nd-matrix"):
        Loader.add_constructor(f"tag:yaml.org,2002:{tag}", Loader.construct_yaml_map)
    _check_length(text)
    text = re.sub(r"^\ufeff?%YAML[^\n]*", "", text)
    text = re.sub(r"b'[^']*'", "''", text)  # mrcal's inputs
    return next(iter(yaml.load_all(text, Loader)), None)


def _read_xml(text: str) -> dict[str, Any]:
    """Read the outermost element; document types and entities can blow up in memory or open other files."""
    _check_length(text)
    if re.search(r"<!(DOCTYPE|ENTITY)", text, re.IGNORECASE):
        raise ValueError("a document type or entities are not read")
    top = ElementTree.fromstring(text.lstrip("\ufeff \t\r\n"))
    return {top.tag: _values(top)}


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
    words = re.split(r"\s*[;,]\s*|\s+", text.removeprefix("[").removesuffix("]").strip())
    numbers = [_as_number(word) for word in words]
    if any(isinstance(number, str) for number in numbers):
        return text
    return numbers[0] if len(numbers) == 1 else numbers


def _read_mat(content: bytes) -> dict[str, Any]:
    """Read the variables of a MAT-file, structs as objects by name."""
    from scipy.io import loadmat

    if content.startswith(b"MATLAB 7.3"):
        raise ValueError('version 7.3 is not read; save(…, "-v7") writes one that is')
    with warnings.catch_warnings(action="ignore"):
        variables = loadmat(BytesIO(content), simplify_cells=True)
    if "__function_workspace__" in variables:
        raise ValueError(
            "it holds an object, which only MATLAB reads; save what toStruct makes of it"
        )
    return {name: value for name, value in variables.items() if name[:2] != "__"}

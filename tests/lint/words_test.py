"""Names of the code say what they are of; the README is one page."""

import ast
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
NO_NAMES = {"told", "said", "judged"}  # which only tell that they tell
# A function is named by a verb or by what it returns; these are quantities, and a decorator.
PARTICIPLES = {"shown", "pictured", "checked", "explained", "left"}
IRREGULAR = {
    "found",
    "kept",
    "held",
    "seen",
    "made",
    "begun",
    "drawn",
    "known",
    "given",
    "taken",
    "left",
    "shown",
    "told",
    "said",
    "sent",
    "built",
    "written",
    "hidden",
    "grown",
    "chosen",
}


def nodes(*folders):
    """All that the code of folders is made of."""
    for folder in folders:
        for path in (ROOT / folder).rglob("*.py"):
            yield from ast.walk(ast.parse(path.read_text(encoding="utf-8")))


def test_the_readme_is_one_page():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    assert len(text.split()) <= 1000
    assert len(text.splitlines()) <= 130


def test_no_name_only_tells_that_it_tells():
    fields = ("id", "attr", "arg", "name")
    names = [
        getattr(node, field, None)
        for node in nodes("endolab", "tests")
        for field in fields
    ]
    assert NO_NAMES.isdisjoint(names)


def test_functions_are_verbs_or_what_they_return():
    functions = [node for node in nodes("endolab") if isinstance(node, ast.FunctionDef)]
    words = {node.name.strip("_") for node in functions}
    is_participle = {
        word
        for word in words
        if "_" not in word and (word in IRREGULAR or word.endswith("ed"))
    }
    assert is_participle - {"embed", "need"} == PARTICIPLES

"""Every notebook ends in what it rests on, and that is what REFERENCES.bib says of it."""

import json
import re
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).resolve().parents[1] / "notebooks").glob("*.ipynb"))
BIBLIOGRAPHY = NOTEBOOKS[0].with_name("REFERENCES.bib").read_text(encoding="utf-8")
HEADING = "## Where this comes from, and what to read next\n"
ENTRY = re.compile(r"^@\w+\{(\w+),\n(.*?)^\}", re.MULTILINE | re.DOTALL)
FIELD = re.compile(r"^  (\w+) = \{(.*)\},$", re.MULTILINE)
WORK = re.compile(r"^- `(\w+)` (.*?)(?=\n- |\n\n|\Z)", re.MULTILINE | re.DOTALL)
PREFIX = {"doi": "https://doi.org/", "eprint": "https://arxiv.org/abs/", "url": ""}
# works of a notebook; authors who are all named
FEWEST = 2
MOST = 5
MOST_NAMES = 4
ENTRIES = {key: dict(FIELD.findall(fields)) for key, fields in ENTRY.findall(BIBLIOGRAPHY)}


def section(path):
    """The works that a notebook names, by key, and what it says of each; empty without the section."""
    last = "".join(json.loads(path.read_text(encoding="utf-8"))["cells"][-1]["source"])
    before_next, _, _ = last.partition("**Next:**")
    return WORK.findall(before_next.partition(HEADING)[2])


def links(entry):
    return {prefix + entry[field] for field, prefix in PREFIX.items() if field in entry}


def wrong(key, text, entries):
    """What a notebook says of a work that its entry does not, or leaves out."""
    if key not in entries:
        return [f"{key}: no such entry"]
    entry = entries[key]
    text = " ".join(text.split())
    people = entry.get("author") or entry["editor"]
    names = [name.partition(",")[0].strip("{}") for name in people.split(" and ")]
    few = names if len(names) <= MOST_NAMES else [names[0], "et al."]
    expected = [*few, f"*{entry['title']}*", *([entry["year"]] if "year" in entry else [])]
    found = set(re.findall(r"\]\(([^)]+)\)", text))
    missing = [f"{key}: {part} is not said" for part in expected if part not in text]
    return missing + [f"{key}: {link}" for link in sorted(found ^ links(entry))]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_it_names_its_sources_as_the_bibliography_does(path):
    works = section(path)
    assert FEWEST <= len(works) <= MOST
    assert [fault for key, text in works for fault in wrong(key, text, ENTRIES)] == []


def test_every_entry_is_whole_and_read_somewhere():
    assert len(ENTRIES) == BIBLIOGRAPHY.count("\n@"), (
        "two entries of one key, or one that cannot be read"
    )
    assert {key for path in NOTEBOOKS for key, _ in section(path)} == set(ENTRIES)
    for key, entry in ENTRIES.items():
        assert links(entry) or "publisher" in entry, f"{key}: nobody can find it"
        assert key == "rerun" or key.endswith(entry["year"])
    everywhere = [link for entry in ENTRIES.values() for link in links(entry)]
    assert len(everywhere) == len(set(everywhere))

"""environment.md gives a reason for each package that endolab asks for; versions are the lock's alone."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
NAME = re.compile(r"[\w-]+")


def test_every_package_has_its_reason_and_its_version_in_the_lock():
    text = (ROOT / "environment.md").read_text(encoding="utf-8")
    table = text.partition("## Packages")[2].partition("\n## ")[0]
    reasons = {}
    for row in re.findall(r"^\| [a-z].*", table, re.MULTILINE):
        _, packages, extras, *_ = row.split("|")
        for package in packages.strip().split(", "):
            reasons[NAME.match(package)[0]] = set(NAME.findall(extras))
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    asked = {NAME.match(line)[0]: set() for line in project["dependencies"]}
    for extra, lines in project["optional-dependencies"].items():
        for line in lines:
            asked.setdefault(NAME.match(line)[0], set()).add(extra)
    assert reasons == asked
    lock = (ROOT / "requirements.lock").read_text()
    locked = set(re.findall(r"^([\w-]+)(?:\[\w+\])?==", lock, re.MULTILINE))
    assert asked.keys() - locked == {"mitsuba"}

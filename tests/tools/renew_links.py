"""Links from the notebooks into the library: each names what it means, and its line is looked up.

A link reads ``[`model/lights.py`](../endolab/model/lights.py#L13 "SpotLight")``: its title is a class or
function of that file. ``python -m tests.tools.renew_links`` sets the lines to where these are defined now.
"""

import re
import sys
from pathlib import Path

NOTEBOOKS = Path(__file__).resolve().parents[2] / "notebooks"
NAMED = re.compile(r'(\]\()([^)\s#]+\.py)(?:#L\d+)?( \\?"(\w+)\\?"\))')  # in JSON a quote has a backslash


def line_of(name: str, source: str) -> int | None:
    """Line, from 1, on which a class or function is first defined; None if it is not."""
    found = re.search(rf"^\s*(def|class) {name}\b", source, re.MULTILINE)
    return found and source.count("\n", 0, found.start(1)) + 1


def renewed(text: str, folder: Path) -> str:
    """A page or notebook as it lies in `folder`, each link to a name set to that name's line.

    Raises
    ------
    ValueError
        If a file is no more, or defines no such name.

    """

    def renew(link: re.Match[str]) -> str:
        start, target, end, name = link.groups()
        file = folder / target
        line = line_of(name, file.read_text(encoding="utf-8")) if file.is_file() else None
        if line is None:
            raise ValueError(f"{target}: defines no {name}")
        return f"{start}{target}#L{line}{end}"

    return NAMED.sub(renew, text)


def main() -> None:
    """Renew all pages, and name those that were stale."""
    wrong = []
    for path in sorted((*NOTEBOOKS.glob("*.ipynb"), *NOTEBOOKS.glob("*.md"))):
        text = path.read_text(encoding="utf-8")
        try:
            new = renewed(text, path.parent)
        except ValueError as error:
            wrong.append(f"{path.name}: {error}")
            continue
        if new != text:
            path.write_text(new, encoding="utf-8")
            print(f"{path.name} renewed")
    sys.exit("\n".join(wrong) or None)


if __name__ == "__main__":
    main()

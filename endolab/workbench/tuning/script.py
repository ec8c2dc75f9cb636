"""Scripts of the pages: the modules of page/ joined, so that a widget, or a file, has all in one."""

from __future__ import annotations

import re
from pathlib import Path

HERE = Path(__file__).with_name("page")
IMPORT = re.compile(r'^import .* from "\./(.+)\.js";\n', re.MULTILINE)


def page_script(name: str) -> str:
    """Return a module and all that it imports as one script, each behind what it imports.

    No name is in two modules: a browser refuses a script that has one twice.
    """
    joined: dict[str, str] = {}

    def join(name: str) -> None:
        text = (HERE / f"{name}.js").read_text(encoding="utf-8")
        for other in IMPORT.findall(text):
            if other not in joined:
                join(other)
        joined[name] = re.sub(r"^export ", "", IMPORT.sub("", text), flags=re.MULTILINE)

    join(name)
    return "".join(joined.values())

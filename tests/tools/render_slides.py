"""Slides of the notebooks, run and laid out: ``python -m tests.tools.render_slides notebooks out``.

A deck for each notebook, without a network: each ``##`` begins a slide, and its pieces go onto as many as
they take (`deck.js` measures them in the browser). Of a paragraph there is how it begins, of a short cell its
code; hints, solutions and references stay with the handout, code that only draws and what a check says
where no answer is are left out. A cell with nbconvert's ``slide_type`` "skip" is left out too, one with
"slide" begins a slide.
"""

import html
import re
import sys
from pathlib import Path

from bs4 import BeautifulSoup, NavigableString, Tag
from nbconvert.filters.markdown_mistune import MarkdownWithMath
from pygments import highlight
from pygments.formatters import HtmlFormatter
from pygments.lexers import PythonLexer

from endolab.course.verdict import MISSING
from endolab.io.atomic import staged_folder
from tests.tools.render_pages import (
    CHOSEN,
    Renderer,
    all_executed,
    notebooks_of,
    smaller,
    with_links,
    write_formulas,
)

FOLDS = re.compile(r"<details>.*?</details>", re.DOTALL)
REFERENCES = "Where this comes from"  # how the title of what is left out begins
TASKS = "Exercises"  # are told in full
SHORT = 10  # lines of code that are shown
FEW = 60  # signs that say too little by themselves
END = re.compile(r"(?<=[.!?])(?<!e\.g\.)(?<!i\.e\.)(?<!al\.)\s+(?=[A-ZΑ-Ω$(\"]|$)")  # of a sentence
SETTING = re.compile(r"(import|from)\s|[\w.]*style\.use\(")  # lines that set a notebook up
ANSI = re.compile(r"\x1b\[[\d;]*m")
DECK = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>%(title)s</title>
<style>%(style)s</style>%(head)s</head><body>
<div id="source">%(sections)s</div><div id="stage"></div>
<nav title="arrows: step · T: whole text · O: overview · F: full screen">
<a href="index.html">all decks</a><button id="back" aria-label="back">‹</button>
<span id="count"></span><button id="on" aria-label="on">›</button></nav>
<script type="module">%(script)s</script></body></html>
"""
INDEX = """<!DOCTYPE html>
<html lang="en"><head><meta charset="utf-8"><title>endolab: slides</title><style>
body { font: 18px/1.5 system-ui, sans-serif; color: #222; max-width: 48em; margin: 2em auto; padding: 0 1em; }
a { color: #0b5394; text-decoration: none; } ul { list-style: none; padding: 0; } li { margin: .4em 0; }
</style></head><body><h1>endolab: slides</h1><ul>%s</ul>
<p>Arrows step, T shows the whole text, O all slides, F fills the screen; printed, each slide is a page.</p>
</body></html>
"""


def sentences(paragraph):
    """Nodes of a paragraph, by sentences; one ends in plain text, not in what is set off."""
    found = [[]]
    for node in list(paragraph.children):
        if not isinstance(node, str):
            found[-1].append(node)
            continue
        start = 0
        for end in END.finditer(node):
            if node[: end.start()].replace("$$", "$").count("$") % 2 == 0:  # not within a formula
                found[-1].append(NavigableString(node[start : end.end()]))
                found.append([])
                start = end.end()
        found[-1].append(NavigableString(node[start:]))
    return found


def shortened(paragraph):
    """Put what a paragraph says at length aside, for whom wants the whole text.

    There stays how it begins, in a few words or one sentence, and each sentence with words in bold; nothing,
    if it is in brackets.
    """
    text, parts = paragraph.get_text(), sentences(paragraph)
    said = FEW if text.startswith("(") and text.endswith(")") else 0
    paragraph.clear()
    for nodes in parts:
        bold = any(node.name == "strong" for node in nodes)
        if bold or said < FEW:
            paragraph.extend(nodes)
        else:
            rest = Tag(name="span", attrs={"class": "rest"})
            rest.extend(nodes)
            paragraph.append(rest)
        said += sum(len(node.get_text()) for node in nodes)


def text_blocks(source, path, in_full=False):
    """Pieces of a markdown cell: the titles of those that begin a slide, and HTML."""
    renderer = Renderer(escape=False, embed_images=True, path=str(path))
    soup = BeautifulSoup(MarkdownWithMath(renderer).render(FOLDS.sub("", source)), "html.parser")
    for one in soup.find_all("a", class_="anchor-link"):
        one.decompose()
    for one in list(soup.children):
        if one.name in ("h1", "h2"):
            yield one.decode_contents().strip(), ""
            in_full = one.get_text().startswith(TASKS)
        elif one.get_text().strip() or one.name:
            if one.name == "p" and not in_full:
                shortened(one)
            leads = one.name == "h3" or one.get_text().rstrip().endswith(":")
            yield None, f"<div{' data-leads=1' * leads}>{one if one.name else html.escape(one)}</div>"


def shown(output, path):
    """HTML of an output."""
    if output.output_type == "stream":
        return "" if output.name == "stderr" else f"<pre>{html.escape(ANSI.sub('', output.text))}</pre>"
    data = output.get("data", {})
    if "text/html" in data:
        return data["text/html"]
    if "text/markdown" in data:
        return "".join(block for _, block in text_blocks(data["text/markdown"], path, in_full=True))
    for kind in ("image/png", "image/jpeg"):
        if kind in data:
            return f'<img src="data:{kind};base64,{data[kind]}" alt="">'
    if "image/svg+xml" in data:
        return data["image/svg+xml"]
    return f"<pre>{html.escape(data.get('text/plain', ''))}</pre>"


def pieces(content):
    """HTML of an output, by the pieces that it consists of."""
    if "endolab-piece" not in content:
        return [content]
    return [str(one) for one in BeautifulSoup(content, "html.parser").find_all(class_="endolab-piece")]


def code_blocks(cell, path):
    """Pieces of a code cell: its code, if it is to be seen, and what it has given."""
    lines = [line for line in cell.source.splitlines() if line.strip()]
    outputs = [one for output in cell.outputs for one in pieces(shown(output, path)) if one]
    outputs = [one for one in outputs if MISSING not in one]
    hidden = cell.metadata.get("jupyter", {}).get("source_hidden")
    if not hidden and 2 * sum(SETTING.match(line) is not None for line in lines) < len(lines):
        code = highlight(re.sub(r"\n{3,}", "\n\n", cell.source), PythonLexer(), HtmlFormatter(nowrap=True))
        leads, kind = " data-leads=1" * bool(outputs), "code short" if len(lines) <= SHORT else "code"
        is_open = " open" * (kind != "code")
        inside = f"<summary>Code, {len(lines)} line{'s' * (len(lines) > 1)}</summary><pre>{code}</pre>"
        yield f'<div{leads}><details class="{kind}"{is_open}>{inside}</details></div>'
    for one in outputs:
        yield f'<div class="output">{one}</div>'


def sections(notebook, path):
    """Titles, and the HTML of what goes below them."""
    found = []
    for cell in notebook.cells:
        kind = cell.metadata.get("slideshow", {}).get("slide_type")
        if kind == "skip":
            continue
        if cell.cell_type == "markdown":
            in_full = bool(found) and found[-1][0].startswith(TASKS)
            blocks = list(text_blocks(cell.source, path, in_full))
        else:
            blocks = [(None, block) for block in code_blocks(cell, path)] if cell.cell_type == "code" else []
        for i, (title, block) in enumerate(blocks):
            if title is not None:
                found.append((title, []))
            elif found:
                starts = kind == "slide" and i == 0
                found[-1][1].append(block.replace("<div", "<div data-starts=1", 1) if starts else block)
    return [(title, blocks) for title, blocks in found if blocks and not title.startswith(REFERENCES)]


def deck(title, found, head):
    """HTML of a deck."""
    here = Path(__file__).parent
    coloured = HtmlFormatter().get_style_defs(".body pre")
    style = coloured + CHOSEN + (here / "deck.css").read_text(encoding="utf-8")
    parts = [f"<div><header>{name}</header>{''.join(blocks)}</div>" for name, blocks in found]
    script = (here / "deck.js").read_text(encoding="utf-8")
    texts = {"title": title, "style": style, "head": head, "sections": "".join(parts), "script": script}
    return smaller(DECK % texts)


def render_slides(notebooks, out):
    """Run every notebook and make a deck of it, and an index.

    The folder `out` is replaced when all of them are done; beside it the notebooks are kept as they were run.
    A FileNotFoundError says that there are no notebooks, a ValueError which of them has a cell that fails.
    """
    source, target = Path(notebooks).resolve(), Path(out).resolve()
    paths = notebooks_of(source)
    with staged_folder(target, overwrite=True) as folder:
        head, links = write_formulas(folder), []
        for path, notebook in zip(paths, all_executed(paths, target), strict=True):
            for cell in notebook.cells:
                if cell.cell_type == "markdown":
                    cell.source = with_links(cell.source, source, target)
            found = sections(notebook, source)
            title = BeautifulSoup(found[0][0], "html.parser").get_text() if found else path.stem
            (folder / f"{path.stem}.html").write_text(deck(title, found, head), encoding="utf-8")
            links.append(f'<li><a href="{path.stem}.html">{html.escape(title)}</a></li>')
        (folder / "index.html").write_text(INDEX % "".join(links), encoding="utf-8")


def main(arguments):
    """Make the decks, or say in one sentence why not."""
    try:
        render_slides(*arguments)
    except (ValueError, OSError) as error:
        print(f"endolab: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))

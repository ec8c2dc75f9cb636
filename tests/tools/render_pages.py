"""Static pages of the notebooks, run and rendered: ``python -m tests.tools.render_pages notebooks out``.

nbconvert makes them; what is ours is that they need no network and no kernel (see `stills`), link to each
other and to a reference of the library (see `reference`), and fold away hints, solutions (``--solutions``
opens them) and the code of cells whose input is hidden.
"""

import asyncio
import base64
import hashlib
import io
import os
import re
import sys
from concurrent.futures import ThreadPoolExecutor
from importlib.util import find_spec
from pathlib import Path

import nbformat
from jinja2 import DictLoader, pass_context
from mistune import HTMLRenderer
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError, CellTimeoutError
from nbconvert import HTMLExporter
from nbconvert.filters.markdown_mistune import IPythonRenderer, MarkdownWithMath
from PIL import Image

from endolab.io.atomic import staged_folder, write_atomically
from tests.tools.reference import PACKAGE, Reference, linked, write_reference
from tests.tools.stills import MOST

ROOT = PACKAGE.parent
LOCK = ROOT / "requirements.lock"
# Open3D brings Dash, whose package holds MathJax 3 with its fonts, as one of webpack's chunks.
FORMULAS = """window.MathJax = {tex: {inlineMath: [["$", "$"]], processEscapes: true}};
%s
(function () {
    const modules = Object.values(self.webpackChunkdash_core_components[0][1]);
    const longest = modules.reduce((a, b) => (a.toString().length > b.toString().length ? a : b));
    longest({}, {}, () => Object.assign(Object.create(console), {env: {}}));
})();
"""
# Of pieces of which one is chosen, see `stills.chosen_from`, that one is shown; print has the one at first.
CHOSEN = """
.endolab-chosen { margin: 4px 0; }
.endolab-chosen > b { font-weight: normal; margin-right: 8px; }
.endolab-chosen > input { position: absolute; opacity: 0; }
.endolab-chosen > label { display: inline-block; padding: 1px 9px; margin: 2px; border: 1px solid #bbb;
  border-radius: 3px; cursor: pointer; }
.endolab-chosen > input:checked + label { background: #0072B2; border-color: #0072B2; color: white; }
.endolab-chosen > input:focus-visible + label { outline: 2px solid #D55E00; }
.endolab-chosen > div > div { display: none; }
.endolab-chosen img, .endolab-alive img, .endolab-piece img { max-width: 100%; height: auto; }
.endolab-row { display: flex; gap: 8px; }
.endolab-row > figure { margin: 0; flex: 1 1 0; min-width: 0; }
""" + "\n".join(
    f".endolab-chosen > input:nth-of-type({i}):checked ~ div > div:nth-child({i}) {{ display: block; }}"
    for i in range(1, MOST + 1)
)
# A cell whose input JupyterLab hides (View > Collapse Selected Code) has it behind a fold on the page.
FOLDED = (
    """{% extends "lab/index.html.j2" %}
{% block input_group %}
{% if cell.metadata.get("jupyter", {}).get("source_hidden") %}
<details class="endolab-code"><summary>Code</summary>
{{ super() }}
</details>
{% else %}
{{ super() }}
{% endif %}
{% endblock input_group %}
{% block notebook_css %}
{{ super() }}
<style>
summary { cursor: pointer; color: var(--jp-content-font-color2); }
.jp-RenderedMarkdown details { margin-bottom: 1em; }
.jp-RenderedMarkdown details > :not(summary) { margin-top: .5em; margin-bottom: .8em; }
.endolab-code > summary { margin-left: calc(var(--jp-cell-prompt-width) + 4px); }
.endolab-pages { padding: 8px 4px; font: 14px sans-serif; }
a.endolab-api { color: inherit; text-decoration: underline dotted #999; }
"""
    + CHOSEN
    + """</style>
{% endblock notebook_css %}
"""
)
INLINE = {"MPLBACKEND": "module://matplotlib_inline.backend_inline"}
STILLS = "from tests.tools import stills; stills.install(); del stills"
KEPT = "executed"  # folder beside the pages
AT_ONCE = 2  # kernels
LECTURERS = ("ANSWERS", "MISTAKES")  # texts that are not for students
WIDGET = "application/vnd.jupyter.widget-view+json"
NO_WIDGET = "(Here are controls that need a kernel: open the notebook in JupyterLab to use them.)"
OPEN = "--solutions"
LINK = re.compile(r"(\]\()([^)#\s]+)([^)]*\))")
SOLUTION = re.compile(r"<details>(?=\s*<summary>Solution)")
PNG = re.compile(r"data:image/png;base64,([\w+/=\s]+)")
QUALITY = 90  # of a picture, in a hundred: a quarter of its bytes, and no eye tells
LINKS = """<nav class="endolab-pages"><a href="index.html">Notebooks</a> ·
<a href="api/index.html">Reference</a></nav>
"""


class Renderer(IPythonRenderer):
    """nbconvert's, which embeds pictures, but leaves HTML alone.

    nbconvert looks for pictures in each piece of HTML by itself, and closes what it finds open in it: a fold
    would end before the text that it holds.
    """

    block_html = HTMLRenderer.block_html
    inline_html = HTMLRenderer.inline_html


class PageExporter(HTMLExporter):
    """Pages with folds: around solutions, and around code that is hidden."""

    def __init__(self):
        folded = DictLoader({"folded.html.j2": FOLDED})
        super().__init__(extra_loaders=[folded], template_file="folded.html.j2")
        self.require_js_url = self.jquery_url = "data:,"

    @pass_context
    def markdown2html(self, context, source):
        """nbconvert's filter, with our renderer."""
        path = context["resources"]["metadata"]["path"]
        return MarkdownWithMath(Renderer(escape=False, embed_images=True, path=path)).render(source)


def opened(text):
    """Text whose solutions are open; hints stay folded."""
    return SOLUTION.sub("<details open>", text)


def with_links(text, source, out, pages=("README",)):
    """Text with its links changed: to pages, and to the files that are not copied."""

    def moved(match):
        before, target, after = match.groups()
        name, _, suffix = target.rpartition(".")
        if re.match(r"[a-z]+:", target) or target.startswith("images/"):
            return match[0]
        if suffix == "ipynb" or (suffix == "md" and name in pages):
            return f"{before}{'index' if name == 'README' else name}.html{after}"
        return f"{before}{Path(os.path.relpath(source / target, out)).as_posix()}{after}"

    return LINK.sub(moved, text)


def formulas():
    """A script that draws formulas, if one is on this machine."""
    dash = find_spec("dash")
    path = Path(dash.origin).parent / "dcc" / "async-mathjax.js" if dash and dash.origin else None
    return FORMULAS % path.read_text(encoding="utf-8") if path and path.is_file() else None


def smaller(page):
    """A page whose pictures are WebP, where that is smaller."""

    def packed(match):
        content = base64.b64decode(match[1])
        stream = io.BytesIO()
        Image.open(io.BytesIO(content)).save(stream, "webp", quality=QUALITY)
        if stream.tell() >= len(content):
            return match[0]
        return f"data:image/webp;base64,{base64.b64encode(stream.getvalue()).decode()}"

    return PNG.sub(packed, page)


def fingerprint(path):
    """What a notebook's outputs depend on, as a few signs: itself, library, packages, stills, data."""
    sources = sorted(one for one in PACKAGE.rglob("*") if one.suffix in (".py", ".pyi", ".js", ".npz", ".j2"))
    parts = [one.read_bytes() for one in (path, Path(__file__).with_name("stills.py"), LOCK, *sources)]
    parts.append(os.environ.get("ENDOLAB_DATA", "").encode())
    return hashlib.sha256(b"\0".join(hashlib.sha256(part).digest() for part in parts)).hexdigest()[:16]


def ran(path):
    """A notebook that was run; a CellTimeoutError if a cell does not end."""
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(
        notebook,
        timeout=120,
        resources={"metadata": {"path": str(path.parent)}},
        extra_arguments=[f"--IPKernelApp.code_to_run={STILLS}", "--IPKernelApp.log_level=ERROR"],
        coalesce_streams=True,  # what was printed at intervals is one piece
        store_widget_state=False,  # its script would come from the network
    )
    paths = os.pathsep.join(filter(None, [str(ROOT), os.environ.get("PYTHONPATH")]))
    try:
        asyncio.run(client.async_execute(env=os.environ | INLINE | {"PYTHONPATH": paths}))
    except CellExecutionError as error:
        raise ValueError(f"{path.name}: a cell failed with {error.ename}: {error.evalue}") from error
    return notebook


def executed(path, kept):
    """A notebook that was run, its controls replaced by stills; kept, and taken while nothing changes."""
    there = kept / f"{path.stem}.{fingerprint(path)}.ipynb"
    if there.is_file():
        print(f"{path.name}, as it was run before", flush=True)
        return nbformat.read(there, as_version=4)
    print(path.name, flush=True)
    try:
        notebook = ran(path)
    except CellTimeoutError:  # now and then a kernel's last word is lost, and nbclient waits for it for good
        print(f"{path.name}, once more", flush=True)
        notebook = ran(path)
    for output in (output for cell in notebook.cells for output in cell.get("outputs", [])):
        if WIDGET in output.get("data", {}):
            still = {kind: output.data[kind] for kind in ("text/html", "image/png") if kind in output.data}
            output.data = still or {"text/plain": NO_WIDGET}
    kept.mkdir(parents=True, exist_ok=True)
    for old in kept.glob(f"{path.stem}.*.ipynb"):
        old.unlink()
    write_atomically(there, nbformat.writes(notebook).encode())
    return notebook


def all_executed(paths, out):
    """Notebooks that were run, two at a time; they are kept beside the folder of their pages."""
    with ThreadPoolExecutor(AT_ONCE) as pool:
        runs = [pool.submit(executed, path, out.with_name(KEPT)) for path in paths]
        try:
            return [run.result() for run in runs]
        finally:
            pool.shutdown(cancel_futures=True)


def code_of(notebook):
    """The code of a notebook's cells."""
    return [cell.source for cell in notebook.cells if cell.cell_type == "code"]


def notebooks_of(folder):
    """The notebooks of a folder; a FileNotFoundError says that there are none."""
    paths = sorted(folder.glob("*.ipynb"))
    if not paths:
        raise FileNotFoundError(f"{folder}: there are no notebooks")
    return paths


def write_formulas(folder):
    """Write the script that draws formulas, if there is one; return what has a page call it, or nothing."""
    script = formulas()
    if script is None:
        print("Dash is not installed: formulas will be drawn by MathJax from the network, or not at all.")
        return ""
    (folder / "mathjax.js").write_text(script, encoding="utf-8")
    return '<script src="mathjax.js" defer></script>'


def render_pages(notebooks, out, solutions=False):
    """Run every notebook and render it as a page, and the texts beside them; ``README.md`` is the index.

    Solutions are folded away, and what is for lecturers is left out, or both are in view if `solutions` says
    so. Beside the pages is a reference of the library, ``api/``. The folder `out` is replaced when all of
    them are done; beside it the notebooks are kept as they were run. A FileNotFoundError says that there are
    no notebooks, a ValueError which of them has a cell that fails.
    """
    source, target = Path(notebooks).resolve(), Path(out).resolve()
    paths = notebooks_of(source)
    texts = [one for one in sorted(source.glob("*.md")) if solutions or one.stem not in LECTURERS]
    exporter, reference = PageExporter(), Reference()
    with staged_folder(target, overwrite=True) as folder:
        head = write_formulas(folder)
        if head:
            exporter.mathjax_url = "data:,"

        def write(notebook, name, title):
            known = reference.scan(name, code_of(notebook))
            for cell in notebook.cells:
                if cell.cell_type == "markdown":
                    text = with_links(cell.source, source, target, [one.stem for one in texts])
                    cell.source = opened(text) if solutions else text
            where = {"metadata": {"name": title, "path": str(source)}}
            body = exporter.from_notebook_node(notebook, resources=where)[0]
            body = body.replace("</head>", f"{head}</head>", 1).replace("<main>", f"{LINKS}<main>", 1)
            body = smaller(linked(body, reference, known))
            (folder / f"{name}.html").write_text(body, encoding="utf-8")

        for path, notebook in zip(paths, all_executed(paths, target), strict=True):
            write(notebook, path.stem, path.stem)
        for path in texts:
            cell = nbformat.v4.new_markdown_cell(path.read_text(encoding="utf-8"))
            name, title = {"README": ("index", "notebooks")}.get(path.stem, (path.stem, path.stem.lower()))
            write(nbformat.v4.new_notebook(cells=[cell]), name, f"endolab: {title}")
    with staged_folder(target / "api", overwrite=True) as folder:
        write_reference(reference, folder, Path(os.path.relpath(PACKAGE, target / "api")).as_posix())


def main(arguments):
    """Render pages, or say in one sentence why not."""
    try:
        render_pages(*(one for one in arguments if one != OPEN), solutions=OPEN in arguments)
    except (ValueError, OSError) as error:
        print(f"endolab: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))

"""Static pages of the notebooks, run and rendered: ``python -m tests.tools.render_pages notebooks out``.

nbconvert makes them, and pdoc the reference beside them. They need no network and no kernel (see `stills`),
link to each other, and fold away hints, solutions (``--solutions`` opens them) and hidden code.
"""

import os
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import nbformat
from jinja2 import DictLoader, pass_context
from mistune import HTMLRenderer
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from nbconvert import HTMLExporter
from nbconvert.filters.markdown_mistune import IPythonRenderer, MarkdownWithMath

from endolab.io.atomic import staged_folder
from tests.tools.stills import MOST

ROOT = Path(__file__).resolve().parents[2]
# Open3D brings Dash, whose package holds MathJax 3 with its fonts, as one of webpack's chunks.
FORMULAS = """window.MathJax = {tex: {inlineMath: [["$", "$"]], processEscapes: true}};
%s
(function () {
    const modules = Object.values(self.webpackChunkdash_core_components[0][1]);
    const longest = modules.reduce((a, b) => (a.toString().length > b.toString().length ? a : b));
    longest({}, {}, () => Object.assign(Object.create(console), {env: {}}));
})();
"""
STYLE = """
summary { cursor: pointer; color: var(--jp-content-font-color2); }
.jp-RenderedMarkdown details { margin-bottom: 1em; }
.jp-RenderedMarkdown details > :not(summary) { margin: .5em 0 .8em; }
.endolab-code > summary { margin-left: calc(var(--jp-cell-prompt-width) + 4px); }
.endolab-pages { padding: 8px 4px; font: 14px sans-serif; }
.endolab-chosen > input { position: absolute; opacity: 0; }
.endolab-chosen > label { display: inline-block; padding: 1px 9px; margin: 2px; border: 1px solid #bbb; }
.endolab-chosen > input:checked + label { background: #0072B2; color: white; }
.endolab-chosen > div > div { display: none; }
.endolab-chosen img { max-width: 100%; }
""" + "\n".join(
    f".endolab-chosen > input:nth-of-type({i}):checked ~ div > div:nth-child({i}) {{ display: block; }}"
    for i in range(1, MOST + 2)
)
# A cell whose input JupyterLab hides (View > Collapse Selected Code) has it behind a fold on the page.
TEMPLATE = """{% extends "lab/index.html.j2" %}
{% block input_group %}
{% if cell.metadata.get("jupyter", {}).get("source_hidden") %}
<details class="endolab-code"><summary>Code</summary>{{ super() }}</details>
{% else %}{{ super() }}{% endif %}
{% endblock input_group %}
{% block notebook_css %}{{ super() }}<style>STYLE</style>{% endblock notebook_css %}
""".replace("STYLE", STYLE)
NAVIGATION = """<nav class="endolab-pages"><a href="index.html">Notebooks</a> ·
<a href="api/endolab.html">Reference</a></nav>
"""
STILLS = "from tests.tools import stills; stills.install(); del stills"
LECTURERS = ("ANSWERS", "MISTAKES")  # texts that are not for students
WIDGET = "application/vnd.jupyter.widget-view+json"
NO_WIDGET = "(Here are controls that need a kernel: open the notebook in JupyterLab to use them.)"
LINK = re.compile(r"(\]\()([^)#\s]+)([^)]*\))")
SOLUTION = re.compile(r"<details>(?=\s*<summary>Solution)")


class Renderer(IPythonRenderer):
    """nbconvert's, but it leaves HTML alone: nbconvert closes a fold before the text that it holds."""

    block_html = HTMLRenderer.block_html
    inline_html = HTMLRenderer.inline_html


class PageExporter(HTMLExporter):
    """Pages with folds: around solutions, and around code that is hidden."""

    def __init__(self):
        loader = DictLoader({"folded.html.j2": TEMPLATE})
        super().__init__(extra_loaders=[loader], template_file="folded.html.j2")
        self.require_js_url = self.jquery_url = self.mathjax_url = "data:,"

    @pass_context
    def markdown2html(self, context, source):
        """nbconvert's filter, with our renderer."""
        path = context["resources"]["metadata"]["path"]
        return MarkdownWithMath(Renderer(escape=False, embed_images=True, path=path)).render(source)


def with_links(text, source, out, pages):
    """Text whose links lead to pages, and to the files that are not copied."""

    def moved(match):
        before, target, after = match.groups()
        name, _, suffix = target.rpartition(".")
        if re.match(r"[a-z]+:", target) or target.startswith("images/"):
            return match[0]
        if suffix in ("ipynb", "md") and name in pages:
            return f"{before}{'index' if name == 'README' else name}.html{after}"
        return f"{before}{Path(os.path.relpath(source / target, out)).as_posix()}{after}"

    return LINK.sub(moved, text)


def executed(path):
    """A notebook that was run, with text in place of what needs a kernel; ValueError if a cell fails."""
    print(path.name, flush=True)
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(
        notebook,
        timeout=120,
        resources={"metadata": {"path": str(path.parent)}},
        extra_arguments=[f"--IPKernelApp.code_to_run={STILLS}", "--IPKernelApp.log_level=ERROR"],
        store_widget_state=False,  # its script would come from the network
    )
    inline = {"MPLBACKEND": "module://matplotlib_inline.backend_inline", "PYTHONPATH": str(ROOT)}
    try:
        client.execute(env=os.environ | inline)
    except CellExecutionError as error:
        raise ValueError(f"{path.name}: a cell failed with {error.ename}: {error.evalue}") from error
    for output in (output for cell in notebook.cells for output in cell.get("outputs", [])):
        if WIDGET in output.get("data", {}):
            output.data = {"text/plain": NO_WIDGET}
    return notebook


def write_formulas(folder):
    """Write the script that draws formulas, if Dash has it; return what makes a page call it, or nothing."""
    dash = find_spec("dash")
    path = Path(dash.origin).parent / "dcc" / "async-mathjax.js" if dash and dash.origin else None
    if path is None or not path.is_file():
        print("Dash is not installed: formulas will not be drawn.")
        return ""
    (folder / "mathjax.js").write_text(FORMULAS % path.read_text(encoding="utf-8"), encoding="utf-8")
    return '<script src="mathjax.js" defer></script>'


def write_reference(folder):
    """Write a reference of the library, by pdoc."""
    pdoc = [sys.executable, "-W", "ignore", "-m", "pdoc", "endolab", "--no-show-source", "--no-search"]
    subprocess.run([*pdoc, "-d", "numpy", "-o", folder], cwd=ROOT, check=True)


def render_pages(notebooks, out, solutions=False):
    """Run every notebook and render it as a page, and the texts beside them; ``README.md`` is the index.

    `solutions` opens the solutions and adds what is for lecturers. The folder `out` is replaced when all are
    done; ``api/`` in it is a reference of the library. ValueError if a cell fails or there are no notebooks.
    """
    source, target = Path(notebooks).resolve(), Path(out).resolve()
    paths = sorted(source.glob("*.ipynb"))
    if not paths:
        raise ValueError(f"{source}: there are no notebooks")
    texts = [one for one in sorted(source.glob("*.md")) if solutions or one.stem not in LECTURERS]
    pages = [one.stem for one in (*paths, *texts)]
    exporter = PageExporter()
    with staged_folder(target, overwrite=True) as folder:
        formulas = write_formulas(folder)
        for path in (*paths, *texts):
            if path.suffix == ".md":
                text = path.read_text(encoding="utf-8")
                notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_markdown_cell(text)])
            else:
                notebook = executed(path)
            for cell in notebook.cells:
                if cell.cell_type == "markdown":
                    text = with_links(cell.source, source, target, pages)
                    cell.source = SOLUTION.sub("<details open>", text) if solutions else text
            name = "index" if path.stem == "README" else path.stem
            where = {"metadata": {"name": name, "path": str(source)}}
            page = exporter.from_notebook_node(notebook, resources=where)[0]
            page = page.replace("</head>", f"{formulas}</head>", 1).replace(
                "<main>", f"{NAVIGATION}<main>", 1
            )
            (folder / f"{name}.html").write_text(page, encoding="utf-8")
    write_reference(target / "api")


if __name__ == "__main__":
    try:
        render_pages(*sys.argv[1:3], solutions="--solutions" in sys.argv)
    except (ValueError, OSError) as error:
        sys.exit(f"endolab: {error}")

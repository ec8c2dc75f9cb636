"""Static pages of the notebooks, run and rendered: ``python -m tests.tools.render_pages notebooks out``.

nbconvert makes them; a reference, by pdoc, a tuner and the notebooks' recordings lie beside them. They need
no network and no kernel, link to each other, and fold away hints, solutions (``--solutions`` opens them) and
hidden code.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

import nbformat
from jinja2 import FileSystemLoader, pass_context
from mistune import HTMLRenderer
from nbclient import NotebookClient
from nbconvert import HTMLExporter
from nbconvert.filters.markdown_mistune import IPythonRenderer, MarkdownWithMath

import endolab as el
from endolab.io.atomic import stage_folder
from tests.tools.notebook_timeouts import cell_limit

ROOT = Path(__file__).resolve().parents[2]
LECTURERS = ("ANSWERS", "MISTAKES")  # texts that are not for students
WIDGET = "application/vnd.jupyter.widget-view+json"
NO_WIDGET = (
    "<p>Here is the tuner, if you open the notebook in JupyterLab. A page of its own has one "
    'that needs no Python: <a href="try_it.html"><b>try it</b></a>.</p>'
)
LINK = re.compile(r"(\]\()([^)#\s]+)([^)]*\))")
SOLUTION = re.compile(r"<details>(?=\s*<summary>Solution)")


class Renderer(IPythonRenderer):
    """nbconvert's, but it leaves HTML alone: nbconvert closes a fold before the text that it holds."""

    block_html = HTMLRenderer.block_html
    inline_html = HTMLRenderer.inline_html


class PageExporter(HTMLExporter):
    """Pages by our template, whose texts our renderer makes."""

    def __init__(self):
        loader = FileSystemLoader(Path(__file__).parent)
        super().__init__(extra_loaders=[loader], template_file="page.html.j2")

    @pass_context
    def markdown2html(self, context, source):
        path = context["resources"]["metadata"]["path"]
        renderer = Renderer(escape=False, embed_images=True, path=path)
        return MarkdownWithMath(renderer).render(source)


def with_links(text, path, out, names):
    """A file's text with links to pages, named by their sources, and to files that are not copied."""

    def moved(match):
        before, target, after = match.groups()
        if re.match(r"[a-z]+:", target):
            return match[0]
        if "images/" in target:  # the page holds it, found from the folder of notebooks
            return f"{before}images/{Path(target).name}{after}"
        source = Path(os.path.normpath(path.parent / target))
        page = (
            f"{names[source]}.html" if source in names else os.path.relpath(source, out)
        )
        return f"{before}{page}{after}"

    return LINK.sub(moved, text)


def executed(path, folder):
    """A notebook that was run, with a link in place of the tuner; raises what a cell raises.

    The recordings that it made are copied into `folder`.
    """
    print(path.name, flush=True)
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(
        notebook,
        timeout=round(2 * cell_limit()),
        resources={"metadata": {"path": str(path.parent)}},
        extra_arguments=["--IPKernelApp.log_level=ERROR"],
        store_widget_state=False,  # its script would come from the network
    )
    inline = "module://matplotlib_inline.backend_inline"
    with tempfile.TemporaryDirectory() as made:
        more = {"MPLBACKEND": inline, "PYTHONPATH": str(ROOT), "TMPDIR": made}
        client.execute(env=os.environ | more)
        for recording in Path(made).rglob("*.rrd"):
            shutil.copy(recording, folder)
    for cell in notebook.cells:
        for output in cell.get("outputs", ()):
            data = output.get("data", {})
            if data.pop(WIDGET, None) and "image/png" not in data:
                data["text/html"] = NO_WIDGET
    return notebook


def write_beside(folder):
    """Write what the pages link to: a reference of the library, by pdoc, and a tuner of a simulated colon."""
    pdoc = [sys.executable, "-W", "ignore", "-m", "pdoc", "endolab", "-d", "numpy"]
    pdoc += ["--no-show-source", "--no-search", "-o", folder / "api"]
    subprocess.run(pdoc, cwd=ROOT, check=True)
    tuner = el.tune(scene="colon", width=320)
    tuner.export_html(folder / "try_it.html")
    tuner.close()


def render_pages(notebooks, out, solutions=False):
    """Run every notebook and render it as a page, and the texts beside them; ``README.md`` is the index.

    `solutions` opens the solutions and adds what is for lecturers. The folder `out` is replaced when all are
    done; Formulas are drawn by the script that Dash has.
    """
    source = Path(notebooks).resolve()
    target = Path(out).resolve()
    names = {
        path: "index" if path.stem == "README" else path.stem
        for path in (*sorted(source.glob("*.ipynb")), *sorted(source.rglob("*.md")))
        if solutions or path.stem not in LECTURERS
    }
    exporter = PageExporter()
    with stage_folder(target, overwrite=True) as folder:
        dash = find_spec("dash")
        if dash:
            script = Path(dash.origin).parent / "dcc" / "async-mathjax.js"
            shutil.copyfile(script, folder / "mathjax.js")
        for path, name in names.items():
            if path.suffix == ".md":
                cell = nbformat.v4.new_markdown_cell(path.read_text(encoding="utf-8"))
                notebook = nbformat.v4.new_notebook(cells=[cell])
            else:
                notebook = executed(path, folder)
            for cell in notebook.cells:
                if cell.cell_type == "markdown":
                    cell.source = with_links(cell.source, path, target, names)
                    if solutions:
                        cell.source = SOLUTION.sub("<details open>", cell.source)
            where = {"metadata": {"name": name, "path": str(source)}}
            page = exporter.from_notebook_node(notebook, resources=where)[0]
            (folder / f"{name}.html").write_text(page, encoding="utf-8")
    write_beside(target)


if __name__ == "__main__":
    render_pages(*sys.argv[1:3], solutions="--solutions" in sys.argv)

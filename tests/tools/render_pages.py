"""Static pages of the notebooks, run and rendered: ``python -m tests.tools.render_pages notebooks out``.

nbconvert makes them; what is ours is that they need no network and no kernel, and link to each other.
"""

import os
import re
import sys
from importlib.util import find_spec
from pathlib import Path

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from nbconvert import HTMLExporter

from endolab.io.atomic import staged_folder

# Behind a page there is no kernel: a slider gives way to what it shows where it stands. Run by every
# kernel before the first cell.
STILL = """
import ipywidgets
def _still(*functions, **sliders):
    if functions:
        return functions[0]()
    return lambda function: function()
ipywidgets.interact = _still
del ipywidgets
"""
# Open3D brings Dash, whose package holds MathJax 3 with its fonts, as one of webpack's chunks.
FORMULAS = """window.MathJax = {tex: {inlineMath: [["$", "$"]], processEscapes: true}};
%s
(function () {
    const modules = Object.values(self.webpackChunkdash_core_components[0][1]);
    const longest = modules.reduce((a, b) => (a.toString().length > b.toString().length ? a : b));
    longest({}, {}, () => Object.assign(Object.create(console), {env: {}}));
})();
"""
WIDGET = "application/vnd.jupyter.widget-view+json"
NO_WIDGET = "(Here are controls that need a kernel: open the notebook in JupyterLab to use them.)"
LINK = re.compile(r"(\]\()([^)#\s]+)([^)]*\))")
INLINE = {"MPLBACKEND": "module://matplotlib_inline.backend_inline"}


def with_links(text, source, out):
    """Text with its links changed: to the pages of notebooks, and to the files that are not copied."""

    def moved(match):
        before, target, after = match.groups()
        if re.match(r"[a-z]+:", target) or target.startswith("images/"):
            return match[0]
        if target.endswith(".ipynb"):
            return f"{before}{target.removesuffix('.ipynb')}.html{after}"
        if target == "README.md":
            return f"{before}index.html{after}"
        return f"{before}{Path(os.path.relpath(source / target, out)).as_posix()}{after}"

    return LINK.sub(moved, text)


def formulas():
    """A script that draws formulas, if one is on this machine."""
    dash = find_spec("dash")
    path = Path(dash.origin).parent / "dcc" / "async-mathjax.js" if dash and dash.origin else None
    return FORMULAS % path.read_text(encoding="utf-8") if path and path.is_file() else None


def executed(path):
    """A notebook that was run, its controls replaced by a sentence."""
    notebook = nbformat.read(path, as_version=4)
    client = NotebookClient(
        notebook,
        timeout=120,
        resources={"metadata": {"path": str(path.parent)}},
        extra_arguments=[f"--IPKernelApp.code_to_run={STILL}"],
        store_widget_state=False,  # its script would come from the network
    )
    try:
        client.execute(env=os.environ | INLINE)
    except CellExecutionError as error:
        raise ValueError(f"{path.name}: a cell failed with {error.ename}: {error.evalue}") from error
    for output in (output for cell in notebook.cells for output in cell.get("outputs", [])):
        if WIDGET in output.get("data", {}):
            output.data = {"text/plain": NO_WIDGET}
    return notebook


def render_pages(notebooks, out):
    """Run every notebook and render it as a page; ``README.md`` becomes ``index.html``.

    The folder `out` is replaced when all of them are done. A FileNotFoundError says that there are
    no notebooks, a ValueError which of them has a cell that fails.
    """
    source, target = Path(notebooks).resolve(), Path(out).resolve()
    paths = sorted(source.glob("*.ipynb"))
    if not paths:
        raise FileNotFoundError(f"{source}: there are no notebooks")
    exporter = HTMLExporter(embed_images=True)
    exporter.require_js_url = exporter.jquery_url = "data:,"
    head, script = "</head>", formulas()
    if script is None:
        print("Dash is not installed: the pages will fetch MathJax from the network.")
    else:
        exporter.mathjax_url, head = "data:,", '<script src="mathjax.js" defer></script></head>'

    with staged_folder(target, overwrite=True) as folder:

        def write(notebook, name, title):
            for cell in notebook.cells:
                if cell.cell_type == "markdown":
                    cell.source = with_links(cell.source, source, target)
            where = {"metadata": {"name": title, "path": str(source)}}
            body = exporter.from_notebook_node(notebook, resources=where)[0]
            (folder / f"{name}.html").write_text(body.replace("</head>", head, 1), encoding="utf-8")

        if script:
            (folder / "mathjax.js").write_text(script, encoding="utf-8")
        for path in paths:
            print(path.name, flush=True)
            write(executed(path), path.stem, path.stem)
        text = (source / "README.md").read_text(encoding="utf-8")
        index = nbformat.v4.new_notebook(cells=[nbformat.v4.new_markdown_cell(text)])
        write(index, "index", "endolab: the notebooks")


def main(arguments):
    """Render pages, or say in one sentence why not."""
    try:
        render_pages(*arguments)
    except (ValueError, OSError) as error:
        print(f"endolab: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))

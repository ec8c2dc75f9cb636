"""Static pages of the notebooks, run and rendered, to be read without Python and without a network."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from endolab.io.atomic import staged_folder

# Behind a page there is no kernel: a slider gives way to what it shows where it stands.
STILL = """
import ipywidgets
def _still(*functions, **sliders):
    if functions:
        return functions[0]()
    return lambda function: function()
ipywidgets.interact = _still
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


def _with_links(text: str, source: Path, out: Path) -> str:
    """Text with its links changed: to the pages of notebooks, and to the files that are not copied."""

    def moved(match: re.Match[str]) -> str:
        before, target, after = match.groups()
        if re.match(r"[a-z]+:", target) or target.startswith("images/"):
            return match[0]
        if target.endswith(".ipynb"):
            return f"{before}{target.removesuffix('.ipynb')}.html{after}"
        if target == "README.md":
            return f"{before}index.html{after}"
        return f"{before}{Path(os.path.relpath(source / target, out)).as_posix()}{after}"

    return LINK.sub(moved, text)


def _mathjax() -> str | None:
    """Give a script that draws formulas, if one is on this machine."""
    from importlib.util import find_spec

    dash = find_spec("dash")
    path = Path(dash.origin).parent / "dcc" / "async-mathjax.js" if dash and dash.origin else None
    return FORMULAS % path.read_text(encoding="utf-8") if path and path.is_file() else None


def render_pages(notebooks: str | os.PathLike[str], out: str | os.PathLike[str]) -> None:
    """Run every notebook and render it as a page; ``README.md`` becomes ``index.html``.

    Parameters
    ----------
    notebooks : path
        Folder of notebooks.
    out : path
        Folder for the pages; it is replaced when all of them are done.

    Raises
    ------
    FileNotFoundError
        If there are no notebooks.
    ValueError
        If a cell fails, naming the notebook.
    """
    import nbformat
    from nbclient import NotebookClient
    from nbclient.exceptions import CellExecutionError
    from nbconvert import HTMLExporter

    source, target = Path(notebooks).resolve(), Path(out).resolve()
    paths = sorted(source.glob("*.ipynb"))
    if not paths:
        raise FileNotFoundError(f"{source}: there are no notebooks")
    exporter: Any = HTMLExporter(embed_images=True)
    exporter.require_js_url = exporter.jquery_url = "data:,"
    script = _mathjax()
    if script is None:
        print("Dash is not installed: the pages will fetch MathJax from the network.")
    else:
        exporter.mathjax_url = "data:,"
    head = '<script src="mathjax.js" defer></script></head>' if script else "</head>"

    def page(notebook: Any, title: str) -> str:
        for cell in notebook.cells:
            if cell.cell_type == "markdown":
                cell.source = _with_links(cell.source, source, target)
        where = {"metadata": {"name": title, "path": str(source)}}
        body: str = exporter.from_notebook_node(notebook, resources=where)[0]
        return body.replace("</head>", head, 1)

    with staged_folder(target) as folder:
        if script:
            (folder / "mathjax.js").write_text(script, encoding="utf-8")
        for path in paths:
            print(path.name, flush=True)
            notebook = nbformat.read(path, as_version=4)
            notebook.cells.insert(0, nbformat.v4.new_code_cell(STILL))
            client = NotebookClient(notebook, timeout=120, resources={"metadata": {"path": str(source)}})
            try:
                client.execute(env=os.environ | {"MPLBACKEND": "module://matplotlib_inline.backend_inline"})
            except CellExecutionError as error:
                raise ValueError(f"{path.name}: a cell failed with {error.ename}: {error.evalue}") from error
            del notebook.cells[0]
            for cell in (cell for cell in notebook.cells if cell.cell_type == "code"):
                cell.execution_count -= 1
                for output in cell.outputs:
                    if WIDGET in output.get("data", {}):
                        output.data = {"text/plain": NO_WIDGET}
            notebook.metadata.pop("widgets", None)  # their script would come from the network
            (folder / f"{path.stem}.html").write_text(page(notebook, path.stem), encoding="utf-8")
        text = (source / "README.md").read_text(encoding="utf-8")
        index = nbformat.v4.new_notebook(cells=[nbformat.v4.new_markdown_cell(text)])
        (folder / "index.html").write_text(page(index, "endolab: the notebooks"), encoding="utf-8")


def main(arguments: Sequence[str]) -> int:
    """Render pages: ``python -m endolab.pages notebooks build/html``."""
    try:
        render_pages(*arguments)
    except (ValueError, OSError) as error:
        print(f"endolab: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))

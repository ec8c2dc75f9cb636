"""Static pages of notebooks: links, formulas, folds, stills of what moves, nothing from outside."""

import base64
import io
import re
from pathlib import Path

import nbformat
import numpy as np
import pytest
from bs4 import BeautifulSoup
from nbclient.exceptions import CellTimeoutError
from PIL import Image

from tests.tools import render_pages as pages
from tests.tools import stills
from tests.tools.notebook_solutions import solutions

NOTEBOOKS = Path(__file__).resolve().parents[2] / "notebooks"

TEXT = '$x^2$ [next](02_b.ipynb#end) [code](../a/b.py#L1 "f") [home](README.md) [web](https://x.org)'
SLIDER = "from ipywidgets import interact\n@interact(a=(0, 9))\ndef show(a=4):\n    print(f'a is {a}')"


def write(path, *code):
    cells = [nbformat.v4.new_markdown_cell(TEXT), *map(nbformat.v4.new_code_cell, code)]
    nbformat.write(nbformat.v4.new_notebook(cells=cells), path)


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_pages_stand_alone(tmp_path, capsys):
    pytest.importorskip("dash")  # the formulas' script
    notebooks, html = tmp_path / "notebooks", tmp_path / "build" / "html"
    notebooks.mkdir()
    for name in ("README", "QUESTIONS", "ANSWERS"):
        (notebooks / f"{name}.md").write_text("[one](01_a.ipynb)")
    write(notebooks / "01_a.ipynb", SLIDER, "from ipywidgets import IntSlider\nIntSlider()")
    assert pages.main([str(notebooks), str(html)]) == 0
    page = (html / "01_a.html").read_text(encoding="utf-8")
    assert [said for said in ("a is 0", "a is 4", "a is 9") if said in page] == ["a is 0", "a is 4", "a is 9"]
    assert BeautifulSoup(page, "html.parser").find("input", checked=True).find_next("label").text == "4"
    assert pages.NO_WIDGET in page
    for link in ("02_b.html#end", "../../a/b.py#L1", "index.html", "https://x.org"):
        assert f'href="{link}"' in page
    assert set(re.findall(r'<script src="([^"]*)"', page)) == {"data:,", "mathjax.js"}
    assert 'href="01_a.html"' in (html / "index.html").read_text(encoding="utf-8")
    assert "MathJax" in (html / "mathjax.js").read_text(encoding="utf-8")
    assert "01_a.html" in (html / "QUESTIONS.html").read_text(encoding="utf-8")
    assert (html / "api" / "index.html").is_file()
    assert not (html / "ANSWERS.html").exists()

    (notebooks / "README.md").write_text("[answers](ANSWERS.md)")
    assert pages.main([str(notebooks), str(html), "--solutions"]) == 0
    assert "as it was run before" in capsys.readouterr().out
    assert 'href="ANSWERS.html"' in (html / "index.html").read_text(encoding="utf-8")
    assert (html / "ANSWERS.html").is_file()

    write(notebooks / "01_a.ipynb", "1 / 0")
    assert pages.main([str(notebooks), str(html.with_name("other"))]) == 2
    said = "endolab: 01_a.ipynb: a cell failed with ZeroDivisionError: division by zero"
    assert said in capsys.readouterr().err
    assert not html.with_name("other").exists()


WIDGETS = """import endolab as el
calibration = el.load_calibration("paper", width=160)
scene = el.render(el.SCENES["plane"], calibration.camera, calibration.photometry)
frame, known = el.Frame(scene.image, scene.mask), el.Calibration(scene.camera, scene.photometry)
result = el.reconstruct(frame, known, observers=[el.record("run.rrd")])"""


@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::ResourceWarning")
def test_the_tuner_a_recording_and_a_surface_have_stills(tmp_path):
    notebooks = tmp_path / "notebooks"
    notebooks.mkdir()
    write(notebooks / "01_a.ipynb", WIDGETS, 'el.tune(scene="plane", width=160)', "el.show('run.rrd')")
    path = notebooks / "01_a.ipynb"
    notebook = nbformat.read(path, as_version=4)
    notebook.cells.append(nbformat.v4.new_code_cell("el.show_surface(result)"))
    nbformat.write(notebook, path)
    *_, tuner, recording, surface = pages.executed(path, tmp_path / "executed").cells
    shown = [
        BeautifulSoup(one.outputs[-1].data["text/html"], "html.parser") for one in (tuner, recording, surface)
    ]
    board, *strip = shown[0].find_all("img")
    assert "median error" in board["alt"]
    named = [one.text.partition(":")[0] for one in shown[0].find_all("figcaption")]
    assert named == [f"λ = {times:g}" for times in stills.STRIP]
    assert len(strip) == len(named)
    assert shown[1].label.text == "0"
    assert len(shown[1].find_all("img")) == len(shown[1].find_all("input")) > 2
    assert shown[2].img["src"].startswith("data:image/png;base64,")
    assert "webgl2" in shown[2].script.text


def parts(path, change=lambda text: text):
    """A notebook as a page, without its cells of code: text in closed folds, in open ones, in none."""
    notebook = nbformat.read(path, as_version=4)
    notebook.cells = [cell for cell in notebook.cells if cell.cell_type == "markdown"]
    for cell in notebook.cells:
        cell.source = change(cell.source)
    where = {"metadata": {"name": path.stem, "path": str(path.parent)}}
    page = BeautifulSoup(pages.PageExporter().from_notebook_node(notebook, where)[0], "html.parser").main
    folds = [fold.extract() for fold in page.find_all("details")]
    folded = "".join(fold.text for fold in folds if "open" not in fold.attrs)
    return folded, "".join(fold.text for fold in folds if "open" in fold.attrs), page.text


@pytest.mark.parametrize("path", sorted(NOTEBOOKS.glob("*.ipynb")), ids=lambda path: path.stem)
def test_no_solution_is_in_view(path):
    code = "".join(solutions(nbformat.read(path, as_version=4).cells)).splitlines()
    code = [line for line in code if line.strip()]
    folded, unfolded, rest = parts(path)
    assert code
    assert all(line in folded and line not in rest for line in code)
    assert unfolded == ""
    assert "Next:" in rest
    hints, unfolded, still = parts(path, pages.opened)
    assert all(line in unfolded for line in code)
    assert still == rest
    assert "Solution" not in hints
    assert len(hints) + len(unfolded) == len(folded)


def test_solutions_are_opened_and_hints_are_not():
    hint, solution = "<details><summary>Hint 1</summary>", "<details>\n<summary>Solution</summary>"
    assert pages.opened(hint + solution) == hint + solution.replace("<details>", "<details open>")


def test_a_picture_is_packed_if_that_is_smaller(rng):
    noise = rng.uniform(0, 255, (99, 99)).astype(np.uint8)
    for picture, kind in ((Image.fromarray(noise > 127), "png"), (Image.fromarray(noise), "webp")):
        stream = io.BytesIO()
        picture.save(stream, "png")
        content = base64.b64encode(stream.getvalue()).decode()
        packed = re.fullmatch(
            r"<img src='data:image/(\w+);base64,(.*)'>",
            pages.smaller(f"<img src='data:image/png;base64,{content}'>"),
        )
        assert packed[1] == kind
        assert len(packed[2]) <= len(content)
        assert Image.open(io.BytesIO(base64.b64decode(packed[2]))).size == picture.size


def test_hidden_code_is_folded_and_pictures_are_embedded(tmp_path):
    (tmp_path / "a.png").write_bytes(b"picture")
    shown, hidden = (nbformat.v4.new_code_cell(code) for code in ("a = 1", "b = 2"))
    hidden.metadata["jupyter"] = {"source_hidden": True}
    hidden.outputs = [nbformat.v4.new_output("stream", text="its output")]
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_markdown_cell("![a](a.png)"), shown, hidden])
    where = {"metadata": {"name": "a", "path": str(tmp_path)}}
    page = BeautifulSoup(pages.PageExporter().from_notebook_node(notebook, where)[0], "html.parser").main
    assert page.img["src"].startswith("data:image/png;base64,")
    (fold,) = page.find_all("details")
    fold.extract()
    assert "b = 2" in fold.text
    assert "a = 1" in page.text
    assert "its output" in page.text
    assert "b = 2" not in page.text


def test_a_notebook_that_does_not_end_is_run_once_more(tmp_path, monkeypatch):
    runs = []

    def ran(path):
        runs.append(path)
        if len(runs) == 1:
            raise CellTimeoutError("it waits for good")
        return nbformat.read(path, as_version=4)

    monkeypatch.setattr(pages, "ran", ran)
    write(tmp_path / "01_a.ipynb", "1")
    assert pages.executed(tmp_path / "01_a.ipynb", tmp_path / "kept").cells[1].source == "1"
    assert len(runs) == 2


def test_a_folder_without_notebooks(tmp_path, capsys):
    assert pages.main([str(tmp_path), str(tmp_path / "html")]) == 2
    assert capsys.readouterr().err.endswith("there are no notebooks\n")

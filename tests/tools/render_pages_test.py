"""Static pages of notebooks: links, formulas, sliders that stand still, nothing from outside."""

import re

import nbformat
import pytest

from tests.tools import render_pages as pages

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
    (notebooks / "README.md").write_text("[one](01_a.ipynb)")
    write(notebooks / "01_a.ipynb", SLIDER, "from ipywidgets import IntSlider\nIntSlider()")
    assert pages.main([str(notebooks), str(html)]) == 0
    page = (html / "01_a.html").read_text(encoding="utf-8")
    assert "a is 4" in page
    assert pages.NO_WIDGET in page
    for link in ("02_b.html#end", "../../a/b.py#L1", "index.html", "https://x.org"):
        assert f'href="{link}"' in page
    assert set(re.findall(r'<script src="([^"]*)"', page)) == {"data:,", "mathjax.js"}
    assert 'href="01_a.html"' in (html / "index.html").read_text(encoding="utf-8")
    assert "MathJax" in (html / "mathjax.js").read_text(encoding="utf-8")

    write(notebooks / "01_a.ipynb", "1 / 0")
    assert pages.main([str(notebooks), str(tmp_path / "other")]) == 2
    said = "endolab: 01_a.ipynb: a cell failed with ZeroDivisionError: division by zero"
    assert said in capsys.readouterr().err
    assert not (tmp_path / "other").exists()


def test_a_folder_without_notebooks(tmp_path, capsys):
    assert pages.main([str(tmp_path), str(tmp_path / "html")]) == 2
    assert capsys.readouterr().err.endswith("there are no notebooks\n")

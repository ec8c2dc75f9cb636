"""Decks of slides in a browser: whatever they hold, nothing is cut off; keys, formulas, the whole text."""

import base64
import io
from pathlib import Path

import nbformat
import pytest
from bs4 import BeautifulSoup
from PIL import Image

from tests.browser.conftest import NOTEBOOKS, SCREENSHOTS
from tests.tools import render_pages as pages
from tests.tools import render_slides as slides

OVER = """() => [...document.querySelectorAll('.slide')].filter((slide) => {
    const body = slide.querySelector('.body');
    return slide.scrollHeight > slide.clientHeight || body.scrollHeight > body.clientHeight
        || body.scrollWidth > body.clientWidth;
}).map((slide) => slide.innerText)"""
CODE, DRAWN = "\n".join(f"a = {i}" for i in range(9)), "b = 1\nc = 2"
TITLE = "1 · Angles $\\alpha$"
TEXT = (
    f"{'A long sentence. ' * 5}\n\n$$\\mu' = \\cos^k\\alpha$$\n\n"
    + "A paragraph of its own, of some words.\n\n" * 30
)
TABLE = "\n".join(["| a | b |", "|---|---|", *(f"| {i} | {i} |" for i in range(60))])
WIDE = "\n".join("|" + f" {part} |" * 60 for part in ("head", "---", "cell"))
FOLDS = "<details><summary>Hint 1</summary>\n\nThink.\n</details>\n"
FOLDS += "<details><summary>Solution</summary>\n\n42\n</details>"


def picture(width, height):
    """An output of that many pixels."""
    stream = io.BytesIO()
    Image.new("RGB", (width, height), "teal").save(stream, "png")
    data = {"image/png": base64.b64encode(stream.getvalue()).decode()}
    return nbformat.v4.new_output("display_data", data=data)


def code(source, *outputs):
    cell = nbformat.v4.new_code_cell(source)
    cell.outputs = list(outputs)
    return cell


@pytest.fixture
def opened(browser, tmp_path):
    """Function that opens a notebook's deck, for a screen of 1280 by 720."""
    deck_pages = []

    def open_it(notebook, folder):
        head = pages.write_formulas(tmp_path)
        path = tmp_path / "deck.html"
        path.write_text(slides.deck("a", slides.sections(notebook, folder), head), encoding="utf-8")
        deck_pages.append(browser.new_page(viewport={"width": 1280, "height": 720}))
        deck_pages[-1].goto(path.as_uri())
        deck_pages[-1].locator("body.ready").wait_for(state="attached")
        return deck_pages[-1]

    yield open_it
    for page in deck_pages:
        page.close()


def test_nothing_is_cut_off_and_keys_step(opened):
    pytest.importorskip("dash")  # the formulas' script
    long = nbformat.v4.new_output("stream", text="line\n" * 200)
    cells = [f"# A deck\n{'Word ' * 20}end. The rest.", f"## {TITLE}\n{TEXT}", code(CODE, picture(700, 1500))]
    cells += [
        f"{'About it. ' * 20}",
        code(CODE, long),
        code(CODE * 9, picture(4000, 300)),
        "## Table\n" + TABLE,
    ]
    cells += [
        code(DRAWN, picture(600, 400), nbformat.v4.new_output("stream", text="told")),
        "It is so.",
        FOLDS,
    ]
    cells += [f"## Wide\n$$x = {' + '.join('abcdefgh' * 9)}$$\n\n{WIDE}"]
    notebook = nbformat.v4.new_notebook(
        cells=[nbformat.v4.new_markdown_cell(one) if isinstance(one, str) else one for one in cells]
    )
    page = opened(notebook, Path())
    assert page.evaluate(OVER) == []
    assert page.locator(".slide h2 mjx-container").count() > 2  # of each slide of that section
    assert page.locator(".slide .body mjx-container").count() == 2
    figures = page.locator(".slide img").evaluate_all(
        "all => all.map((one) => [one.offsetWidth, one.offsetHeight])"
    )
    assert len(figures) == 3
    assert all(width == 1200 or height >= 300 for width, height in figures)
    with_figure = page.locator(".slide", has=page.locator("img")).last
    assert "told" in with_figure.text_content()
    assert "It is so." in with_figure.text_content()
    assert not any(page.get_by_text(secret).count() for secret in ("Hint 1", "Think.", "Solution"))

    count = page.locator(".slide").count()
    rest = page.get_by_text("The rest.")
    assert not rest.is_visible()
    page.keyboard.press("t")
    assert rest.is_visible()
    assert page.evaluate(OVER) == []
    page.keyboard.press("t")
    assert page.locator(".slide").count() == count
    for key, at in (("ArrowRight", 2), ("End", count), ("ArrowLeft", count - 1), ("Home", 1), (" ", 2)):
        page.keyboard.press(key)
        assert page.evaluate("location.hash") == f"#{at}"
        assert page.locator(".slide.now").count() == 1
    page.keyboard.press("o")
    page.locator(".slide").nth(2).click()
    assert page.evaluate("location.hash") == "#3"
    assert page.locator("body.overview").count() == 0
    SCREENSHOTS.mkdir(parents=True, exist_ok=True)
    page.screenshot(path=SCREENSHOTS / "slides.png")


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_no_slide_of_a_notebook_is_cut_off(opened, path):
    notebook = nbformat.read(path, as_version=4)
    for cell in notebook.cells:
        if cell.cell_type == "code" and "plt.show()" in cell.source:
            cell.outputs = [picture(1100, 500)]
    page = opened(notebook, path.parent)
    assert page.evaluate(OVER) == []
    titles = [BeautifulSoup(title, "html.parser").text for title, _ in slides.sections(notebook, path.parent)]
    assert page.locator(".slide").count() >= len(titles) > 3

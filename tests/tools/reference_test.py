"""The reference: what is public has a place, links lead somewhere, notebooks and entries to each other."""

import ast
import json

import pytest
from bs4 import BeautifulSoup

import endolab as el
from tests.tools import reference as pages

NOTEBOOKS = sorted((pages.PACKAGE.parent / "notebooks").glob("*.ipynb"))


@pytest.fixture(scope="module")
def reference():
    """The library's, with what the notebooks use."""
    made = pages.Reference()
    for path in NOTEBOOKS:
        cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
        made.scan(path.stem, ["".join(cell["source"]) for cell in cells if cell["cell_type"] == "code"])
    return made


@pytest.fixture(scope="module")
def written(reference, tmp_path_factory):
    """Its pages, parsed, by their names."""
    folder = tmp_path_factory.mktemp("html")
    (folder / "api").mkdir()
    for path in NOTEBOOKS:
        (folder / f"{path.stem}.html").write_text("")
    (folder / "index.html").write_text("")
    pages.write_reference(reference, folder / "api", str(pages.PACKAGE))
    return {path: BeautifulSoup(path.read_text(), "html.parser") for path in (folder / "api").iterdir()}


def test_what_the_library_gives_has_an_entry_with_a_text(reference):
    for name in el.__all__:
        if name != "__version__" and name not in reference.folders:
            entry = reference.short[f"endolab.{name}"]
            assert entry.is_shown
            assert entry.text or entry.is_constant
            assert entry.called[0] == f"el.{name}"


def test_every_link_leads_somewhere(written):
    ids = {path: {one["id"] for one in page.find_all(id=True)} for path, page in written.items()}
    links = 0
    for path, page in written.items():
        for link in page.find_all("a"):
            target, _, place = link["href"].partition("#")
            there = (path.parent / target).resolve()
            assert there.exists(), link
            if there in ids and place:
                assert place in ids[there], link
                links += 1
    assert links > 1000


def test_an_entry_names_the_notebooks_that_use_it(reference, written):
    entry = reference.find("el.reconstruct", pages.USUAL)
    assert "00_quickstart" in entry.used
    page = next(page for path, page in written.items() if path.name == "reconstruction.html")
    section = page.find(id="reconstruct.reconstruct")
    assert "../00_quickstart.html" in [link["href"] for link in section.find_all("a")]
    assert [term.code.text for term in section.dl.find_all("dt")][:2] == ["frame", "calibration"]


def test_what_a_notebook_uses_is_found_under_any_of_its_names(reference):
    made = pages.Reference()
    cells = ["from endolab.plots import style as s\ns.use()", "import endolab as e\ne.Calibration.load(1)"]
    known = made.scan("a", cells)
    assert made.by_name["endolab.plots.style.use"].used == ["a"]
    assert made.by_name["endolab.Calibration.load"].used == ["a"]
    assert known["e"] == "endolab"
    known |= made.scan("b", ["from endolab.tuning.engine import Tuner"])
    assert 'href="api/tuning.html#engine.Tuner"' in pages.linked(
        '<span class="n">Tuner</span>(1)', made, known
    )
    assert made.find("plots.nothing", known) is None
    assert made.find("np.load", known) is None


@pytest.mark.parametrize(
    "given",
    [
        "<code>el.reconstruct</code>",
        "<code>el.reconstruct(frame)</code>",
        '<span class="n">el</span><span class="o">.</span><span class="n">reconstruct</span>',
    ],
)
def test_names_on_a_page_lead_to_the_reference(reference, given):
    page = pages.linked(f"<p>{given}</p>", reference, pages.USUAL)
    link = BeautifulSoup(page, "html.parser").a
    assert link["href"] == "api/reconstruction.html#reconstruct.reconstruct"
    assert given in page


@pytest.mark.parametrize("given", ["<code>np.load</code>", '<a href="x"><code>el.run</code></a>', "el.run"])
def test_other_names_stay_as_they_are(reference, given):
    assert pages.linked(given, reference, pages.USUAL) == given


def test_a_signature_stands_as_it_is_written():
    node = ast.parse("def f(self, a, b: int = 2, *rest, c=3, d: str, **more: int) -> None: ...").body[0]
    assert pages.signature(node, "f") == "f(a, b: int = 2, *rest, c=3, d: str, **more: int) -> None"
    node = ast.parse("def f(a: int, /, *, c: tuple[int, int] = (1, 2)): ...").body[0]
    assert pages.signature(node, "f") == "f(a: int, *, c: tuple[int, int] = (1, 2))"
    long = pages.signature(node, "f" * pages.WIDE)
    assert long.splitlines()[1:] == ["    a: int,", "    *,", "    c: tuple[int, int] = (1, 2),", ")"]


def test_a_docstring_is_read_as_numpydoc_means_it():
    text = "Do ``it``.\n\nParameters\n----------\na : int\n    How *often*.\nb : Frame\n"
    text += "\nRaises\n------\nValueError\n    If not."
    page = BeautifulSoup(pages.rendered(text, lambda name: f"<code>[{name}]</code>"), "html.parser")
    assert [one.text for one in page.find_all("h4")] == ["Parameters", "Raises"]
    assert [one.text for one in page.find_all("dt")] == ["a int", "b [Frame]", "ValueError "]
    assert page.em.text == "often"
    assert page.p.text == "Do [it]."


def test_a_constant_is_told_by_the_lines_above_it():
    source = "# Of all,\n# the most.\nMOST: int = 3\nless = 2\n_HIDDEN = 1\n"
    (entry,) = pages.entries("folder", "module", source)
    assert (entry.name, entry.text, entry.signature) == ("MOST", "Of all, the most.", "MOST: int = 3")
    assert not entry.is_shown

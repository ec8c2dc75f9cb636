"""What stands for controls on a page: which positions of a slider, and HTML to choose from."""

import ipywidgets as w
import pytest
from bs4 import BeautifulSoup

from tests.tools import stills


@pytest.mark.parametrize(
    ("count", "own"), [(3, 1), (5, 4), (45, 22), (45, 0), (45, 44), (45, 3), (45, 43), (9, 4)]
)
def test_a_few_positions_are_spread_with_its_own_among_them(count, own):
    found = stills.spread(count, own)
    assert found == sorted(set(found))
    assert {0, own, count - 1} <= set(found)
    assert len(found) == min(count, stills.MOST)


@pytest.mark.parametrize(
    ("control", "labels", "first"),
    [
        (w.IntSlider(min=0, max=8, value=6), ["0", "2", "4", "6", "8"], 3),
        (w.FloatSlider(min=0.1, max=0.3, step=0.1, value=0.2), ["0.1", "0.2", "0.3"], 1),
        (w.SelectionSlider(options=[("a", 1), ("b", 2)], value=2), ["a", "b"], 1),
        (w.Dropdown(options=["x", "y"], value="x"), ["x", "y"], 0),
        (w.Checkbox(value=True), ["True"], 0),
    ],
)
def test_positions_of_a_control(control, labels, first):
    places, own = stills.positions(control)
    assert ([label for label, _ in places], own) == (labels, first)
    assert places[own][1] == control.value


def test_pieces_are_chosen_by_their_labels():
    page = BeautifulSoup(stills.chosen_from("a <", [("1", "one"), ("<2>", "two")], 1), "html.parser")
    inputs, labels = page.find_all("input"), page.find_all("label")
    assert [one.has_attr("checked") for one in inputs] == [False, True]
    assert [one["for"] for one in labels] == [one["id"] for one in inputs]
    assert [one.text for one in labels] == ["1", "<2>"]
    assert len({one["name"] for one in inputs}) == 1
    assert page.div.div.find_all("div")[1].text == "two"
    other = BeautifulSoup(stills.chosen_from("", [("1", "one")]), "html.parser")
    assert other.input["name"] != inputs[0]["name"]

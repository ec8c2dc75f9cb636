"""The tuner's page with no Python behind it: what it asks for, and what it makes of what it is told."""

import contextlib
import json
from pathlib import Path

import pytest

import endolab as el
from endolab.workbench.tuning import widget
from tests.browser.conftest import SAID, photograph

# Takes Python's place: keeps what is asked for, and says what a test says.
PAGE = """<!DOCTYPE html><meta charset="utf-8"><style>{style}</style><div id="place"></div>
<script type="module">{script}
window.sent = [];
const model = {{
  get: () => ({facts}), off() {{}},
  on(event, hear) {{ if (event === "msg:custom") window.hear = hear; }},
  send: (wish) => window.sent.push([wish.do, ...wish.given]),
}};
window.say = (message, arrays) => {{
  const bytes = ["picture", "cuts"], names = Object.keys(arrays);
  const kinds = names.map((name) => [name, bytes.includes(name) ? "u1" : "f4"]);
  const buffers = kinds.map(([name, kind]) => {{
    const some = (kind === "u1" ? Uint8Array : Float32Array).from(arrays[name]);
    return new DataView(some.buffer);
  }});
  window.hear({{ ...message, names: kinds }}, buffers);
}};
render({{ model, el: document.getElementById("place") }});
</script>"""
WIDTH, HEIGHT = 16, 12  # px
MAPS = {"distance": {"title": ""}, "model - frame": {"title": ""}}


class Tuner:
    """A page, and what Python would do: each wish has a state, and what is found anew has a number."""

    def __init__(self, page, facts):
        self.page = page
        self.state = 0
        still = {"width": WIDTH, "height": HEIGHT, "window": [0, 0, WIDTH, HEIGHT]}
        self.still = still | {"unit": "mm", "metric": True, "has_gain": True}
        self.knobs = facts["first"]
        size = WIDTH * HEIGHT
        rays = [0.1, 0.1, 0.99] * size
        fixed = {"picture": [128] * 4 * size, "rays": rays, "cuts": [0] * size}
        first = {"still": self.still, "knobs": self.knobs, "anew": True}
        self.answer(first, fixed | {"truth": []})

    def say(self, message, arrays=None):
        self.page.evaluate(
            "([message, arrays]) => say(message, arrays)", [message, arrays or {}]
        )

    def answer(self, more=(), arrays=()):
        """Say a final answer: its state and what was found are as they are now."""
        size = WIDTH * HEIGHT
        maps = {
            "distance": [20 + i / size for i in range(size)],
            "model - frame": [0] * size,
        }
        message = {"state": self.state, "found": 0, "asked": self.knobs}
        message |= {"moving": False, "label": "λ, 99 %", "line": f"answer {self.state}"}
        message |= {"maps": MAPS, "path": [1, 2, 3], "curve": {"title": "a curve"}}
        self.say(message | dict(more), maps | dict(arrays))

    def sent(self, action):
        """What was asked for since it was looked at last, of one kind."""
        sent = self.page.evaluate(
            "() => JSON.parse(JSON.stringify(window.sent.splice(0)))"
        )
        return [given for name, *given in sent if name == action]

    def type_into(self, name, text):
        line = self.page.locator(f".endolab-{name} input").first
        line.fill(text)
        line.press("Enter")
        return line


@pytest.fixture(scope="module")
def facts():
    """What the page is told at first."""
    box = el.tune(scene="plane", width=32)
    with contextlib.closing(box):
        return box.facts | {"with_energy": ["gauss_newton", "primal_dual"]}


@pytest.fixture
def tuner(browser, facts, tmp_path):
    script = widget.page_script("tuner")
    style = Path(widget.__file__).with_name("tuner.css").read_text(encoding="utf-8")
    page = PAGE.format(script=script, style=style, facts=json.dumps(facts))
    (tmp_path / "page.html").write_text(page, encoding="utf-8")
    page = browser.new_page(viewport={"width": 1366, "height": 768})
    page.clock.install()
    complaints = []
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto((tmp_path / "page.html").as_uri())
    yield Tuner(page, facts)
    page.close()
    assert complaints == []


def test_a_knob_with_nothing_to_turn_is_off_and_says_why(tuner):
    page = tuner.page
    page.get_by_role("button", name="more ...").click()
    of_energy = ("lam", "regulariser", "xi", "epsilon", "threshold")
    controls = {
        name: page.locator(f".endolab-knob.endolab-{name}")
        for name in (*of_energy, "gain", "k", "max_iterations")
    }

    def off():
        inputs = "input:enabled, select:enabled"
        return {
            name for name, knob in controls.items() if not knob.locator(inputs).count()
        }

    assert off() == set()
    for solver in ("fast_marching", "facing"):
        page.locator(".endolab-solver select").select_option(json.dumps(solver))
        assert off() == {*of_energy}
        assert "no energy" in controls["lam"].get_attribute("title")
    page.locator(".endolab-lam input").first.focus()
    assert page.evaluate("document.activeElement.tagName") != "INPUT"
    photograph(page, "tuner_knobs_off")
    page.locator(".endolab-solver select").select_option(json.dumps("primal_dual"))
    assert off() == set()
    assert "smoother" in controls["lam"].get_attribute("title")
    tuner.say({"still": tuner.still | {"has_gain": False}})
    assert off() == {"gain"}
    assert "unknown" in controls["gain"].get_attribute("title")


def test_the_way_to_an_answer_is_played_once_and_stops_for_a_new_one(tuner):
    page = tuner.page
    play = page.locator(".endolab-film button")
    play.click()
    page.clock.run_for(2000)
    assert tuner.sent("iterate") == [[1, 0], [2, 0], [3, 0]]
    assert play.inner_text() == "▶"
    play.click()
    page.clock.run_for(130)
    tuner.state = 1
    look = {"moving": True, "path": None}
    tuner.answer(look)
    tuner.sent("iterate")
    page.clock.run_for(2000)
    assert tuner.sent("iterate") == []
    assert play.is_disabled()
    assert page.locator(".endolab-film span").inner_text() == ""
    tuner.answer()
    assert play.is_enabled()
    play.click()
    page.clock.run_for(130)
    assert tuner.sent("iterate") == [[1, 1]]


def test_what_belongs_to_another_state_is_not_drawn(tuner):
    page = tuner.page
    page.get_by_label("panel").nth(2).select_option("σ")
    title = page.locator(".endolab-head span").nth(2)
    of_sigma = MAPS | {"σ": {"title": "of the distance"}}
    tuner.answer({"maps": of_sigma}, {"σ": [3] * WIDTH * HEIGHT})
    assert title.inner_text() == "of the distance"
    chips = [
        {"chip": f"{word} " * 9, "text": word} for word in ("smooth", "dim", "wet")
    ]
    tuner.say({"chips": chips * 3, "state": 0})
    chip = page.locator(".endolab-chip")
    assert "+ " in chip.last.inner_text()  # and none is cut off
    assert page.evaluate("() => innerWidth") > chip.last.evaluate(
        "one => one.getBoundingClientRect().right"
    )
    tuner.state = 1
    tuner.answer()
    assert chip.count() == 0
    assert title.inner_text() == "with the next answer"
    tuner.say({"sigma": {"done": 1, "of": 8}, "state": 0})
    assert page.evaluate(SAID) == "answer 1"


def test_sigma_says_how_far_it_is_and_whose_it_is(tuner):
    tuner.state = 7
    tuner.answer()
    tuner.page.get_by_role("button", name="find σ").click()
    assert tuner.sent("sigma") == [[7]]
    tuner.say({"sigma": {"done": 3, "of": 8}, "state": 7})
    assert tuner.page.evaluate(SAID) == "finding σ: 3 of 8"


def test_what_is_typed_and_is_no_number_leaves_the_value(tuner):
    """A typed 0 was sent as a text, and after a typed text λ went to the place of its slider."""
    tuner.page.get_by_role("button", name="more ...").click()
    for name in ("smooth", "lam", "k"):
        tuner.type_into(name, "0.43")
        assert [values[name] for values, *_ in tuner.sent("turn")] == [0.43]
        line = tuner.type_into(name, "abc")
        assert tuner.sent("turn") == []
        assert line.input_value() == "0.43"

"""The model's bench and a film in a page without a kernel: they are `el.render`'s, and follow the hand."""

import numpy as np
from matplotlib import pyplot

import endolab as el
from endolab.synthetic.scenes import Plane
from endolab.workbench.plots import film
from endolab.workbench.tuning.bench import NODES, bench
from tests.browser.conftest import photograph

CAMERA = el.load_calibration("paper", width=240).camera
SETTINGS = [
    {"k": 1, "m": 1.5, "gamma": 2.2, "lamp": 0, "tilt": 20, "depth": 60},
    {"k": 0, "m": 2, "gamma": 1, "lamp": 6, "tilt": -40, "depth": 25},
    {"k": 3, "m": 0, "gamma": 2.8, "lamp": -4, "tilt": 0, "depth": 120},
    {"k": 2, "m": 3, "gamma": 1.4, "lamp": 2, "tilt": 60, "depth": 40},
    {"k": 0, "m": 0, "gamma": 2, "lamp": 0, "tilt": -10, "depth": 15},
]
TURN = """knobs => Object.entries(knobs).forEach(([name, value]) => {
  const slider = document.querySelector(`input[name=${name}]`);
  slider.value = value;
  slider.oninput();
})"""
STATE = """() => {
  const { image, misread, marks, knobs, brdf, drawn } = document.querySelector("div").bench;
  return { image: [...image], misread, marks, knobs, brdf, drawn };
}"""


def open_page(browser, tmp_path, content):
    page = browser.new_page()
    (tmp_path / "a.html").write_text(
        f"<!DOCTYPE html><meta charset=utf-8>{content.data}"
    )
    page.goto((tmp_path / "a.html").as_uri())
    return page


def drawn_since(page, count):
    page.wait_for_function(
        "count => document.querySelector('div').bench.drawn > count", arg=count
    )
    return page.evaluate(STATE)


def drag(page, start, *ends):
    """Drag from a place to others; returns how many pictures were drawn meanwhile."""
    count = page.evaluate(STATE)["drawn"]
    page.mouse.move(*start)
    page.mouse.down()
    for end in ends:
        page.mouse.move(*end, steps=20)
    page.mouse.up()
    return drawn_since(page, count)["drawn"] - count


def test_the_bench_draws_what_the_model_renders(browser, tmp_path):
    page = open_page(browser, tmp_path, bench(CAMERA, el.Photometry()))
    page.get_by_role("button", name="paper").click()
    box = page.locator("canvas").last.bounding_box()  # drag a node of the BRDF
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    before = page.evaluate(STATE)["brdf"]
    page.mouse.click(x, y - 60)  # far from the line: nothing is caught
    assert page.evaluate(STATE)["brdf"] == before
    drag(page, (x, y), (x, y - 40))
    assert np.sum(np.subtract(page.evaluate(STATE)["brdf"], before) != 0) == 1
    for setting in SETTINGS:
        count = page.evaluate(STATE)["drawn"]
        page.evaluate(TURN, setting)
        state = drawn_since(page, count)
        knobs = state["knobs"]
        lamp = el.SpotLight((knobs["lamp"], 0, 0), exponent=knobs["m"])
        light = el.Photometry(
            k=knobs["k"],
            gamma=knobs["gamma"],
            gain=knobs["gain"],
            brdf=el.TabulatedBRDF(NODES, state["brdf"]),
            lights=[lamp],
        )
        seen = el.render(Plane(knobs["depth"], knobs["tilt"]), CAMERA, light)
        image = np.reshape(np.array(state["image"], float), seen.mask.shape)
        assert np.array_equal(np.isfinite(image), seen.mask)
        assert np.abs(image - seen.image)[seen.mask].max() < 1 / 255
        place = seen.mask.shape[0] // 2, [60, 180]
        points = CAMERA.field.rays[place] * seen.distance[place][:, None]
        linear, centred = (
            one.intensity(points, seen.normals[place]) ** one.gamma
            for one in (light, light.simplify())
        )
        off = 100 * (np.sqrt(centred / linear) - 1)
        np.testing.assert_allclose(state["misread"], off, atol=0.05)
        places = CAMERA.field.rays * seen.distance[..., None]
        far = np.linalg.norm(places - np.array(lamp.position), axis=-1)
        linear = light.intensity(places, seen.normals) ** light.gamma
        nearest, brightest, _ = state["marks"]
        np.testing.assert_allclose(far.flat[nearest], np.nanmin(far), rtol=1e-6)
        np.testing.assert_allclose(linear.flat[brightest], np.nanmax(linear), rtol=1e-5)
    box = page.locator("canvas").nth(3).bounding_box()  # of cos θ
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    row, column = CAMERA.height // 2, CAMERA.width // 2
    page.wait_for_function("() => document.querySelector('div').bench.marks[2] >= 0")
    assert page.evaluate(STATE)["marks"][2] == row * CAMERA.width + column
    values = [
        float(text) for text in page.locator("canvas + div").all_inner_texts()[:6]
    ]
    np.testing.assert_allclose(values[1], far[row, column] ** -2, rtol=5e-3)
    np.testing.assert_allclose(values[5], seen.image[row, column], atol=2 / 255)
    photograph(page, "bench")
    box = page.locator("input[name=tilt]").bounding_box()
    left, right, y = box["x"] + 5, box["x"] + box["width"] - 5, box["y"] + 8
    assert drag(page, (left, y), (right, y), (left, y)) > 10  # 40 moves
    page.close()


def test_a_film_plays_and_follows_its_sliders(browser, tmp_path):
    def draw(step, side=1):
        pyplot.subplots(figsize=(3, 2))[1].plot([0, step], [side, 0])

    page = open_page(
        browser, tmp_path, film(draw, step=range(4), side={"0": 0, "1": 1})
    )
    seen = [page.locator("img").get_attribute("src")]
    assert page.locator("output").all_text_contents() == ["0", "1"]
    page.get_by_role("button").click()
    page.wait_for_function("() => document.querySelector('output').textContent === '3'")
    page.get_by_role("button", name="▶").wait_for()
    seen.append(page.locator("img").get_attribute("src"))
    page.locator("input").last.focus()
    page.keyboard.press("ArrowLeft")
    seen.append(page.locator("img").get_attribute("src"))
    assert page.locator("output").all_text_contents() == ["3", "0"]
    assert len(set(seen)) == 3
    page.close()

"""The tuner's screen follows from its knobs, and from those by which light and contours were found."""

import gc
import json
import os
import time
from contextlib import closing
from dataclasses import replace
from functools import partial
from types import FunctionType, ModuleType

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import endolab as el
from endolab.io.images import write_image
from endolab.numerics.iteration import finish
from endolab.reconstruction.pipeline import find
from endolab.reconstruction.report import SOLVER_NAMES, meaning
from endolab.workbench.tuning import engine
from endolab.workbench.tuning.source import Knobs, Source
from endolab.workbench.tuning.widget import TunerBox

EXAMPLES = int(os.environ.get("ENDOLAB_EXAMPLES", "20"))
ROOM = {"KEPT_ANSWERS": 5, "PATH_BYTES": 400e3}
# Light and contours stay while these are turned.
STAY = {
    "lam": [0.05, 0.4, 3.0, 0.0],
    "regulariser": ["auto", "first"],
    "xi": ["1/z", "d", "1/d"],
    "epsilon": [1e-3, 1e-2, 0.0],
    "k": [None, 1.5, 2.5],
    "gamma": [None, 1.9],
    "gain": [1.0, 2.0],
    "lamp_x": [None, 4.0],
    "fov": [None, 100],
    "solver": ["gauss_newton", "primal_dual", "fast_marching", "facing"],
    "max_iterations": [None, 3],
    "median_distance": [None, 40.0],
    "known_distance": [None, [30.0, 40.0, 30.0]],
}
ANEW = {
    "channel": ["auto", "green", "red"],
    "contours": [None, True, False],
    "highlights": [None, "keep", "ignore"],
    "width": [80, 96],
    "left_out": [[], [[0.5, 0.0, 0.7, 0.3]]],
    "albedo": [None, [0.7, 0.4, 0.3], [7.0]],
    "scene": [0, 1, 2, "tube"],  # the third picture is none
}


def turns(knobs):
    pairs = [{name: one} for name, values in knobs.items() for one in values]
    return st.sampled_from([("turn", pair) for pair in pairs])


ACTIONS = st.lists(
    st.one_of(
        turns(STAY),
        turns(ANEW),
        st.sampled_from([("anew",), ("undo",), ("begin", "reset"), ("rest",)]),
        st.sampled_from([("rest",), ("film",), ("sigma",), ("wait", 0.05)]),
        st.sampled_from([("begin", one) for one in ("default", "paper", "fastest")]),
    ),
    min_size=4,
    max_size=12,
)


def is_refused(knobs):
    is_wrong = knobs.epsilon == 0 or knobs.albedo == [7.0] or knobs.scene == 2
    return is_wrong or None not in (knobs.median_distance, knobs.known_distance)


def arrays_of(*things):
    """Return the bytes of all arrays that things refer to, by their ids."""
    stack = [*things]
    sizes = {}
    while stack:
        thing = stack.pop()
        if id(thing) in sizes or isinstance(thing, type | ModuleType | FunctionType):
            continue
        is_own = isinstance(thing, np.ndarray) and thing.base is None
        sizes[id(thing)] = thing.nbytes if is_own else 0
        stack += gc.get_referents(thing)
    return sizes


class Page:
    """A tuner, and what tuner.js knows of it and sends; a wish is its knobs, and those of its base."""

    def __init__(self, frame, calibration, pictures, finds):
        self.box = TunerBox(frame, calibration, pictures=pictures, width=80)
        self.source = partial(Source, calibration, frame, None, pictures)
        self.finds = finds
        self.heard = []  # and not yet listened to
        self.now = {"state": 0}
        self.knobs = self.base = self.box.knobs
        self.wishes = [None, (self.base, self.base)]  # by their states
        self.answered = self.here = None
        self.visited = []
        self.founds = {}
        self.sigmas = {}
        self.box.send = self.hear
        self.box._is_open = True
        self.turn({"channel": "green"})

    def hear(self, message, buffers=()):
        self.heard.append((message, buffers))
        self.box._free.set()

    def listen(self):
        """See whether each picture is named for what it is; note finals, for undo."""
        while self.heard:
            message, buffers = self.heard.pop(0)
            assert message.get("state", self.now["state"]) >= self.now["state"]
            self.now |= message
            if "knobs" in message:
                self.knobs = Knobs(**message["knobs"])
            if "asked" not in message:
                continue
            names = [name for name, _ in message["names"]]
            self.distance = np.frombuffer(buffers[names.index("distance")], "f4")
            self.line = message["line"]
            wish = self.wishes[message["state"]]
            asked = Knobs(**message["asked"])
            assert asked in wish
            if message["moving"]:
                continue
            assert asked == wish[0]
            assert self.founds.setdefault(message["found"], wish[1]) == wish[1]
            assert (message["badge"] == "") == (wish[0] == wish[1])
            if self.here is None:
                self.here = [wish, message["found"]]
                self.visited.append(self.here)
            self.here[1] = message["found"]

    def turn(self, values, base=None, **how):
        self.listen()
        after = replace(self.knobs, **values)
        if is_refused(after) or is_refused(self.knobs):
            self.rest()
        base = base or self.base
        held = {name: getattr(after, name) for name in STAY}
        stays = "anew" not in how and replace(base, **held) == after
        self.knobs = after
        self.base = base if stays else after
        self.here = None
        self.wishes.append((after, self.base))
        self.box.follow(json.loads(json.dumps(vars(after))), **how)
        if is_refused(after):
            self.rest()
            assert ("still shown" in self.now["line"]) == (after.scene == 2)

    def anew(self):
        self.turn({}, anew=True)

    def begin(self, how):
        first = self.box.facts["first"] | {"scene": self.knobs.scene}
        self.turn(self.box.facts["presets"].get(how, first), anew=True)

    def undo(self):
        self.listen()
        if self.here is not None and self.here is self.visited[-1] and self.visited[1:]:
            self.visited.pop()
        if self.visited:
            last = self.visited[-1]
            self.turn(vars(last[0][0]), last[0][1], found=last[1])
            self.here = last

    def wait(self, seconds):
        time.sleep(seconds)

    def film(self):
        self.rest()
        answer = self.box.answer
        for place in (1, len(answer.path)) if answer.path else ():
            self.box.show_iterate(place)
            self.listen()
            assert self.now["moving"] == (place < len(answer.path))

    def sigma(self):
        self.rest()
        self.box._hear(self.box, {"do": "sigma", "given": []}, [])
        self.box.engine.wait(60)
        self.listen()
        has_sigma = self.answered[0].solver in ("gauss_newton", "primal_dual")
        assert has_sigma == (self.now["tone"] == "")
        self.now["tone"] = ""
        self.sigmas[repr(self.answered)] = self.box.answer.uncertainty

    def afresh(self, knobs, base):
        """Solve as one who knows nothing of the tuner."""
        key = repr(base)
        if key not in self.finds:
            subject = self.source().subject(base)
            asked = base.solving_settings(subject).settings
            steps = find(subject.frame, base.calibration_of(subject), asked)
            self.finds[key] = subject, finish(steps)
        subject, found = self.finds[key]
        keywords = knobs.solving_settings(subject).keywords
        return el.solve_found(found, knobs.calibration_of(subject), **keywords)

    def rest(self):
        """Wait, and compare what is on the screen with what is made afresh."""
        self.box.engine.wait(60)
        self.listen()
        wish = self.wishes[-1]
        answer = self.box.answer
        if not is_refused(wish[0]):
            self.answered = wish
            assert self.now["state"] == len(self.wishes) - 1
            assert self.now["tone"] == ""
        elif is_refused(wish[1]):  # what cannot be found is nobody's base
            self.base = self.answered[1]
        assert self.box.knobs == self.knobs
        assert (answer.settings, answer.still.knobs) == self.answered
        assert answer.is_final
        result = answer.result
        fresh = self.afresh(*self.answered)
        np.testing.assert_array_equal(result.distance, fresh.distance)
        np.testing.assert_array_equal(
            self.distance, result.distance.ravel().astype("f4")
        )
        assert result.metric == fresh.metric == self.now["still"]["metric"]
        assert answer.uncertainty in (None, self.sigmas.get(repr(self.answered)))
        knobs = answer.settings
        has_lam = knobs.solver in ("gauss_newton", "primal_dual")
        assert SOLVER_NAMES[knobs.solver] in self.line
        assert (f"λ {knobs.lam:.3g}" in self.line) == has_lam
        self.check_length(result, knobs)
        # Beside what is shown, what was found and what follows: answers, their run, and what is drawn of it.
        one = self.box.engine
        own = arrays_of(result, answer.uncertainty, one.stills, one.source, one._look)
        kept = sum((arrays_of(one.tried, answer) | dict.fromkeys(own, 0)).values())
        assert kept <= 400e3 + (5 + 4) * result.distance.nbytes

    def check_length(self, result, knobs):
        far = result.distance
        mm = knobs.median_distance
        if knobs.known_distance:
            mm, *place = knobs.known_distance
            scale = far.shape[1] / result.report.picture_size[0]
            column, row = (int(scale * (one + 0.5)) for one in place)
            far = far[row - 2 : row + 3, column - 2 : column + 3]
        if mm:
            assert result.metric
            assert np.nanmedian(far) == pytest.approx(mm, rel=1e-9)
            assert f"given as {mm:g} mm" in meaning(result)[0]


@pytest.fixture(scope="module")
def tuned(tmp_path_factory):
    """A colour frame, its calibration or a nominal one, and pictures, by how much is known."""
    folder = tmp_path_factory.mktemp("pictures")
    sample = el.load_traced("matt")
    image = sample.frame.resize(160, 120, 2.2).image
    pictures = [folder / f"{number}.png" for number in range(3)]
    write_image(pictures[0], image)
    write_image(pictures[1], np.flip(image, axis=1))
    pictures[2].write_bytes(b"no picture")
    frame = el.read_frame(pictures[0])
    known = sample.calibration.resize(160, 120), el.nominal_calibration(frame)
    return [(frame, one, pictures, {}) for one in known]


@pytest.fixture
def quick(monkeypatch):
    """Short rests, few λ, little room."""
    few = {"REST": 0.02, "LAM_FACTORS": (0.32, 3.2), "LAMS": (0.01, 10.0)}
    for name, value in (few | ROOM).items():
        monkeypatch.setattr(engine, name, value)


@pytest.mark.usefixtures("quick")
def test_whatever_is_done_the_screen_follows_from_its_knobs(tuned):
    @settings(
        max_examples=EXAMPLES,
        derandomize=EXAMPLES == 20,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(st.integers(0, 1), ACTIONS)
    def law(kind, actions):
        page = Page(*tuned[kind])
        with closing(page.box):
            for what, *how in actions:
                if kind or how != [{"fov": 100}]:
                    getattr(page, what)(*how)
            page.rest()

    law()

"""The screen follows from its knobs, and from those by which light and contours were found."""

import gc
import json
import os
import threading
import time
from contextlib import closing
from dataclasses import replace
from types import FunctionType, ModuleType

import numpy as np
import pytest
from hypothesis import HealthCheck, given, note, settings
from hypothesis import strategies as st

import endolab as el
from endolab.io.images import write_image
from endolab.numerics.iteration import finish
from endolab.reconstruction.pipeline import find, solve_found
from endolab.reconstruction.report import SOLVER_NAMES, meaning
from endolab.workbench.tuning import engine
from endolab.workbench.tuning.source import Knobs, Source
from endolab.workbench.tuning.widget import TunerBox

EXAMPLES = int(os.environ.get("ENDOLAB_EXAMPLES", "15"))
KEPT = 5  # answers, beside the one on screen
PATH_BYTES = 400e3  # of its run
# What is turned while light and contours stay; with what else, they are found anew.
STAYS = {
    "lam": [0.05, 0.4, 3.0, 0.0],
    "regulariser": ["auto", "first"],
    "xi": ["1/z", "d", "1/d"],
    "epsilon": [1e-3, 1e-2, 0.0],
    "k": [None, 1.5, 2.5],
    "gamma": [None, 1.9],
    "gain": [1.0, 2.0],
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
KNOBS = STAYS | ANEW


def turned(name):
    return st.tuples(st.just("turn"), st.just(name), st.sampled_from(KNOBS[name]))


ACTIONS = st.lists(
    st.one_of(
        *map(turned, STAYS),
        *map(turned, ANEW),
        *(st.tuples(st.just(one)) for one in ("anew", "undo", "undo", "reset", "rest")),
        *(st.tuples(st.just(one)) for one in ("rest", "rest", "sigma", "film")),
        st.tuples(st.just("preset"), st.sampled_from(["default", "paper", "fastest"])),
        st.tuples(st.just("wait"), st.sampled_from([0.01, 0.1, 0.3])),
    ),
    min_size=1,
    max_size=8,
)


def follows(knobs, base):
    held = {name: getattr(knobs, name) for name in STAYS}
    return replace(base, **held) == knobs


def is_refused(knobs):
    given = [knobs.median_distance, knobs.known_distance]
    is_wrong = knobs.epsilon == 0 or knobs.albedo == [7.0] or knobs.scene == 2
    return is_wrong or None not in given


class Page:
    """What tuner.js knows and sends, and what Python should make of it."""

    def __init__(self, box):
        self.box = box
        self.knobs = box.knobs
        self.base = box.knobs
        self.wishes = [None, (box.knobs, box.knobs)]  # by their numbers
        self.bases = {}  # of each number of what was found
        self.shown = None  # final: knobs and base
        self.visited, self.here, self.settled = [], None, None
        self.said, self.now, self.arrays = [], {}, {}
        self.lock = threading.RLock()
        self.wrong = []
        box.send = self.hear

    def check(self, holds, *what):
        if not holds:
            self.wrong.append(what)

    def hear(self, message, buffers=()):
        with self.lock:
            self.said.append(message)
            if "knobs" in message:
                self.knobs = Knobs(**json.loads(json.dumps(message["knobs"])))
            if "state" in message:
                state = message["state"]
                self.check(state >= self.now.get("state", 0), "state falls", state)
            self.now |= message
            for (name, kind), content in zip(
                message.get("names", ()), buffers, strict=True
            ):
                kind = "f4" if kind == "f4" else "u1"
                self.arrays[name] = np.frombuffer(content, kind)
            if "asked" in message:
                self.judge(message)
        self.box._free.set()

    def judge(self, message):
        """See whether a picture is named for what it is, and note it for undo."""
        self.drawn = message
        state, found = message["state"], message["found"]
        asked = Knobs(**message["asked"])
        wish, base = self.wishes[state]
        if message["moving"]:
            self.check(asked in (wish, base), "another's", asked)
            return
        self.check(asked == wish or (wish, base) in self.refused, "not the wish", asked)
        if asked != wish:
            return
        self.check(self.bases.setdefault(found, base) == base, "found", found)
        self.check((message["badge"] == "") == (asked == base), "badge", message)
        if state == self.settled:
            return
        self.settled = state
        if self.here is not None and self.here[0] == asked:
            self.here[2] = found
        else:
            self.here = [asked, base, found]
            self.visited.append(self.here)

    refused = ()

    def turn(self, base, anew=False, found=None, **values):
        with self.lock:
            self.knobs = replace(self.knobs, **values)
            self.here = None
            is_held = not anew and base is not None and follows(self.knobs, base)
            self.base = base if is_held else self.knobs
            self.wishes.append((self.knobs, self.base))
            sent = json.loads(json.dumps(vars(self.knobs)))
        self.box.turn(sent, anew, found)

    def undo(self):
        with self.lock:
            if self.visited and self.here is self.visited[-1] and self.visited[1:]:
                self.visited.pop()
            if not self.visited:
                return
            last = self.visited[-1]
            asked, base, found = last
            self.turn(base, found=found, **vars(asked))
            self.here = last


class Law:
    """One tuner, what is done with it, and what must hold when it rests."""

    def __init__(self, kind, given, fresh):
        self.given = given
        self.fresh = fresh
        self.kind = kind
        frame, calibration, pictures = given
        self.box = TunerBox(frame, calibration, pictures=pictures, width=80)
        self.page = Page(self.box)
        self.box._is_open = True
        self.page.turn(self.page.base, channel="green")
        self.sigmas = {}
        self.last = self.rested = None

    def afresh(self, knobs, base):
        key = json.dumps([self.kind, vars(base)], sort_keys=True)
        if key not in self.fresh:
            subject = Source(*self.given[1::-1], None, self.given[2]).subject(base)
            calibration = base.calibration_of(subject)
            asked = base.solving_settings(subject).settings
            found = finish(find(subject.frame, calibration, asked))
            self.fresh[key] = subject, found
        subject, found = self.fresh[key]
        own = (key, json.dumps(vars(knobs), sort_keys=True))
        if own not in self.fresh:
            keywords = knobs.solving_settings(subject).keywords
            self.fresh[own] = solve_found(
                found, knobs.calibration_of(subject), **keywords
            )
        return self.fresh[own]

    def do(self, what, *how):
        page = self.page
        if what == "wait":
            time.sleep(*how)
        elif what == "rest":
            self.rest()
        elif what == "undo":
            page.undo()
        elif what == "anew":
            page.turn(None, anew=True)
        elif what == "turn":
            name, value = how
            if name == "fov" and self.kind == "known":
                return
            after = replace(page.knobs, **{name: value})
            if is_refused(after) or is_refused(page.knobs):
                self.rest()
            page.turn(page.base, **{name: value})
            if is_refused(after):
                self.rest()
        elif what in ("reset", "preset"):
            first = self.box.facts["first"] | {"scene": page.knobs.scene}
            options = self.box.facts["presets"][how[0]] if how else first
            if is_refused(page.knobs):
                self.rest()
            page.turn(None, anew=True, **options)
            if is_refused(page.knobs):
                self.rest()
        elif what == "sigma":
            self.rest()
            self.box._hear(self.box, {"do": "sigma", "given": []}, [])
            self.wait()
            if self.box.answer.uncertainty is not None:
                self.sigmas[repr(self.last)] = self.box.answer.uncertainty
            else:
                assert self.last[0].solver in ("facing", "fast_marching")
        elif what == "film":
            self.rest()
            answer = self.box.answer
            for place in (1, len(answer.path)) if answer.path else ():
                self.box.show_iterate(place)
                assert page.now["moving"] == (place < len(answer.path))
                assert page.now["asked"] == vars(answer.settings)

    def wait(self):
        self.box.engine.wait(120)
        assert self.page.wrong == []

    def rest(self):
        """Wait, and compare what is on the screen with what is made afresh."""
        page, box = self.page, self.box
        self.wait()
        wish = page.wishes[-1]
        answer = box.answer
        if wish == self.rested:
            pass
        elif is_refused(wish[0]):
            assert page.now["tone"] == "endolab-wrong"
            if is_refused(wish[1]):
                page.base = self.last[1]
            page.knobs = replace(page.knobs, scene=answer.settings.scene)
        else:
            assert page.now["tone"] == ""
            self.last = wish
            assert page.now["state"] == len(page.wishes) - 1
        self.rested = wish
        assert box.knobs == page.knobs
        knobs, base = self.last
        expected = self.afresh(knobs, base)
        result = answer.result
        assert answer.is_final
        assert (answer.settings, answer.still.knobs) == (knobs, base)
        np.testing.assert_array_equal(result.distance, expected.distance)
        assert result.history[-1]["energy"] == expected.history[-1]["energy"]
        assert result.metric == expected.metric == page.now["still"]["metric"]
        self.says(answer)
        self.unit(answer)
        known = self.sigmas.get(repr(self.last))
        assert answer.uncertainty in (None, known)
        assert self.kept() <= self.most()

    def says(self, answer):
        now, knobs = self.page.drawn, answer.settings
        assert not now["moving"]
        assert now["asked"] == vars(knobs)
        lam = f"λ {knobs.lam:.3g}"
        has_lam = knobs.solver in ("gauss_newton", "primal_dual")
        assert SOLVER_NAMES[knobs.solver] in now["line"]
        for text in (now["line"], now["label"]):
            assert (lam in text) == has_lam
        assert now["label"].startswith(
            lam if has_lam else knobs.solver.replace("_", " ")
        )
        shown = answer.result.distance.ravel().astype("f4")
        np.testing.assert_array_equal(self.page.arrays["distance"], shown)

    def unit(self, answer):
        result, knobs = answer.result, answer.settings
        said = " ".join(meaning(result))
        for length in (knobs.median_distance, knobs.known_distance):
            if length is None:
                continue
            distance, mm = result.distance, length
            if length is knobs.known_distance:
                mm, *place = length
                height, width = result.mask.shape
                size = np.array(result.report.picture_size)
                column, row = (
                    (np.array(place) + 0.5) * (width, height) / size - 1e-9
                ).astype(int)
                distance = distance[row - 2 : row + 3, column - 2 : column + 3]
            assert np.nanmedian(distance) == pytest.approx(mm, rel=1e-9)
            assert f"given as {mm:g} mm" in said
            assert result.metric

    def kept(self):
        """Return bytes of arrays that are kept beside those of what is shown, and of what was found."""
        one = self.box.engine
        shown = self.box.answer
        own = arrays_of(
            shown.result, shown.uncertainty, one.stills, one.source, one._look
        )
        kept = arrays_of(one.tried, shown)
        return sum(size for name, size in kept.items() if name not in own)

    def most(self):
        return (KEPT + 4) * self.box.answer.result.distance.nbytes + PATH_BYTES


def arrays_of(*things):
    """Return the sizes of all arrays that things refer to, by their ids."""
    stack, seen, sizes = [*things], set(), {}
    while stack:
        thing = stack.pop()
        if id(thing) in seen or isinstance(thing, type | ModuleType | FunctionType):
            continue
        seen.add(id(thing))
        if isinstance(thing, np.ndarray):
            sizes[id(thing)] = thing.nbytes if thing.base is None else 0
        stack += gc.get_referents(thing)
    return sizes


@pytest.fixture(scope="module")
def given_pictures(tmp_path_factory):
    """By how much is known of the endoscope: a colour frame, its calibration, pictures."""
    folder = tmp_path_factory.mktemp("pictures")
    sample = el.load_traced("matt")
    frame = sample.frame.resize(160, 120, 2.2)
    known = sample.calibration.resize(160, 120)
    pictures = [folder / f"{number}.png" for number in range(3)]
    write_image(pictures[0], frame.image)
    write_image(pictures[1], np.flip(frame.image, axis=1))
    pictures[2].write_bytes(b"no picture")
    frame = el.read_frame(pictures[0])
    return {
        "known": (frame, known, pictures),
        "nominal": (frame, el.nominal_calibration(frame), pictures),
    }


@pytest.fixture(scope="module", autouse=True)
def quick():
    """No long rests, few λ, little room."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(engine, "REST", 0.02)
        patch.setattr(engine, "LAM_FACTORS", (0.32, 3.2))
        patch.setattr(engine, "PATH_BYTES", PATH_BYTES)
        patch.setattr(engine, "KEPT_ANSWERS", KEPT)
        patch.setattr(engine, "LAMS", (0.01, 10.0))
        yield


def test_whatever_is_done_the_screen_follows_from_its_knobs(given_pictures):
    fresh = {}

    @settings(
        max_examples=EXAMPLES,
        derandomize=EXAMPLES == 15,
        deadline=None,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(st.sampled_from(["known", "nominal"]), ACTIONS)
    def law(kind, actions):
        one = Law(kind, given_pictures[kind], fresh)
        with closing(one.box):
            for action in actions:
                one.do(*action)
            note(f"{one.page.wrong}")
            one.rest()

    law()

"""The checks of notebook 09: the right answer passes, and each mistake hears what it is."""

import numpy as np
import pytest

from endolab.course import recordings
from endolab.course.verdict import MISSING

TRUE = np.full((6, 8), 20.0)


class Run:
    """A run of 60 iterations, few with pictures, which goes past the truth."""

    pictured = (0, 1, 2, 5, 10, 20, 30, 60)
    errors = (0.9, 0.7, 0.6, 0.4, 0.2, 0.02, 0.1002, 0.1)  # of most of the wall

    def __init__(self):
        self.mask = np.ones(TRUE.shape, bool)
        self.mask[0] = False
        self.late, self.middle = np.zeros((2, *TRUE.shape), bool)
        self.late[3:5, 2:6] = self.middle[1, :3] = True

    def depth(self, k=-1):
        at = self.pictured.index(self.pictured[-1] if k == -1 else k)
        distance = TRUE * (1 - self.errors[at])
        distance[self.middle] = 18.0 if at > 4 else 25.0
        late = distance[self.late]
        distance[self.late] = late * (1 if at == 7 else np.linspace(1.05, 1.13, late.size) ** 2)
        distance[5, 0] *= 1 if at == 7 else 1.004
        return np.where(self.mask, distance, np.nan)

    def table(self):
        k = np.arange(61)
        table = np.empty(61, [("iteration", int), *((name, float) for name in recordings.CURVES)])
        table["iteration"], table["energy"], table["data"] = k, np.exp(-k / 20), np.exp(-k / 30)
        table["change"] = np.abs(k - 18.0)
        return table


@pytest.fixture
def run():
    """Give a run whose change has a turn near the truth, and whose energy has none."""
    return Run()


def test_who_arrives_last_and_how_far_it_moves(run):
    step = np.abs(run.depth() - run.depth(30))
    last, of = run.late, step[run.late]
    moved = np.median(of)
    told = recordings.exercise_1(last, moved, run)
    assert told
    assert "8 pixels, 20.0% of the wall, in rows 3 to 4 and columns 2 to 5" in told.said
    first = run.mask & (np.abs(run.depth(1) / run.depth() - 1) > 0.01)
    slips = {
        "with what lies beyond": (~last, moved),
        "Those are the others, which had already arrived.": (run.mask & ~last, moved),
        "nan is unlike": (last | ~run.mask, moved),
        "the *first* step": (first, moved),
        "a hundredth of a millimetre": (step > 0.01, moved),
        "last step but one": (run.mask & ~last & ~run.middle, moved),
        "4 pixels, of which 4 are right, and 4 are missing": (last & (np.arange(8) < 4), moved),
        "its shape is (8,)": (last[0], moved),
        "yes or no": (1.0 * last, moved),
        "its negative": (last, -moved),
        "the mean": (last, np.mean(of)),
        "the largest": (last, np.max(of)),
        "the whole wall": (last, np.nanmedian(step)),
        "a share": (last, np.median(of / run.depth()[last])),
        "metres": (last, moved / 1000),
        "which two maps": (last, 7 * moved),
    }
    for said, wrong in slips.items():
        told = recordings.exercise_1(*wrong, run)
        assert told.right is False
        assert said in told.said


def test_which_iteration_is_nearest_and_what_tells_it(run):
    told = recordings.exercise_2(20, ["change"], run, TRUE)
    assert told
    assert "Marked by change" in told.said
    slips = {
        "`pictured` has": (5, ["change"]),
        "energy is least": (60, ["change"]),
        "farthest": (0, ["change"]),
        "no picture": (25, ["change"]),
        f"{np.nanmean(np.abs(run.depth(10) / TRUE - 1)):.1%}".replace("%", " %"): (10, ["change"]),
        "look at energy": (20, ["change", "energy"]),
        "look at data": (20, "data"),
        "change does have a turn": (20, []),
        "no 'error'": (20, ["error"]),
    }
    for said, wrong in slips.items():
        told = recordings.exercise_2(*wrong, run, TRUE)
        assert told.right is False
        assert said in told.said


def test_nothing_may_tell(run):
    table = run.table()
    table["change"] = table["energy"]
    run.table = lambda: table
    assert "No curve" in recordings.exercise_2(20, [], run, TRUE).said


def test_no_answer_is_none_yet():
    for told in (recordings.exercise_1(..., ..., None), recordings.exercise_2(..., [], None, None)):
        assert (told.right, told.said) == (None, MISSING)

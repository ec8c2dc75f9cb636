"""Commands that are killed at a random moment of their work: what they leave is whole, and they go on."""

import signal
import sys

import pytest

from tests.hostile import kills
from tests.hostile.guard import told

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="it forks, and looks into /proc")

# Kills of each command; `make attack` kills oftener.
COUNTS = {"reconstruct": 2, "video": 2, "sweep": 1, "calibrate": 1, "simulate": 1, "simulate sheet": 1}

OPEN: dict[str, dict[int, str]] = {}  # seeds that are not survived yet, with the reason: to be empty


@pytest.fixture(scope="module")
def killing():
    with kills.Kills() as there:
        yield there


@pytest.mark.parametrize("name", COUNTS)
def test_a_kill_is_survived(killing, name):
    assert set(COUNTS) == set(kills.COMMANDS)
    outcomes = [killing.kill(name, seed) for seed in range(COUNTS[name]) if seed not in OPEN.get(name, {})]
    failed = [outcome for outcome in outcomes if outcome.wrong]
    assert not failed, "\n" + "\n".join(told(failed))


def test_half_a_result_would_be_seen(tmp_path):
    """What a kill must not leave, planted."""
    there = kills.Kills(place=tmp_path)
    whole = {"out/depth.npz": "a", "out/report.json": "b"}
    (tmp_path / "out").mkdir()
    assert there._partial("reconstruct", tmp_path, whole) == []
    (tmp_path / "out/report.json").write_text("{}")
    assert there._partial("reconstruct", tmp_path, whole) == ["out/report.json without out/depth.npz"]
    (tmp_path / "out/depth.npz").write_text("half")
    (wrong,) = there._partial("reconstruct", tmp_path, whole)
    assert wrong.startswith(f"broken: {tmp_path}/out/depth.npz")
    differences = list(kills._differences(whole, {"out/depth.npz": "c", "out/more.png": "d"}))
    assert [line.split(" ")[0] for line in differences] == ["another", "more", "missing"]


def test_words_and_processes_after_a_kill_would_be_seen(tmp_path):
    folder, there = tmp_path / "f", kills.Kills(place=tmp_path)
    for name, text in (("out", ""), ("err", "Traceback (most recent call last):\nKeyboardInterrupt\n")):
        (tmp_path / f"f.{name}").write_text(text)
    assert kills._words_after(130, signal.SIGINT, folder, False)[0].startswith("after SIGINT it says")
    assert len(kills._words_after(-9, signal.SIGTERM, folder, False)) == 2
    (tmp_path / "f.err").write_text("endolab: interrupted; nothing was written\n")
    assert kills._words_after(130, signal.SIGINT, folder, False) == []
    folder.mkdir()
    assert there._left(folder) == []

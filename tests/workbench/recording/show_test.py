"""Showing recordings without a front end; `tests/browser` shows them with one."""

import endolab as el
from tests.tools.problems import coloured_colon


def test_without_a_front_end_a_sentence_says_how_to_open_it(tmp_path, capsys):
    problem, _ = coloured_colon(el.load_calibration("paper", width=64).camera)
    with el.record(tmp_path / "run.rrd") as recorder:
        recorder(el.Iterate.of(problem, problem.log_d0))
    el.show(recorder)
    assert capsys.readouterr().out == "`rerun run.rrd` opens the recording.\n"

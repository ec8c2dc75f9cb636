"""A command that is told to end: as after Ctrl-C, and its exit status says by what."""

import signal
import threading

import pytest

from endolab.cli import main as cli
from endolab.cli.signals import ENDS, ended_like_interrupted


@pytest.mark.parametrize("number", [signal.SIGINT, *ENDS], ids=lambda number: number.name)
def test_a_command_that_is_told_to_end_says_so(monkeypatch, capsys, number):
    def run(arguments):
        signal.raise_signal(number)

    monkeypatch.setattr(cli, "_evaluate", run)
    before = [signal.getsignal(each) for each in ENDS]
    whole = signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell in the background ignores it
    try:
        assert cli.main(["evaluate", "a.npz", "b.npz"]) == 128 + number
    finally:
        signal.signal(signal.SIGINT, whole)
    assert capsys.readouterr().err == "endolab: interrupted; nothing was written\n"
    assert [signal.getsignal(each) for each in ENDS] == before


@pytest.mark.parametrize("number", ENDS, ids=lambda number: number.name)
def test_the_second_signal_does_not_cut_the_tidying_short(number):
    ended = []
    with ended_like_interrupted(ended):
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
        signal.raise_signal(number)
    assert ended == [number]


def test_what_others_take_care_of_is_left_alone():
    before = signal.signal(ENDS[0], signal.SIG_IGN)
    try:
        with ended_like_interrupted([]):
            assert signal.getsignal(ENDS[0]) is signal.SIG_IGN
    finally:
        signal.signal(ENDS[0], before)


def test_in_a_thread_nothing_is_changed():
    found = []

    def run():
        with ended_like_interrupted([]):
            found.append(signal.getsignal(ENDS[0]))

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert found == [signal.getsignal(ENDS[0])]

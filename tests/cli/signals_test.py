"""Being told to end: once, by any signal, and whatever Python is at."""

import signal
import time

import pytest

from endolab.cli.signals import ENDS, ended_like_interrupted


@pytest.mark.parametrize("number", ENDS)
def test_a_signal_ends_a_block_once(number):
    def work():
        try:
            signal.raise_signal(number)
        finally:
            signal.raise_signal(number)  # does not cut the tidying short

    ended = []
    with ended_like_interrupted(ended), pytest.raises(KeyboardInterrupt):
        work()
    assert ended == [number]
    assert signal.getsignal(number) is signal.SIG_DFL


def test_an_interrupt_that_python_ignores_comes_again(capfd):
    class Thing:
        def __del__(self):
            signal.raise_signal(signal.SIGTERM)

    def work():
        thing = Thing()
        del thing
        time.sleep(20)

    ended = []
    with ended_like_interrupted(ended), pytest.raises(KeyboardInterrupt):
        work()
    assert ended == [signal.SIGTERM]
    assert capfd.readouterr().err == ""

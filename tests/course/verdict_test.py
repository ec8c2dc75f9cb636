"""Verdicts: right, wrong or none yet, and why."""

import pytest

from endolab.course.verdict import MISSING, Wrong, verdict


@verdict
def half(number):
    """Ask for the half of 84."""
    found = number() if callable(number) else number
    if found == 168:
        raise Wrong("That is the double.")
    return f"{found} it is"


def unwritten():
    raise NotImplementedError


@pytest.mark.parametrize(
    ("answer", "right", "shown"),
    [
        (42, True, "✓ 42 it is"),
        (lambda: 42, True, "✓ 42 it is"),
        (168, False, "✗ That is the double."),
        (..., None, f"… {MISSING}"),
        (unwritten, None, f"… {MISSING}"),
    ],
)
def test_a_verdict_says_what_it_thinks(answer, right, shown):
    told = half(answer)
    assert told.right is right
    assert bool(told) is (right is True)
    assert repr(told) == told._repr_markdown_() == shown


def test_an_error_of_the_students_own_is_shown_as_it_is():
    with pytest.raises(ZeroDivisionError):
        half(lambda: 1 / 0)


def test_a_check_keeps_its_name():
    assert half.__doc__ == "Ask for the half of 84."

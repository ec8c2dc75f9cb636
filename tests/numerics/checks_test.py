"""What a caller may give, and the sentence about anything else."""

import numpy as np
import pytest

from endolab.numerics.checks import (
    check_int,
    excerpt,
    mask_array,
    number,
    readonly_copy,
    real_array,
)


@pytest.mark.parametrize(
    "value",
    ["1", None, True, 1j, [[1], [2, 3]], np.ones(2), np.nan, -1, np.float64(4)],
    ids=excerpt,
)
def test_what_is_no_number_between_two_others_is_said(value):
    with pytest.raises(ValueError, match="x must"):
        number("x", value, 0, 3)


@pytest.mark.parametrize("value", [-1, 2.0, True, "2", None, np.nan])
def test_what_is_no_whole_number_is_said(value):
    assert check_int("x", np.int32(3)) == 3
    with pytest.raises(ValueError, match="x must"):
        check_int("x", value)


@pytest.mark.parametrize("value", [None, "a", [[1], [2, 3]], np.ones(2) * 1j, {}])
def test_what_is_no_array_of_real_numbers_is_said(value):
    assert real_array("x", [1, 2]).dtype == np.float64
    for check in (real_array, mask_array):
        with pytest.raises(ValueError, match="x must"):
            check("x", value)


def test_a_mask_may_be_of_numbers_that_leave_no_doubt():
    for good in ([True, False], [255, 0], [1.0, 0.0], np.array([7, 0], np.uint8)):
        np.testing.assert_array_equal(mask_array("x", good), [True, False])
    for doubtful in ([0.5, 0.0], [np.nan, 1.0]):
        with pytest.raises(ValueError, match="x must"):
            mask_array("x", doubtful)


def test_what_is_owned_is_nobody_elses_to_write():
    buffer = np.zeros((3, 4))
    view = buffer[1:]
    view.flags.writeable = False  # but by way of the buffer it can be written
    for given in (buffer, buffer[::2, ::-1], view):
        kept = readonly_copy(given)
        buffer[:] = 7
        assert not kept.any()
        assert not kept.flags.writeable
        assert readonly_copy(kept) is kept
        buffer[:] = 0

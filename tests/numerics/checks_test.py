"""What a caller may give, and the sentence about anything else."""

import numpy as np
import pytest

from endolab.numerics.checks import mask_array, readonly_copy


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

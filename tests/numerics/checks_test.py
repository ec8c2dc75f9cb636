"""What a caller may give, and the sentence about anything else."""

import numpy as np

from endolab.numerics.checks import readonly_copy


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

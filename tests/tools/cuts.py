"""Cuts of maps."""

import numpy as np


def between(labels):
    """Cuts wherever the labels of neighbours differ."""
    cuts = np.zeros((2, *labels.shape), dtype=bool)
    cuts[0, :, :-1] = labels[:, 1:] != labels[:, :-1]
    cuts[1, :-1] = labels[1:] != labels[:-1]
    return cuts

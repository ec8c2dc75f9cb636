"""Why an iteration ended."""

from __future__ import annotations

from enum import Enum


class Status(Enum):
    """Why a run ended."""

    CONVERGED = "The solver reached its goal."
    MAX_ITERATIONS = "The solver ran out of iterations before it converged."
    STOPPED = "An observer or the user stopped the run."
    STALLED = "The solver could not improve the result any more, short of its goal."
    NON_FINITE = "The solver produced a value that is not finite."

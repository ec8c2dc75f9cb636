"""Many frames: sweeps, videos, which go on where they were, and comparisons with the truth."""

"""Many frames: sweeps and videos, which go on where they were."""

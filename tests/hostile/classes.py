"""Every class of cases by its name: a function from a generator and the good files to a `Case`."""

from tests.hostile import damaged_files, disks, odd_calls

# With its share of an attack: what is cheap, and read first of all, comes oftenest.
SHARED = (
    (damaged_files.calibration, 30),
    (damaged_files.target, 8),
    (damaged_files.endomapper, 8),
    (damaged_files.image, 30),
    (damaged_files.mask, 8),
    (damaged_files.published, 6),
    (damaged_files.depth, 16),
    (damaged_files.recording, 6),
    (damaged_files.table, 10),
    (damaged_files.resumed, 8),
    (damaged_files.detections, 6),
    (damaged_files.video, 8),
    (odd_calls.options, 14),
    (odd_calls.paths, 10),
    (odd_calls.calls, 24),
    (odd_calls.tuner, 4),
    (odd_calls.yours, 5),
    (disks.full_disk, 3),
    (disks.read_only_disk, 2),
)
CLASSES = {function.__name__: function for function, _ in SHARED}
SHARES = {function.__name__: share for function, share in SHARED}
MOUNTING = {"full_disk", "read_only_disk"}  # these run in a worker that may mount

"""Where a target is seen in a picture.

Read `detect`, which calls `dots` (through `blobs` and `lattice`) or OpenCV.
"""

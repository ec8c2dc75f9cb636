"""Where a target is seen in a picture.

Read `detect`, which calls `dots` (through `blobs` and `lattice`) or OpenCV.
"""

from endolab._deprecated import with_old_names

__getattr__ = with_old_names(__name__)

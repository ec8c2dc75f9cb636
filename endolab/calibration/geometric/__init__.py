"""The camera, from where a target is seen.

Read `pose`, `projection`, `planar_pose`, `reprojection`, `fit`.
"""

from endolab._deprecated import with_old_names

__getattr__ = with_old_names(__name__)

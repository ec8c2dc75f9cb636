"""The camera, from where a target is seen.

Read `pose`, `projection`, `planar_pose`, `reprojection`, `fit`.
"""

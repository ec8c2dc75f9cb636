"""A frame and a calibration in, a surface out, stage by stage.

Read `pipeline` first, from its top down; then `problem_of_frame`, `light_and_contours`, `scale`.
"""

"""A frame and a calibration in, a surface out, stage by stage.

Read `pipeline` first, from its top down; then `channels`, `light/separation`, `contours/choice`, `scale`.
"""

"""Calibration videos whose truth is known.

Read `trajectory`, `sheet_image`, `video`.
"""

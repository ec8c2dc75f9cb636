"""Calibration videos whose truth is known.

Read `trajectory`, `video`.
"""

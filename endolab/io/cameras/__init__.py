"""Calibration files of other programs, and their cameras."""

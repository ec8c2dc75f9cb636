"""Calibration files of other programs: their cameras in, and endolab's out."""

"""Calibration: targets, their detection, the camera's geometry and the endoscope's light."""

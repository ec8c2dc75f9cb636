"""Occluding contours: lines of a picture that may be some, and the choice of those that are cut."""

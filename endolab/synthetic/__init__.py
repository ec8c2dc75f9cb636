"""Scenes whose truth is known, and the frames that the model makes of them.

Read `scenes`, `rendering`.
"""

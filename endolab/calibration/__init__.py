"""Camera and light of an endoscope from pictures of a printed sheet.

Read `refusals`, `targets`, `detection/`, `geometric/`, `photometric/`, `uncertainty`, `session`, `summary`;
beside them `least_squares`, which fits both, and `simulation/`.
"""

"""Constants of the calibration that were chosen by hand, on simulated sheets and on real ones.

They say when what is seen is believed. Code reads them as ``constants.NAME``.
"""

# Evidence that a target was seen (`detection`)
LEAST_DOTS = 20  # to tell the code by
LEAST_CORNERS = 6  # of a ChArUco board

# Poses and the camera (`geometric`)
LEAST_POINTS = 8  # points of a view that count as evidence
LEAST_VIEWS = 3  # from different directions
# px; detectors have systematic errors of that size, whatever the noise.
FINEST = 0.03

# Fits (`least_squares`)
OUTLIER = 3.5  # standard deviations beyond which a residual is an outlier

# What samples must show before k, γ and a lamp's place are believed (`photometric/identifiability`)
# Errors of the poses make up some signal where there is none: 0.3 % of the distance and 0.1° of the
# normal, apart for each sample, 0.009 of s. A fold of 3° gives 0.02 to 0.05 of it, tilts up to 5° give
# 0.02 of log cos α.
LEAST_GAMMA_SIGNAL = 0.018
LEAST_K_SIGNAL = 0.012
LEAST_LAMP_SIGNAL = 0.006  # of 1 mm

# The light's fit, and when it is believed (`photometric`)
# Stored values that the model may predict for a sample to count: noise of 3 grey levels cannot clip them.
LEVELS = (12 / 255, 240 / 255)
GAMMA_BOUNDS = (0.5, 5.0)  # what it may not leave
LEAST_SAMPLES = 10
LARGEST_GAMMA_ERROR = 0.05  # relative
LARGEST_K_ERROR = 0.1
# Power of 1/d² cos θ: between a lamp at the lens, 1 (0.67 on the roughest paper), and the light of a
# room, 0. Below the first the light is refused, below the second it is in doubt.
LEAST_POWER = 0.6
USUAL_POWER = 0.85
# Grey levels; an endoscope's own light leaves 3 to 8, of a poor camera 13.
LARGEST_SIGMA = 15.0
LARGEST_SIDE = 0.05  # part of the light by which one side of the picture may be too bright
LEAST_SCORED = 10  # samples of a bin of angles that are worth a word

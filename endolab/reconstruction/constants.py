"""Constants of light and contours that were chosen on frames whose truth is known.

`tests/research/refit.py` chooses them anew. Code reads them as ``constants.NAME``.
"""

# Lines (`lines`): lengths in 1/320 of the longer side, slopes in log d₀ per such a length.
LINE_BLUR = 1.5  # of log d₀
SHALLOW = 0.005  # basins of the slope less deep than this are one
LIMB_WIDTH = 8.0  # a strip that is thinner than this may be a limb
ACROSS = 0.1  # fraction of a line's slope that must lie across it, on the whole

# Contours (`light_and_contours`)
# How steep lines must be to be cut, one trial after the other.
MIN_STEEPNESS = (0.07, 0.035, 0.018)
# In living tissue, of log 1/I in red on few pixels: .03, .04 and .05 keep 19, 16 and 14 of 22 jumps behind
# folds, and make none on seven stretches of one wall.
TISSUE_STEEPNESS = 0.04
# Fraction of the energy that a cut as long as the picture's height must save, if only the energy speaks for
# it: so gentle folds of a real phantom stay whole. And where no light bounced: there the picture is the
# model's own, and its lines are to be trusted.
PRICE = 0.1
CLEAN_PRICE = 0.02
# The least cut surface is taken whose misfit is at most so many times the least, or as many times more as
# the colours ask for indirect light.
MISFIT_LIMIT = 1.1
# Steps of each uncut round and of each trial.
UNCUT_ROUNDS: tuple[int, ...] = (4, 2, 2)
LAMP_ROUNDS: tuple[int, ...] = (4, 2, 2, 2)  # likewise, where lamps stand aside
TRIAL_STEPS = 3
RATIO_DOUBT = 0.15  # fraction of ι that may be wrong

# Walls (`walls`)
# A wall must be nearer than a chord by this factor to block it: patches are coarse.
NEARER = 1.1
BACK = 2.0  # how far behind the camera the wall goes on, in radii
# Of what a patch does not see, how much is a wall; so red and green say one E of traced colons.
HIDDEN = 0.75

# Colours (`colours`). A prior is its middle and its width.
# p; 0.8 to 1.1 for the true surfaces of traced cavities.
FACTOR_PRIOR = (0.9, 0.2)
LAMP_PRIOR = (1.0, 0.3)  # b: all the lamp's, or any fraction
# Of the albedos' logarithms in red, green and blue: blood takes green and blue light, hardly red.
TEXTURE = (0.05, 0.2, 0.2)
TOGETHER = 0.8  # correlation of green's texture with blue's
# Errors of S go on over many patches: so many of them are independent.
PIECES = 20.0
# Robust standard deviation, in units of texture: S is never exact.
LEAST_SPREAD = 0.25
# Mean difference of the colours' log E beyond which they say no one E, over γ: of tissue it is .05 to .3.
MOST_MISFIT = 0.045
# Width of log ι from place to place, as a fraction of ι/(1 + ι) in red: the surface's errors are those of
# S/E, most of all deep down. And how many widths a tint may be off before it counts for texture only.
WIDTH_PER_PIXEL = 0.5
OUTLIER = 1.5

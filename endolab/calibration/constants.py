"""Constants of the calibration that were chosen by hand, on simulated sheets and on real ones.

Code reads them as ``constants.NAME``.
"""

# Evidence that a target was seen (`detection`)
LEAST_DOTS = 20  # to tell the code by
LEAST_CORNERS = 6  # of a ChArUco board

# Poses (`geometric/planar_pose`)
LEAST_POINTS = 8  # points of a view that count as evidence
# Of the rays' spread: a median miss beyond it is no view of a plane, whatever the lens.
LARGEST_MISS = 0.25
# Cosine of the angle to the middle ray, up to which rays have a place in a pinhole camera's picture.
WIDEST = 0.15

# Points (`geometric/reprojection`)
# Spacings from a fold, within which light and paper break, and sway a point.
BESIDE_FOLD = 0.75
# px; detectors have systematic errors of that size, whatever the noise.
FINEST = 0.03

# The camera (`geometric/fit`)
LEAST_VIEWS = 3  # from different directions
# rad off the axis: a lens that was seen farther out is a fisheye, and to there it is imitated to begin.
WIDEST_BROWN = 1.2

# Frames (`session`)
# Frames that the geometry should have; with fewer, more than one in `every` go into it.
# A frame whose points are so many times as far off as usual does not belong to the others.
# Share of the points that agree with a camera which suits its lens; of simulated ones, all but 2 to 8 %.

# Fits (`least_squares`)
OUTLIER = 3.5  # standard deviations beyond which a residual is an outlier

# Samples (`photometric/samples`)
# px; in pictures as wide as this 3x3 pixels are averaged.
LARGE_PICTURE = 960
# px between a window and the rim of the ink: half of rounding, the rest of blur.
RIM = 1.5
GREY_CLEARANCE = 0.8  # of a grey disc's radius, that is surely grey
# Samples of a frame; more would only make one frame count more than another.
MOST_OF_A_FRAME = 200

# The light's model (`photometric/model`)
# Stored values that the model may predict for a sample to count: noise of 3 grey levels cannot clip them.
LEVELS = (12 / 255, 240 / 255)
STEP = 1e-3  # mm, by which a lamp is moved for the derivatives by its place
PLACE_SD = 10.0  # mm; what is believed of a lamp's place beforehand
LEAST_SUPPORT = 40  # samples between two nodes, or one of them is left out

# What samples must show before k, γ and a lamp's place are believed (`photometric/identifiability`)
# Errors of the poses make up some signal where there is none: 0.3 % of the distance and 0.1° of the
# normal, apart for each sample, 0.009 of s. A fold of 3° gives 0.02 to 0.05 of it, tilts up to 5° give
# 0.02 of log cos α.
RICH_NODES = 60  # of the BRDF, in the regression
LEAST_GAMMA_SIGNAL = 0.018
LEAST_K_SIGNAL = 0.012
LEAST_LAMP_SIGNAL = 0.006  # of 1 mm

# The light's fit, and when it is believed (`photometric/fit`)
FIRST_K = 2.0  # where the fit begins
FIRST_GAMMA = 2.2
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
HELD_TO = 1e-3  # of its standard deviation, to which an unknown is held

# Lamps (`photometric/lamps`)
LEAST_APART = 1.5  # mm from their middle, below which two lamps pass for one

# Results (`photometric/result`)
LEAST_SCORED = 10  # samples of a bin of angles that are worth a word

"""Constants of the calibration that were chosen by hand, on simulated sheets and on real ones.

Code reads them as ``constants.NAME``.
"""

# Dark round spots on lit paper (`detection/blobs`)
LEAST_WHITE = 0.03  # stored value; what is darker than this is no lit paper
LARGEST = 0.11  # size of a spot over the picture's width
GREY_SHARE = 0.6  # darkness of a grey spot over that of a black one, at most
# Darkness of a spot against the paper around it, and the same where there is grey, too.
LEAST_DARKNESS = 0.25
GREY_DARKNESS = 0.3

# A piece of a lattice, and how far its features may lie off (`detection/lattice`)
LEAST_SPOTS = 12  # of a piece
MOST_SEEDS = 60  # that are tried
CLOSE = 0.3  # lattice steps that a spot may lie off what is predicted
SLACK = 0.3  # px that a feature may lie off, beyond what is usual
MOST_MISS = 0.12  # the same at most, lattice steps

# When a piece is a part of the sheet (`detection/dots`)
LEAST_DOTS = 20  # to tell the code by
PAD = 2  # columns and rows beside the sheet in which false spots may lie
MOST_WRONG = 0.1  # share of the bits
SURETY = 5.0  # logarithm of the odds against a match by chance
MOST_OFF = 0.8  # of a dot's size, where 1 is halfway to the other size

# How large a picture is searched, and which corners are kept (`detection/detect`)
# px, Full HD; larger pictures are made half as large as this before anything is sought.
MOST_PIXELS = 2_100_000
# px; OpenCV's second search for a chessboard takes too long in larger pictures.
MOST_QUICK_PIXELS = 400_000
# px of the shorter side; smaller pictures are enlarged before corners are sought in them ...
FINE_SIDE = 600
LONGEST_SIDE = 2000  # ... until the longer side is as long as this
LEAST_CORNERS = 6  # of a ChArUco board
# Half the side of what a corner is refined by, as a share of the way to the next one.
WINDOW = 0.45
# Of the roughness of refined corners, below which those that were found are better.
SPOILT = 0.8
# Contrast near the corners over that of the middles: of boards .8 to 1.15, of dots 1.6 or more.
SQUARE = (0.3, 1.3)

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

"""Views of a target with exact centroids, made without rendering and without the code under test."""

import numpy as np
from scipy.spatial.transform import Rotation

import endolab as el
from endolab.calibration.geometric.pose import Pose
from endolab.calibration.geometric.reprojection import View
from endolab.calibration.targets import Charuco, Chessboard, DotGrid

PAPER = el.load_calibration("paper").camera
# 190° and more.
WIDE = el.KannalaBrandt(
    1280, 1024, 400.0, 401.0, 645.0, 505.0, (-0.02, 0.004, -0.002, 0.0003)
)
BROWN = el.BrownConrady(
    1920, 1080, 1400.0, 1405.0, 950.0, 530.0, (-0.32, 0.14, 1.5e-3, -1e-3, -0.03)
)
OTHER_TARGETS = [  # than those with a name
    DotGrid(7, 5, 3.25, margin=4.5, fold=3, small=0.5, large=0.9, seed=5, greys=0.25),
    Chessboard(9, 6, 5.5),
    Charuco(9, 6, 5.5, marker=4.0, dictionary="DICT_4X4_50"),
    Charuco(7, 6, 5.5, marker=4.0, first_id=9, legacy=True),
]


def pose_of(vector):
    """Return the pose of a rotation vector, rad, and a translation, mm."""
    rotation = Rotation.from_rotvec(vector[:3]).as_matrix()
    return Pose(rotation, np.array(vector[3:], float))


def reflectance(target, xy, black=0.04):
    """Light that a sheet returns at places (..., 2), mm, relative to its white; nan beside the paper."""
    x, y = np.moveaxis(np.asarray(xy), -1, 0)

    def within(left, top, width, height):
        return (x >= left) & (x <= left + width) & (y >= top) & (y <= top + height)

    value = np.where(within(*target.sheet), 1.0, np.nan)
    for left, top, radius, grey in target.discs:
        value[np.hypot(x - left, y - top) <= radius] = grey or black
    for left, top, side in target.squares:
        value[within(left, top, side, side)] = black
    return value


def exact_centroids(camera, pose, points, radii, rings=8, spokes=32):
    """Centroids of the discs' images: the pixel averaged over the disc with the image's area as weight."""
    if not np.any(radii):
        return camera.project(pose.transform(points))
    node, weight = np.polynomial.legendre.leggauss(rings)
    node = np.repeat((node + 1) / 2, spokes)
    weight = np.repeat(weight, spokes) * node
    phi = np.tile(2 * np.pi * np.arange(spokes) / spokes, rings)
    disc = np.stack([node * np.cos(phi), node * np.sin(phi), 0 * phi], axis=-1)
    places = points[:, None] + np.asarray(radii)[:, None, None] * disc

    def image(shift=(0.0, 0.0, 0.0)):
        return camera.project(pose.transform(places + shift))

    h = 1e-4
    right = image((h, 0, 0)) - image((-h, 0, 0))
    down = image((0, h, 0)) - image((0, -h, 0))
    area = np.abs(right[..., 0] * down[..., 1] - right[..., 1] * down[..., 0]) * weight
    return (image() * area[..., None]).sum(axis=1) / area.sum(axis=1)[:, None]


def centroids_on_panels(camera, target, poses):
    """Exact centroids, or corners, of all features of a sheet, (n, 2), px, from one pose a panel."""
    panel = target.panel_of(target.points)
    pixels = np.empty((len(panel), 2))
    for number, pose in enumerate(poses):
        here = panel == number
        pixels[here] = exact_centroids(
            camera, pose, target.points[here], target.radii[here]
        )
    return pixels


def random_pose(camera, target, rng, near=25.0, far=100.0, tilt=60.0):
    """Pose of a sheet whose middle is seen in the inner part of the picture, facing the camera."""
    size = np.array([camera.width, camera.height])
    while True:
        ray = camera.unproject(rng.uniform(0.2 * size, 0.8 * size))
        lean = np.radians(tilt) * np.sqrt(rng.random())
        about, spin = rng.uniform(0, 2 * np.pi, 2)
        leaning = Rotation.from_rotvec(
            lean * np.array([np.cos(about), np.sin(about), 0.0])
        )
        rotation = (leaning * Rotation.from_rotvec([0, 0, spin])).as_matrix()
        distance = np.exp(rng.uniform(np.log(near), np.log(far)))
        pose = Pose(rotation, ray * distance - rotation @ target.points.mean(axis=0))
        if rotation[:, 2] @ pose.translation > 5:
            return pose


def view_of(camera, target, pose, rng, name="frame", noise=0.08, wrong=0.01):
    """View of what falls into the picture, with noise, px, and a share of points with a wrong id."""
    at = pose.transform(target.points)
    angle = np.arctan2(np.hypot(at[:, 0], at[:, 1]), at[:, 2])
    pixels = exact_centroids(camera, pose, target.points, target.radii)
    size = np.array([camera.width, camera.height])
    inside = np.all((pixels > 8) & (pixels < size - 9), axis=1)
    ids = np.flatnonzero(inside & (angle < camera.max_angle - 0.1))
    pixels = pixels[ids] + rng.normal(0, noise, (len(ids), 2))
    mixed = rng.random(len(ids)) < wrong
    ids[mixed] = (ids[mixed] + rng.choice([-1, 1], mixed.sum())) % len(target.points)
    return View(name, 0, ids, pixels)


def make_views(camera, target, count, rng, noise=0.08, wrong=0.01, **options):
    """Views of 20 points or more, and their true poses."""
    views = []
    poses = []
    while len(views) < count:
        pose = random_pose(camera, target, rng, **options)
        name = f"frame_{len(views):03d}"
        view = view_of(camera, target, pose, rng, name, noise, wrong)
        if len(view.ids) >= 20:
            views.append(view)
            poses.append(pose)
    return views, poses


def map_error(found, camera, angle):
    """Distances between where two cameras see the same rays, out to an angle off the axis (rad), px."""
    pixels = np.mgrid[0 : camera.width : 20, 0 : camera.height : 20].reshape(2, -1).T
    rays = camera.unproject(pixels)
    near = np.arccos(np.clip(rays[:, 2], -1, 1)) < angle
    return np.linalg.norm(found.project(rays[near]) - pixels[near], axis=1)

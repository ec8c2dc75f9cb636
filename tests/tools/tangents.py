"""Normals of a scene by finite differences of its points."""

import numpy as np

STEP = 5e-4  # px


def points_and_normals(scene, camera):
    """Points (H, W, 3) that pixels' rays meet, and unit normals there by points beside them."""
    pixels = np.moveaxis(
        np.indices((camera.height, camera.width))[::-1], 0, -1
    ) + np.array([0.013, 0.021])
    here, right, left, below, above = (
        scene.distance(rays)[..., None] * rays
        for rays in (
            camera.unproject(pixels + STEP * np.array(step))
            for step in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))
        )
    )
    across = np.cross(right - left, below - above)
    return here, across / -np.linalg.norm(across, axis=-1, keepdims=True)

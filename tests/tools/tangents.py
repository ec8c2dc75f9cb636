"""Normals of a scene by finite differences of its points."""

import numpy as np

STEP = 5e-4  # px


def points_and_normals(scene, camera):
    """Points (H, W, 3) that pixels' rays meet, and unit normals there by points beside them."""
    pixels = np.moveaxis(
        np.indices((camera.height, camera.width))[::-1], 0, -1
    ) + np.array([0.013, 0.021])

    def beside(*step):
        rays = camera.unproject(pixels + STEP * np.array(step))
        return scene.distance(rays)[..., None] * rays

    across = np.cross(beside(1, 0) - beside(-1, 0), beside(0, -1) - beside(0, 1))
    return beside(0, 0), across / np.linalg.norm(across, axis=-1, keepdims=True)

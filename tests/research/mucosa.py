"""What the wall of a colon looks like: mottled, with vessels and stains, under a wet film, or rough."""

import numpy as np

from endolab.synthetic.rendering import RIPPLE_SCALE, RIPPLE_SLOPE, TEXTURE_SCALE, waves

VEIL = 0.02  # linear value, of sensor maximum 1, that fog tends to in the distance
ROUGHNESS = 0.15  # of the film; its GGX width is the square
MOTTLE = np.array([0.6, 1.0, 1.0])  # share of the texture in red, green and blue
BLOOD = np.array([0.25, 1.0, 0.9])  # what vessels take, as logarithms
VESSELS = ((9.0, 0.7, 1.0), (4.0, 0.4, 0.5))  # mm between them, mm of half width, share
BILE = np.array([0.3, 0.7, 1.0])  # what stains take, as logarithms
# mm; how soft their edge is, of the standard deviation of the waves
STAIN_SIZE = 12.0
STAIN_EDGE = 0.15
RARE = 1.3  # standard deviations above which a smooth random function is a stain: a tenth of the wall


def tissue(points, albedo, texture, vessels, seed=0, stains=0.0):
    """Albedo (..., 3) of mucosa at points (..., 3), mm: mottled, with vessels, stained; from 0.01 to 0.95.

    `albedo` is that of red, green and blue without either, `texture` the standard deviation of the
    logarithm of that of green and blue, `vessels` what the middle of a vessel takes from the logarithm of
    the green one, `stains` what a stain takes from that of the blue one.
    """
    rng = np.random.default_rng([seed, 0])
    mottle = waves(points, TEXTURE_SCALE, rng)[0]
    blood = np.zeros(points.shape[:-1])
    for (
        spacing,
        width,
        share,
    ) in VESSELS:  # thin lines where a smooth random function vanishes
        away = waves(points, spacing, rng)[0] * spacing / width
        blood = np.maximum(blood, share * np.exp(-(away**2)))
    log = texture * mottle[..., None] * MOTTLE - vessels * blood[..., None] * BLOOD
    if stains:
        wave = waves(points, STAIN_SIZE, np.random.default_rng([seed, 5]))[0]
        log -= (
            stains * (0.5 + 0.5 * np.tanh((wave - RARE) / STAIN_EDGE))[..., None] * BILE
        )
    return np.clip(albedo * np.exp(log), 0.01, 0.95)


def rippled(points, normals, seed=0):
    """Unit normals (n, 3) of a wet film on a wall, given the wall's points (mm) and normals, (n, 3)."""
    slope = waves(points, RIPPLE_SCALE, np.random.default_rng([seed, 3]))[1]
    turned = normals + RIPPLE_SLOPE * RIPPLE_SCALE * slope
    return turned / np.linalg.norm(turned, axis=-1, keepdims=True)


def film_radiance(points, normals, light, film, roughness=ROUGHNESS):
    """Light (n,) that a wet film or a rough wall mirrors from one light to the optical centre.

    E D F G / (4 cos θ_i cos θ_v) cos θ_i (Walter et al. 2007), with the light's E at normal incidence;
    `film` is the share reflected at normal incidence; 0.02 is water. D is GGX, of a width that is the square
    of `roughness`. Points in mm.
    """
    radiance, reach = light.illuminate(points)
    to_light = (np.asarray(light.position) - points) / reach[:, None]
    to_camera = -points / np.linalg.norm(points, axis=-1, keepdims=True)
    half = to_light + to_camera
    half /= np.linalg.norm(half, axis=-1, keepdims=True)

    def cosine(a, b):
        return np.maximum(np.einsum("ij,ij->i", a, b), 1e-4)

    width = roughness**4
    n_l = cosine(normals, to_light)
    n_v = cosine(normals, to_camera)
    n_h = cosine(normals, half)
    facets = width / (np.pi * (n_h**2 * (width - 1) + 1) ** 2)
    fresnel = film + (1 - film) * (1 - cosine(to_camera, half)) ** 5
    seen = np.ones(len(points))
    for c in (n_l, n_v):
        seen *= 2 * c / (c + np.sqrt(width + (1 - width) * c * c))
    return radiance * facets * fresnel * seen / (4 * n_v)

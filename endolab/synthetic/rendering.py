"""Frames that an endoscope would make of a scene, by the general model, with their truth."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from endolab.model.brdf import Glossy, Lambertian
from endolab.model.cameras import Camera
from endolab.model.photometry import CHANNELS, Photometry
from endolab.numerics.arrays import BoolArray, FloatArray
from endolab.numerics.checks import check_int, check_kinds, number
from endolab.numerics.memory import RENDERING_BYTES, check_memory
from endolab.synthetic.scenes import Scene

TEXTURE_SCALE = 5.0  # mm, of the mottled albedo
RIPPLE_SCALE = 1.5  # mm, of the wet film whose slopes break up the highlights
RIPPLE_SLOPE = 0.12


@dataclass(frozen=True, eq=False)
class Rendered:
    """A rendered frame and its truth."""

    image: FloatArray  # (H, W) or (H, W, 3), stored values in [0, 1]
    distance: FloatArray  # (H, W), Euclidean, from the optical centre, mm; nan where there is no surface
    normals: FloatArray  # (H, W, 3), unit normals in the camera frame, towards the camera
    mask: BoolArray  # (H, W), pixels that see the surface
    camera: Camera
    photometry: Photometry  # with the gain that was used

    @property
    def z(self) -> FloatArray:
        """z component of the distance, (H, W), mm."""
        return self.distance * self.camera.field.cos_alpha


def waves(
    points: FloatArray, scale: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return a smooth random function of space, of mean 0 and variance 1, and its gradient."""
    count = 32
    vectors = rng.normal(size=(count, 3)) / scale
    phases = rng.uniform(0, 2 * np.pi, count)
    value = np.zeros(points.shape[:-1])
    slope = np.zeros(points.shape)
    for vector, phase in zip(vectors, phases, strict=True):
        angle = points @ vector + phase
        value += np.sin(angle)
        slope += np.cos(angle)[..., None] * vector
    return value * np.sqrt(2 / count), slope * np.sqrt(2 / count)


def develop(
    linear: FloatArray, gamma: float, noise: float, bits: int | None, seed: int
) -> FloatArray:
    """Stored values of linear light, with noise (grey levels of 255) and rounded to some bits."""
    stored = linear ** (1 / gamma)
    if noise:
        rng = np.random.default_rng([seed, 1])
        stored = stored + rng.normal(scale=noise / 255, size=stored.shape)
    stored = np.clip(stored, 0.0, 1.0)
    return stored if bits is None else np.round(stored * (2**bits - 1)) / (2**bits - 1)


def truth_of(scene: Scene, camera: Camera) -> dict[str, Any]:
    """What a frame of a scene has beside its picture and light, see `Rendered`."""
    check_memory(
        RENDERING_BYTES * camera.width * camera.height,
        f"a picture of {camera.width}x{camera.height} px",
    )
    rays = camera.field.rays
    distance = scene.distance(rays)
    normals = np.full(rays.shape, np.nan)
    mask = np.isfinite(distance) & (camera.field.cos_alpha > 0)
    normals[mask] = scene.normals(distance[mask, None] * rays[mask])
    return {
        "distance": np.where(mask, distance, np.nan),
        "normals": normals,
        "mask": mask,
        "camera": camera,
    }


def expose(photometry: Photometry, linear: FloatArray) -> float:
    """The gain or, if it is unknown, one that puts the 99th percentile of the brightest channel at 0.9."""
    if not linear.any():
        raise ValueError("the camera sees no lit surface in this scene")
    if photometry.gain is not None:
        return photometry.gain
    return float(0.9**photometry.gamma / np.percentile(linear.max(axis=-1), 99))


@check_kinds(scene=Scene, camera=Camera, photometry=Photometry)
def render(
    scene: Scene,
    camera: Camera,
    photometry: Photometry,
    *,
    noise: float = 0.0,
    bits: int | None = None,
    texture: float = 0.0,
    highlights: float = 0.0,
    seed: int = 0,
) -> Rendered:
    """Render a scene by the general model.

    Parameters
    ----------
    scene : Scene
        What is seen.
    camera : Camera
        What sees it.
    photometry : Photometry
        Lights and response; with an unknown gain, one that puts the 99th percentile of the
        brightest channel at 0.9 is chosen. Three albedos give a colour picture.
    noise : float
        Standard deviation of Gaussian noise, grey levels of 255.
    bits : int, optional
        Round to this many bits; none by default.
    texture : float
        Standard deviation of the logarithm of the albedo.
    highlights : float
        Share of the light that a wet, rippled film reflects like a mirror; 0.02 is water.
    seed : int
        Of texture, ripples and noise.

    Returns
    -------
    Rendered
        Lights cast no shadows and light bounces once: the model's own assumptions.

    Raises
    ------
    ValueError
        If an option is negative or not finite, or if the camera sees nothing lit.

    Examples
    --------
    >>> import endolab as el
    >>> known = el.load_calibration("simple", width=80)
    >>> seen = el.render(el.SCENES["tube"], known.camera, known.photometry, noise=1, bits=8)
    >>> seen.image.shape, seen.distance.shape
    ((60, 80, 3), (60, 80))
    """
    effects = {"noise": noise, "texture": texture, "highlights": highlights}
    for name, amount in effects.items():
        number(name, amount, 0, 100)  # beyond, numbers overflow
    if bits is not None:
        number("bits", bits, 1, 16)
    truth = truth_of(scene, camera)
    mask = truth["mask"]
    distance = truth["distance"][mask]
    normals = truth["normals"][mask]
    seen = distance[:, None] * camera.field.rays[mask]
    rng = np.random.default_rng([check_int("seed", seed), 0])
    mottle = np.exp(texture * waves(seen, TEXTURE_SCALE, rng)[0]) if texture else 1.0
    ripple = waves(seen, RIPPLE_SCALE, rng)[1] if highlights else None

    lit = replace(photometry, gain=1.0)
    albedo = getattr(photometry.brdf, "albedo", None)
    models = (
        [lit.channel(name) for name in CHANNELS] if isinstance(albedo, tuple) else [lit]
    )
    linear = np.stack(
        [mottle * model.intensity(seen, normals) ** lit.gamma for model in models], axis=-1
    )
    if ripple is not None:
        rough = normals + RIPPLE_SLOPE * RIPPLE_SCALE * ripple
        rough /= np.linalg.norm(rough, axis=-1, keepdims=True)
        film = Glossy(1.0, highlights, 300.0)
        matt = Lambertian(1.0)
        wet, dry = (
            replace(lit, brdf=brdf).intensity(seen, rough) ** lit.gamma
            for brdf in (film, matt)
        )
        linear = linear + (wet - dry)[:, None]

    gain = expose(photometry, linear)
    linear = linear * gain
    image = np.zeros((*mask.shape, linear.shape[-1]))
    image[mask] = develop(linear, lit.gamma, noise, bits, seed)
    image = image if len(models) == 3 else image[..., 0]
    return Rendered(image=image, photometry=replace(photometry, gain=gain), **truth)

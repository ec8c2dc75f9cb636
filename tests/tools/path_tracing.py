"""Frames in which light bounces, path-traced with Mitsuba 3 (the optional extra `endolab[render]`).

Lights, camera and response are those of the general model (`photometry`), so what a traced frame
shows beyond `rendering.render` is what the model leaves out: light that comes by way of other
walls, shadows, and a wet film. Each is kept as a layer of its own, in linear light times the gain:

- direct: Σ_l E_l a/π, E_l = b_l cosᵐψ_l cos θ_l / r_l², 0 in a shadow (Photometry, eq. 6);
- indirect: what the walls send one another (Kajiya 1986), the walls being Lambertian. Paths from
  every vertex of the mesh, joined to every light at every turn and ended by Russian roulette,
  measure its irradiance by way of other walls; each pixel then gathers by rays of its own what
  the walls around it send (Jensen 2001, final gathering), with the direct light there exact;
- mirrored: a microfacet film (Walter et al. 2007: GGX, Smith, Schlick) of its own small ripples,
  straight from the lights, in their shadows too; and so the sheen of a rough wall, without ripples.

A sheen mirrors what other walls send as well, which is indirect light; between walls it is left out.

All three fade by cos^k α when the photometry names its lights, k being the vignetting's. When it
names none, the whole joint exponent k is taken for the spread of the light at the optical centre:
the direct layer cannot tell the two apart, the indirect one can.
"""

from dataclasses import dataclass, replace
from importlib import import_module
from math import isqrt
from typing import Any

import numpy as np

from endolab.model.cameras import Camera
from endolab.model.lights import SpotLight
from endolab.model.photometry import Photometry
from endolab.numerics.arrays import FloatArray, IntArray
from endolab.synthetic.rendering import VEIL, Rendered, develop, expose, truth_of
from endolab.synthetic.scenes import Scene
from tests.tools.meshes import mesh_of
from tests.tools.mucosa import ROUGHNESS, film_radiance, rippled, tissue

VARIANT = "llvm_ad_rgb"
OLDEST_LLVM = 16  # older ones abort on processors with AVX-512
SURE_BOUNCES = 3  # before the roulette
PIXELS_FOR_A_VERTEX = 32  # paths of a pixel for one of a vertex


# R2, the golden ratio of the plane: its multiples are even over the square (Roberts, 2018).
GOLDEN = np.array([0.7548776662466927, 0.5698402909980532])


@dataclass(frozen=True)
class Traced(Rendered):
    """A path-traced frame, its truth, and where its light came from, 1 being the sensor's maximum."""

    direct: FloatArray  # (H, W, 3), linear light times gain; an average over the pixel
    indirect: FloatArray  # (H, W, 3), the same
    mirrored: FloatArray  # (H, W), the same, of the lamps in film or sheen; equal in all channels


def mitsuba() -> tuple[Any, Any]:
    """Return the modules `mitsuba`, set to its LLVM variant, and `drjit`.

    OSError in one sentence with the command that installs it, if Mitsuba or LLVM cannot be used.
    """
    try:
        mi = import_module("mitsuba")
        dr = import_module("drjit")
    except ImportError as error:
        raise OSError(
            f'path tracing needs Mitsuba 3 ({error}); install it with: python -m pip install "mitsuba>=3.9"'
        ) from error
    found = dr.detail.llvm_version()[0] if dr.has_backend(dr.JitBackend.LLVM) else 0
    if found < OLDEST_LLVM:
        raise OSError(
            f"Mitsuba needs LLVM {OLDEST_LLVM} or newer and found {found or 'none'}; on Debian install it "
            "with: apt install libllvm19 (or name the library in DRJIT_LIBLLVM_PATH)"
        )
    mi.set_variant(VARIANT)
    return mi, dr


class _Tracer:
    """A scene in Mitsuba's hands, and the light that its walls send."""

    def __init__(
        self,
        vertices: FloatArray,
        triangles: IntArray,
        normals: FloatArray,
        albedo: FloatArray,
        lights: tuple[SpotLight, ...],
        fog: float,
    ) -> None:
        self.mi, self.dr = mitsuba()
        mi = self.mi
        self.vertices = vertices
        self.normals = normals
        self.lights = lights
        self.fog = fog
        self.wall = mi.Mesh(
            "wall", len(vertices), len(triangles), has_vertex_normals=True
        )
        self.wall.add_attribute("vertex_albedo", 3, albedo.astype(np.float32).ravel())
        self.wall.add_attribute(
            "vertex_bounced", 3, np.zeros(self.vertices.size, np.float32)
        )
        content = mi.traverse(self.wall)
        content["vertex_positions"] = vertices.astype(np.float32).ravel()
        content["vertex_normals"] = normals.astype(np.float32).ravel()
        content["faces"] = triangles.astype(np.uint32).ravel()
        content.update()
        self.world = mi.load_dict({"type": "scene", "wall": self.wall})

    def _vectors(self, values: FloatArray) -> Any:
        return self.mi.Vector3f(
            *(np.ascontiguousarray(part, dtype=np.float32) for part in values.T)
        )

    def _turned(self, normal: Any, start: FloatArray) -> Any:
        """Directions about normals, even in cosine, chosen by two numbers in [0, 1) each (2, n)."""
        chosen = self.mi.Point2f(
            *(np.ascontiguousarray(part, dtype=np.float32) for part in start)
        )
        return self.mi.Frame3f(normal).to_world(
            self.mi.warp.square_to_cosine_hemisphere(chosen)
        )

    def _meet(self, ray: Any, active: Any = True) -> tuple[Any, Any, Any, Any]:
        """What rays meet: hits, unit normals, whether they see the wall's face, and what is left of 1."""
        mi = self.mi
        dr = self.dr
        hit = self.world.ray_intersect(ray, active)
        normal = dr.normalize(hit.sh_frame.n)
        facet = dr.mulsign(
            hit.n, dr.dot(hit.n, normal)
        )  # whichever way the triangle turns
        # The wall's back is black.
        faced = mi.Mask(active) & hit.is_valid() & (dr.dot(facet, ray.d) < 0)
        left = self._attribute("vertex_albedo", hit, faced)
        return (
            hit,
            normal,
            faced,
            left * dr.exp(-self.fog * dr.select(faced, hit.t, 0.0)),
        )

    def _attribute(self, name: str, hit: Any, active: Any) -> Any:
        value = self.mi.Color3f(hit.shape.eval_attribute_3(name, hit, active))
        return self.dr.select(active, value, 0.0)

    def _arriving(self, hit: Any, normal: Any, lamp: SpotLight, active: Any) -> Any:
        """Irradiance of hits from a light; 0 in its shadow."""
        mi = self.mi
        dr = self.dr
        way = mi.Point3f(lamp.position) - hit.p
        square = dr.squared_norm(way)
        way = way / dr.sqrt(square)
        front = -dr.dot(way, mi.Vector3f(lamp.direction))
        cosine = dr.dot(normal, way)
        spread = lamp.weight * dr.power(dr.maximum(front, 1e-6), lamp.exponent)
        active = active & (front > 0) & (cosine > 0)
        active &= ~self.world.ray_test(
            hit.spawn_ray_to(mi.Point3f(lamp.position)), active
        )
        return dr.select(
            active, spread * dr.exp(-self.fog * dr.sqrt(square)) * cosine / square, 0.0
        )

    def _lit(self, hit: Any, normal: Any, active: Any) -> Any:
        return sum(self._arriving(hit, normal, lamp, active) for lamp in self.lights)

    def _follow(self, ray: Any, turns: int, seed: int) -> Any:
        """Radiance along rays, by one path each of at most `turns` turns."""
        mi = self.mi
        dr = self.dr
        count = dr.width(ray)
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, count)

        def turn(bounce, ray, left, sent, active, sampler):  # type: ignore[no-untyped-def]
            hit, normal, active, kept = self._meet(ray, active)
            left *= kept
            sent += dr.select(
                active, left * self._lit(hit, normal, active) / dr.pi, 0.0
            )
            away = mi.Frame3f(normal).to_world(
                mi.warp.square_to_cosine_hemisphere(sampler.next_2d(active))
            )
            luck = dr.select(
                bounce >= SURE_BOUNCES, dr.clip(dr.max(left), 0.05, 0.95), 1.0
            )
            active &= (sampler.next_1d(active) < luck) & (bounce < turns)
            return bounce + 1, hit.spawn_ray(away), left / luck, sent, active, sampler

        zero = dr.zeros(mi.Color3f, count)
        state = (
            dr.zeros(mi.UInt32, count),
            ray,
            zero + 1.0,
            zero,
            dr.full(mi.Mask, True, count),
            sampler,
        )
        labels = ("bounce", "ray", "left", "sent", "active", "sampler")
        # Recorded as one loop: unrolled, the same turns compile for minutes.
        return dr.while_loop(state, lambda *values: values[4], turn, labels=labels)[3]

    def fill(self, turns: int, paths: int, seed: int) -> None:
        """Give every vertex the irradiance that comes by way of other walls."""
        mi = self.mi
        rng = np.random.default_rng([seed, 4])
        turned = rng.uniform(size=(2, len(self.vertices)))
        normal = self._vectors(self.normals)
        sums = np.zeros(self.vertices.shape)
        place = self._vectors(
            self.vertices + self.normals * (1e-4 * np.abs(self.vertices).max())
        )
        for index in range(paths):
            away = self._turned(normal, (turned + index * GOLDEN[:, None]) % 1)
            radiance = self._follow(
                mi.Ray3f(o=mi.Point3f(place), d=away), turns, int(rng.integers(2**32))
            )
            sums += np.array(radiance, dtype=np.float64).T
        content = mi.traverse(self.wall)
        content["vertex_bounced"] = (np.pi / paths * sums).astype(np.float32).ravel()
        content.update()

    def look(self, rays: FloatArray) -> tuple[Any, FloatArray]:
        """What unit rays (n, 3) from the centre meet, and its direct light (n, 3)."""
        met = self._meet(self.mi.Ray3f(o=self.mi.Point3f(0.0), d=self._vectors(rays)))
        hit, normal, faced, left = met
        direct = left * self._lit(hit, normal, faced) / self.dr.pi
        self.dr.eval(*met, direct)
        return met, np.array(direct, dtype=np.float64).T

    def gather(
        self, met: Any, start: FloatArray, sheen: float, roughness: float
    ) -> FloatArray:
        """Indirect light (n, 3) of what was met, by one more ray each that `start` (2, n) chooses."""
        dr = self.dr
        hit, normal, faced, left = met
        sent = left * self._sent(hit.spawn_ray(self._turned(normal, start)), faced)
        if sheen:
            away, weight = self._mirrored_way(hit, normal, start, sheen, roughness)
            clear = dr.exp(-self.fog * dr.select(faced, hit.t, 0.0))
            sent += (
                clear * weight * self._sent(hit.spawn_ray(away), faced & (weight > 0))
            )
        return np.array(sent, dtype=np.float64).T

    def _sent(self, ray: Any, active: Any) -> Any:
        """What the walls that rays meet send back along them."""
        hit, normal, faced, left = self._meet(ray, active)
        arriving = self._attribute("vertex_bounced", hit, faced) + self._lit(
            hit, normal, faced
        )
        return self.dr.select(faced, left * arriving / self.dr.pi, 0.0)

    def _mirrored_way(
        self, hit: Any, normal: Any, start: FloatArray, sheen: float, roughness: float
    ) -> tuple[Any, Any]:
        """Ways from which facets, chosen by GGX, mirror light to the camera, and what share of it.

        The share is F G (v·h) / (n·v n·h), with v to the camera and h the facet's normal.
        """
        mi = self.mi
        dr = self.dr
        width = roughness**4
        first, turn = (
            dr.llvm.Float(np.ascontiguousarray(part, dtype=np.float32))
            for part in start
        )
        steep = dr.sqrt(width * first / (1 - first))
        local = mi.Vector3f(
            steep * dr.cos(2 * dr.pi * turn), steep * dr.sin(2 * dr.pi * turn), 1.0
        )
        facet = mi.Frame3f(normal).to_world(dr.normalize(local))
        to_camera = dr.normalize(-mi.Vector3f(hit.p))
        met = dr.dot(to_camera, facet)
        away = 2 * met * facet - to_camera
        n_v, n_l, n_h = (
            dr.maximum(dr.dot(normal, one), 1e-4) for one in (to_camera, away, facet)
        )
        share = (sheen + (1 - sheen) * (1 - met) ** 5) * met / (n_v * n_h)
        for c in (n_l, n_v):
            share *= 2 * c / (c + dr.sqrt(width + (1 - width) * c * c))
        return away, dr.select((met > 0) & (dr.dot(normal, away) > 0), share, 0.0)

    def mirrored(
        self, met: Any, film: float, sheen: float, roughness: float, seed: int
    ) -> FloatArray:
        """Light (n,) of the lamps that the film and the sheen of what was met send back."""
        hit, normal, faced, _ = met
        points = np.array(hit.p, dtype=np.float64).T
        normals = np.array(normal, dtype=np.float64).T
        total = np.zeros(len(points))
        wet = rippled(points, normals, seed) if film else normals
        for lamp in self.lights:
            lit = np.array(self._arriving(hit, normal, lamp, faced)) > 0
            there = points[lit]
            way = np.linalg.norm(
                there - np.asarray(lamp.position), axis=-1
            ) + np.linalg.norm(there, axis=-1)
            for share, rough, turned in (
                (film, ROUGHNESS, wet),
                (sheen, roughness, normals),
            ):
                if share:
                    sent = film_radiance(there, turned[lit], lamp, share, rough)
                    total[lit] += np.exp(-self.fog * way) * sent
        return total


def _subpixels(camera: Camera, side: int, rng: np.random.Generator) -> FloatArray:
    """Rays (side², H·W, 3), one through each part of each pixel; nan where the camera has none."""
    row, column = np.mgrid[: camera.height, : camera.width].reshape(2, -1)
    part = np.mgrid[:side, :side].reshape(2, -1, 1)
    place = (part + rng.uniform(size=(2, side**2, row.size))) / side - 0.5
    rays = camera.unproject(np.stack([column + place[1], row + place[0]], axis=-1))
    rays[~(rays[..., 2] > 0)] = np.nan  # behind
    return rays


def trace(
    scene: Scene,
    camera: Camera,
    photometry: Photometry,
    *,
    texture: float = 0.0,
    vessels: float = 0.0,
    stains: float = 0.0,
    film: float = 0.0,
    sheen: float = 0.0,
    roughness: float = 0.5,
    fog: float = 0.0,
    noise: float = 0.0,
    bounces: int = 16,
    samples: int = 64,
    seed: int = 0,
    mesh_size: int = 300,
) -> Traced:
    """Path-trace a scene; the paths meet its mesh, of `mesh_size` steps a side.

    Lights, response and mean albedos (Lambertian, below 1) are those of the photometry; with an unknown gain,
    one that puts the 99th percentile of the brightest channel, highlights apart, at 0.9 is chosen. `fog` and
    `noise` are as for `render`, `texture`, `vessels` and `stains` as for `tissue`; `film` is the
    share of the light that a wet film mirrors at normal incidence, 0.02 being water, `sheen` that of a rough
    wall, whose GGX width is the square of `roughness`, at least 0.2. `bounces` are the turns of a path
    after the first wall, 0 leaving the direct light alone; `samples` the paths a pixel, rounded up to whole
    grids of at most 4x4 places in it. `seed` is of texture, ripples, noise and paths. The picture has 8 bits.

    OSError as for `mitsuba`; ValueError if the camera sees nothing lit.
    """
    mean = np.broadcast_to(np.asarray(photometry.brdf.albedo, dtype=np.float64), (3,))
    vignetting = photometry if photometry.lights else replace(photometry, k=0.0)
    lights = photometry.lights or (SpotLight(exponent=photometry.k),)

    vertices, triangles = mesh_of(scene, mesh_size)
    albedo = tissue(vertices, mean, texture, vessels, seed, stains)
    tracer = _Tracer(vertices, triangles, scene.normals(vertices), albedo, lights, fog)
    if bounces > 1:
        tracer.fill(bounces - 2, max(1, samples // PIXELS_FOR_A_VERTEX), seed)
    rng = np.random.default_rng([seed, 2])
    side = min(isqrt(samples), 4)
    rays = _subpixels(camera, side, rng)
    # Every pixel starts the sequence elsewhere.
    turned = rng.uniform(size=(2, 1, rays.shape[1]))
    defined = ~np.isnan(rays[..., 2])
    met, direct = tracer.look(rays[defined])
    layers = np.zeros((*defined.shape, 7))
    layers[defined, :3] = direct
    rounds = -(-samples // side**2)
    for again in range(rounds if bounces else 0):
        index = (again * side**2 + np.arange(side**2))[:, None]
        start = (turned + index * GOLDEN[:, None, None])[:, defined] % 1
        layers[defined, 3:6] += tracer.gather(met, start, sheen, roughness) / rounds
    if film or sheen:
        layers[defined, 6] = tracer.mirrored(met, film, sheen, roughness, seed)
    layers[defined] *= vignetting.attenuation(rays[defined][:, 2])[:, None]
    average = layers.sum(axis=0) / np.maximum(defined.sum(axis=0), 1)[:, None]
    truth = truth_of(scene, camera)
    mask = truth["mask"]
    average = np.where(
        mask[..., None], average.reshape(camera.height, camera.width, 7), 0.0
    )
    gain = expose(photometry, (average[..., :3] + average[..., 3:6])[mask])
    direct, indirect, mirrored = np.split(gain * average, [3, 6], axis=-1)
    image = stored(
        direct + indirect + mirrored,
        truth["distance"],
        photometry.gamma,
        fog,
        noise,
        seed,
    )
    light = {"direct": direct, "indirect": indirect, "mirrored": mirrored[..., 0]}
    return Traced(
        image=image, photometry=replace(photometry, gain=gain), **truth, **light
    )


def stored(
    light: FloatArray,
    distance: FloatArray,
    gamma: float,
    fog: float,
    noise: float,
    seed: int,
) -> FloatArray:
    """The picture (H, W, 3) of 8 bits that a sensor makes of linear light, with the fog's veil."""
    veil = VEIL * (1 - np.exp(-fog * np.nan_to_num(distance)))[..., None]
    return np.where(
        np.isfinite(distance)[..., None],
        develop(light + veil, gamma, noise, 8, seed),
        0.0,
    )

"""Frames in which light bounces, path-traced with Mitsuba 3 (the optional extra `endolab[render]`).

To import it needs Mitsuba; OSError in one sentence if its LLVM is too old.

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
from math import isqrt

import drjit as dr
import mitsuba as mi
import numpy as np

import endolab as el
from endolab.numerics.arrays import FloatArray
from endolab.synthetic.rendering import Rendered, develop, expose, truth_of
from tests.research.mucosa import ROUGHNESS, VEIL, film_radiance, rippled, tissue
from tests.tools.meshes import mesh_of

OLDEST_LLVM = 16  # older ones abort on processors with AVX-512
SURE_BOUNCES = 3  # before the roulette
PIXELS_FOR_A_VERTEX = 32  # paths of a pixel for one of a vertex
# R2, the golden ratio of the plane: its multiples are even over the square (Roberts, 2018).
GOLDEN = np.array([0.7548776662466927, 0.5698402909980532])

if not dr.has_backend(dr.JitBackend.LLVM) or dr.detail.llvm_version()[0] < OLDEST_LLVM:
    raise OSError(
        f"Mitsuba needs LLVM {OLDEST_LLVM} or newer: on Debian apt install libllvm19, or name the library "
        "in DRJIT_LIBLLVM_PATH"
    )
mi.set_variant("llvm_ad_rgb")


@dataclass(frozen=True)
class Traced(Rendered):
    """A path-traced frame, its truth, and where its light came from, 1 being the sensor's maximum."""

    direct: FloatArray  # (H, W, 3), linear light times gain; an average over the pixel
    indirect: FloatArray  # (H, W, 3), the same
    mirrored: FloatArray  # (H, W), the same, of the lamps in film or sheen; equal in all channels


def _single(parts):
    """Parts of single precision, as Mitsuba takes them."""
    return [np.ascontiguousarray(part, dtype=np.float32) for part in parts]


def _double(values):
    """Numbers (n, 3) or (n,) that Mitsuba computed."""
    return np.array(values, dtype=np.float64).T


def _turned(normal, start):
    """Directions about normals, even in cosine, chosen by two numbers in [0, 1) each (2, n)."""
    chosen = mi.warp.square_to_cosine_hemisphere(mi.Point2f(*_single(start)))
    return mi.Frame3f(normal).to_world(chosen)


class _Tracer:
    """A scene in Mitsuba's hands, and the light that its walls send."""

    def __init__(self, vertices, triangles, normals, albedo, lights, fog):
        self.vertices = vertices
        self.normals = normals
        self.lights = lights
        self.fog = fog
        self.wall = mi.Mesh(
            "wall", len(vertices), len(triangles), has_vertex_normals=True
        )
        self.wall.add_attribute("vertex_albedo", 3, albedo.astype(np.float32).ravel())
        self.wall.add_attribute(
            "vertex_bounced", 3, np.zeros(vertices.size, np.float32)
        )
        self._set("vertex_positions", vertices.astype(np.float32))
        self._set("vertex_normals", normals.astype(np.float32))
        self._set("faces", triangles.astype(np.uint32))
        self.world = mi.load_dict({"type": "scene", "wall": self.wall})

    def _set(self, name, values):
        content = mi.traverse(self.wall)
        content[name] = values.ravel()
        content.update()

    def _meet(self, ray, active=True):
        """What rays meet: hits, unit normals, whether they see the wall's face, and what is left of 1."""
        hit = self.world.ray_intersect(ray, active)
        normal = dr.normalize(hit.sh_frame.n)
        facet = dr.mulsign(
            hit.n, dr.dot(hit.n, normal)
        )  # whichever way the triangle turns
        # The wall's back is black.
        faced = mi.Mask(active) & hit.is_valid() & (dr.dot(facet, ray.d) < 0)
        left = self._attribute("vertex_albedo", hit, faced)
        return hit, normal, faced, left * self._clear(hit, faced)

    def _clear(self, hit, faced):
        """What fog leaves of light on its way from a hit."""
        return dr.exp(-self.fog * dr.select(faced, hit.t, 0.0))

    def _attribute(self, name, hit, active):
        value = mi.Color3f(hit.shape.eval_attribute_3(name, hit, active))
        return dr.select(active, value, 0.0)

    def _arriving(self, hit, normal, lamp, active):
        """Irradiance of hits from a light; 0 in its shadow."""
        way = mi.Point3f(lamp.position) - hit.p
        square = dr.squared_norm(way)
        way = way / dr.sqrt(square)
        front = -dr.dot(way, mi.Vector3f(lamp.direction))
        cosine = dr.dot(normal, way)
        spread = lamp.weight * dr.power(dr.maximum(front, 1e-6), lamp.exponent)
        active = active & (front > 0) & (cosine > 0)
        shadow = hit.spawn_ray_to(mi.Point3f(lamp.position))
        active &= ~self.world.ray_test(shadow, active)
        light = spread * dr.exp(-self.fog * dr.sqrt(square)) * cosine / square
        return dr.select(active, light, 0.0)

    def _lit(self, hit, normal, active):
        return sum(self._arriving(hit, normal, lamp, active) for lamp in self.lights)

    def _follow(self, ray, turns, seed):
        """Radiance along rays, by one path each of at most `turns` turns."""
        count = dr.width(ray)
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, count)

        def turn(bounce, ray, left, sent, active, sampler):
            hit, normal, active, kept = self._meet(ray, active)
            left *= kept
            light = left * self._lit(hit, normal, active) / dr.pi
            sent += dr.select(active, light, 0.0)
            chosen = mi.warp.square_to_cosine_hemisphere(sampler.next_2d(active))
            away = mi.Frame3f(normal).to_world(chosen)
            likely = dr.clip(dr.max(left), 0.05, 0.95)
            luck = dr.select(bounce >= SURE_BOUNCES, likely, 1.0)
            active &= (sampler.next_1d(active) < luck) & (bounce < turns)
            return bounce + 1, hit.spawn_ray(away), left / luck, sent, active, sampler

        zero = dr.zeros(mi.Color3f, count)
        every = dr.full(mi.Mask, True, count)
        state = (dr.zeros(mi.UInt32, count), ray, zero + 1.0, zero, every, sampler)
        # Recorded as one loop: unrolled, the same turns compile for minutes.
        return dr.while_loop(state, lambda *values: values[4], turn)[3]

    def fill(self, turns, paths, seed):
        """Give every vertex the irradiance that comes by way of other walls."""
        rng = np.random.default_rng([seed, 4])
        turned = rng.uniform(size=(2, len(self.vertices)))
        normal = mi.Vector3f(*_single(self.normals.T))
        above = self.vertices + self.normals * (1e-4 * np.abs(self.vertices).max())
        place = mi.Point3f(*_single(above.T))
        sums = np.zeros(self.vertices.shape)
        for index in range(paths):
            away = _turned(normal, (turned + index * GOLDEN[:, None]) % 1)
            ray = mi.Ray3f(o=place, d=away)
            sums += _double(self._follow(ray, turns, int(rng.integers(2**32))))
        self._set("vertex_bounced", (np.pi / paths * sums).astype(np.float32))

    def look(self, rays):
        """What unit rays (n, 3) from the centre meet, and its direct light (n, 3)."""
        away = mi.Vector3f(*_single(rays.T))
        met = self._meet(mi.Ray3f(o=mi.Point3f(0.0), d=away))
        hit, normal, faced, left = met
        direct = left * self._lit(hit, normal, faced) / dr.pi
        dr.eval(*met, direct)
        return met, _double(direct)

    def gather(self, met, start, sheen, roughness):
        """Indirect light (n, 3) of what was met, by one more ray each that `start` (2, n) chooses."""
        hit, normal, faced, left = met
        sent = left * self._sent(hit.spawn_ray(_turned(normal, start)), faced)
        if sheen:
            away, weight = _mirrored_way(hit, normal, start, sheen, roughness)
            mirrored = self._sent(hit.spawn_ray(away), faced & (weight > 0))
            sent += self._clear(hit, faced) * weight * mirrored
        return _double(sent)

    def _sent(self, ray, active):
        """What the walls that rays meet send back along them."""
        hit, normal, faced, left = self._meet(ray, active)
        bounced = self._attribute("vertex_bounced", hit, faced)
        arriving = bounced + self._lit(hit, normal, faced)
        return dr.select(faced, left * arriving / dr.pi, 0.0)

    def mirrored(self, met, film, sheen, roughness, seed):
        """Light (n,) of the lamps that the film and the sheen of what was met send back."""
        hit, normal, faced, _ = met
        points = _double(hit.p)
        normals = _double(normal)
        total = np.zeros(len(points))
        wet = rippled(points, normals, seed)
        for lamp in self.lights:
            lit = np.array(self._arriving(hit, normal, lamp, faced)) > 0
            there = points[lit]
            way = np.linalg.norm(there - lamp.position, axis=-1)
            way += np.linalg.norm(there, axis=-1)
            layers = (film, ROUGHNESS, wet), (sheen, roughness, normals)
            for share, rough, turned in layers:
                if share:
                    sent = film_radiance(there, turned[lit], lamp, share, rough)
                    total[lit] += np.exp(-self.fog * way) * sent
        return total


def _mirrored_way(hit, normal, start, sheen, roughness):
    """Ways from which facets, chosen by GGX, mirror light to the camera, and what share of it.

    The share is F G (v·h) / (n·v n·h), with v to the camera and h the facet's normal.
    """
    width = roughness**4
    first, turn = (dr.llvm.Float(part) for part in _single(start))
    steep = dr.sqrt(width * first / (1 - first))
    across = 2 * dr.pi * turn
    local = mi.Vector3f(steep * dr.cos(across), steep * dr.sin(across), 1.0)
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


def _subpixels(camera, side, rng):
    """Rays (side², H·W, 3), one through each part of each pixel; nan where the camera has none."""
    row, column = np.mgrid[: camera.height, : camera.width].reshape(2, -1)
    part = np.mgrid[:side, :side].reshape(2, -1, 1)
    place = (part + rng.uniform(size=(2, side**2, row.size))) / side - 0.5
    rays = camera.unproject(np.stack([column + place[1], row + place[0]], axis=-1))
    rays[~(rays[..., 2] > 0)] = np.nan  # behind
    return rays


def trace(
    scene,
    camera,
    photometry,
    *,
    texture=0.0,
    vessels=0.0,
    stains=0.0,
    film=0.0,
    sheen=0.0,
    roughness=0.5,
    fog=0.0,
    noise=0.0,
    bounces=16,
    samples=64,
    seed=0,
    mesh_size=300,
):
    """Path-trace a scene; the paths meet its mesh, of `mesh_size` steps a side.

    Lights, response and mean albedos (Lambertian, below 1) are those of the photometry; with an unknown gain,
    one that puts the 99th percentile of the brightest channel, highlights apart, at 0.9 is chosen. `fog` and
    `noise` are as for `render`, `texture`, `vessels` and `stains` as for `tissue`; `film` is the
    share of the light that a wet film mirrors at normal incidence, 0.02 being water, `sheen` that of a rough
    wall, whose GGX width is the square of `roughness`, at least 0.2. `bounces` are the turns of a path
    after the first wall, 0 leaving the direct light alone; `samples` the paths a pixel, rounded up to whole
    grids of at most 4x4 places in it. `seed` is of texture, ripples, noise and paths. The picture has 8 bits.
    """
    mean = np.broadcast_to(np.asarray(photometry.brdf.albedo, dtype=np.float64), (3,))
    vignetting = photometry if photometry.lights else replace(photometry, k=0.0)
    lights = photometry.lights or (el.SpotLight(exponent=photometry.k),)

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
    layers[defined, 6] = tracer.mirrored(met, film, sheen, roughness, seed)
    layers[defined] *= vignetting.attenuation(rays[defined][:, 2])[:, None]
    average = layers.sum(axis=0) / np.maximum(defined.sum(axis=0), 1)[:, None]
    truth = truth_of(scene, camera)
    mask = truth["mask"]
    average = np.where(mask[..., None], average.reshape(*mask.shape, 7), 0.0)
    gain = expose(photometry, (average[..., :3] + average[..., 3:6])[mask])
    direct, indirect, mirrored = np.split(gain * average, [3, 6], axis=-1)
    light = direct + indirect + mirrored
    image = stored(light, truth["distance"], photometry.gamma, fog, noise, seed)
    used = replace(photometry, gain=gain)
    parts = {"direct": direct, "indirect": indirect, "mirrored": mirrored[..., 0]}
    return Traced(image=image, photometry=used, **truth, **parts)


def stored(light, distance, gamma, fog, noise, seed):
    """The picture (H, W, 3) of 8 bits that a sensor makes of linear light, with the fog's veil."""
    veil = VEIL * (1 - np.exp(-fog * np.nan_to_num(distance)))[..., None]
    seen = np.isfinite(distance)[..., None]
    return np.where(seen, develop(light + veil, gamma, noise, 8, seed), 0.0)

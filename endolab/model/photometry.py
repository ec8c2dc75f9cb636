"""The photometric model: how bright a surface looks to an endoscope (paper, Section III).

General model (eq. 6), a sum over the lights l:

    I = ( cos^k α · Σ_l b_l cosᵐψ_l / |x - x_l|² · f_r · cos θ_l · g )^(1/γ)

With the one light at the optical centre, looking forward (the default, eq. 9):

    I = ( cos^k α / d² · f_r(θ) · cos θ · g )^(1/γ)

and k is then the joint exponent of light spread and vignetting.
"""

from collections.abc import Sequence
from dataclasses import field, replace
from typing import Annotated, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from endolab.model.brdf import BRDF, Glossy, Lambertian, TabulatedBRDF
from endolab.model.lights import SpotLight
from endolab.numerics.arrays import FloatArray
from endolab.numerics.checked_types import OneOf, checked
from endolab.numerics.checks import unknown_name

CHANNELS = ("red", "green", "blue")
# Of stored values; ITU-R BT.601, as cv2 and JPEG use.
GREY_WEIGHTS = np.array([0.299, 0.587, 0.114])


@checked
class Photometry:
    """Light, surface and response of an endoscope.

    Parameters
    ----------
    k : float
        Exponent of cos α: the joint fall-off of light and vignetting; with `lights`, the
        vignetting's alone.
    gamma : float
        Response exponent γ, positive.
    gain : float or None
        g, positive; None when it is not known, and then distances have no unit.
    brdf : BRDF
        Of the surface.
    lights : tuple of SpotLight
        The real lights; empty means one at the optical centre. Their shadows are not modelled.

    Examples
    --------
    >>> import endolab as el
    >>> light = el.Photometry(k=0, gamma=1, gain=1)
    >>> near, far = (light.intensity([0, 0, d], [0, 0, -1]) for d in (50.0, 100.0))
    >>> round(float(near / far), 6)  # twice as far away, four times as dark
    4.0
    """

    k: Annotated[float, Field(ge=0, le=100)] = 2.5
    gamma: Annotated[float, Field(ge=0.1, le=10)] = 2.2
    gain: Annotated[float, Field(ge=1e-15, le=1e15)] | None = None
    brdf: Annotated[BRDF, OneOf(Lambertian, TabulatedBRDF, Glossy)] = field(
        default_factory=Lambertian
    )
    lights: tuple[SpotLight, ...] = ()

    def channel(self, name: str) -> Self:
        """Return the model of one channel, where the albedo differs between them.

        Grey is the weighted sum of the stored values (ITU-R BT.601).
        """
        if name not in (*CHANNELS, "grey"):
            raise unknown_name("channel", name, (*CHANNELS, "grey"))
        albedo = getattr(self.brdf, "albedo", None)
        if not isinstance(albedo, tuple):
            return self
        if name == "grey":
            # The gain and geometry are common, so the grey value has an albedo of its own.
            own = float(GREY_WEIGHTS @ np.asarray(albedo) ** (1 / self.gamma)) ** self.gamma
        else:
            own = albedo[CHANNELS.index(name)]
        return replace(self, brdf=Lambertian(own))

    def simplify(self) -> Self:
        """Replace the lights by one virtual light at the optical centre (Section III-C).

        Its strength is the sum of theirs along the axis and its exponent their mean, weighted by that
        strength: what they become far from the tip. ValueError if none of them shines forward.
        """
        if not self.lights:
            return self
        forward = [light for light in self.lights if light.direction[2] > 0]
        if not forward:
            raise ValueError(
                "no light shines forward, so no virtual light can stand for them"
            )
        strength = np.array(
            [light.weight * light.direction[2] ** light.exponent for light in forward]
        )
        exponents = np.array([light.exponent for light in forward])
        gain = None if self.gain is None else self.gain * float(strength.sum())
        return replace(
            self,
            k=self.k + float(strength @ exponents / strength.sum()),
            gain=gain,
            lights=(),
        )

    @property
    def lamps_aside(self) -> tuple[tuple[float, float, float], ...]:
        """Where the lights are, if none at the centre can stand for them without an error; else none."""
        alike = {replace(light, weight=1.0) for light in self.lights}
        if len(alike) == 1:
            (one,) = alike
            if one == SpotLight(exponent=one.exponent):
                return ()
        return tuple(light.position for light in self.lights)

    def with_lamps(self, places: Sequence[Sequence[float]]) -> Self:
        """Replace the lights by alike lamps at `places`, (x, y) or (x, y, z) in the camera frame, mm.

        They look forward, with 1 of the joint exponent, and k is the rest; together they are as strong.
        ValueError if one stands more than 50 mm aside.
        """
        known = self.simplify()
        spread = min(1.0, known.k)
        lights = []
        for x, y, *z in places:
            if not np.hypot(x, y) <= 50:
                raise ValueError(
                    f"lamps stand 50 mm at most aside of the lens, got {x:g}, {y:g}"
                )
            place = float(x), float(y), float(sum(z))
            lights.append(SpotLight(place, exponent=spread, weight=1 / len(places)))
        return replace(known, k=known.k - spread, lights=tuple(lights))

    def attenuation(self, cos_alpha: ArrayLike) -> FloatArray:
        """μ′ = cos^k α, α being the angle between ray and axis; 0 from 90° on."""
        cosine = np.asarray(cos_alpha, float)
        front = cosine > 0
        return np.where(
            np.isnan(cosine), np.nan, np.where(front, cosine, 1.0) ** self.k * front
        )

    def _known_gain(self) -> float:
        if self.gain is None:
            raise ValueError("the gain is unknown (None): set one to compute intensities")
        return self.gain

    # General model ---------------------------------------------------------------------

    def intensity(self, points: ArrayLike, normals: ArrayLike) -> FloatArray:
        """Stored value (...) of surface points (..., 3), mm, with unit normals towards the camera (eq. 6).

        0 and up; 1 is the sensor's maximum, where a real picture saturates.
        """
        points = np.asarray(points, float)
        normals = np.asarray(normals, float)
        distance = np.linalg.norm(points, axis=-1)
        to_camera = -points / distance[..., None]
        linear = np.zeros(distance.shape)
        for light in self.lights or (SpotLight(),):
            radiance, reach = light.illuminate(points)
            to_light = (np.asarray(light.position) - points) / reach[..., None]
            half = to_light + to_camera
            half /= np.linalg.norm(half, axis=-1, keepdims=True)
            cosine = np.vecdot(normals, to_light)
            f = self.brdf.value(cosine, np.vecdot(normals, half))
            linear += (cosine > 0) * radiance * f * cosine
        linear = linear * (self.attenuation(points[..., 2] / distance) * self._known_gain())
        return np.asarray(linear ** (1 / self.gamma))

    # Simplified model ------------------------------------------------------------------

    def brightness(
        self, log_distance: ArrayLike, slant: ArrayLike, attenuation: FloatArray
    ) -> FloatArray:
        """Stored value I under the light at the optical centre (eq. 9), where it attenuates so.

        v = log d, d in mm; the slant is P = tan²θ = ∇vᵀ G⁻¹ ∇v.
        """
        cosine = 1 / np.sqrt(1 + np.asarray(slant, float))
        f = self.brdf.value(cosine, cosine)
        falloff = np.exp(-2 * np.asarray(log_distance, float))
        linear = attenuation * self._known_gain() * falloff * f * cosine
        return np.asarray(linear ** (1 / self.gamma))

    def canonical(self, image: ArrayLike, cos_alpha: ArrayLike) -> FloatArray:
        """Canonical intensity I_c = I^γ / (μ′ f_r g), 1/mm², of stored values in [0, 1].

        It is cos θ / d² of a Lambertian wall; another BRDF is read at θ = 0. With an unknown gain, g = 1 is
        taken. nan where no light arrives (μ′ = 0).
        """
        gain = 1.0 if self.gain is None else self.gain
        reached = self.attenuation(cos_alpha) * self.brdf.value(1.0, 1.0) * gain
        linear = np.asarray(image, float) ** self.gamma
        return linear / np.where(reached > 0, reached, np.nan)

    def slant_table(self, size: int = 2048) -> tuple[FloatArray, FloatArray] | None:
        """Slant of the surface against canonical intensity, for a BRDF that isn't Lambertian.

        The simplified model says I_c d² = c(θ) = cos θ f_r(θ)/f_r(0); solvers need its inverse. None for a
        Lambertian surface, where P = c⁻² - 1; else log c, increasing, and log(1 + P) at `size` places.
        ValueError if c does not fall as θ grows: then one brightness has two slants.
        """
        if isinstance(self.brdf, Lambertian):
            return None
        theta = np.linspace(0.0, np.deg2rad(89.9), size)
        cosine = np.cos(theta)
        f = self.brdf.value(cosine, cosine)
        brightness = np.log(cosine * f / f[0])
        if not np.all(np.diff(brightness) < 0):
            worst = np.rad2deg(theta[np.argmax(np.diff(brightness) >= 0)])
            raise ValueError(
                f"the BRDF rises so fast at θ = {worst:.0f}° that one brightness has two slants; "
                "the surface cannot be found from it"
            )
        return brightness[::-1].copy(), (-2 * np.log(cosine))[::-1].copy()


# What is assumed of a light that nobody measured. k: a matt emitter at the tip sends out cos¹ α, and a
# fisheye of equal angles hardly darkens its rim. γ: over the darker half of the grey levels, .15 to .5, the
# video standard BT.709, V = 1.099 L^.45 - .099, is a power of 1/1.4 to 1/1.85, and endoscopes lift the dark.
# Distances of 570 points in a nose, whose scope nobody knows, are off by 7.1 % so, by 11.2 % with the 2.5 and
# 2.2 of the paper's endoscope; were all at one distance, by 9.0 %.
NOMINAL = Photometry(k=1.0, gamma=1.5)

"""Frames whose truth is known, rendered or path-traced, and how far a result is from it."""

from dataclasses import dataclass, replace

import numpy as np

import endolab as el
from endolab.metrics.depth_errors import resample_truth
from endolab.numerics.arrays import FloatArray
from tests.tools.problems import errors_of, relit


@dataclass(frozen=True)
class Case:
    """A frame, what is known of its endoscope, and its truth."""

    name: str
    frame: el.Frame
    calibration: el.Calibration
    distance: FloatArray
    normals: FloatArray | None = None
    align: str = "none"  # "scale" where the gain is unknown
    max_angle: float = 90.0  # degrees from the axis that are scored
    # (H, W, 3), what is not direct over direct light, if known
    indirect_ratio: FloatArray | None = None

    @property
    def scored(self):
        """Pixels that are scored."""
        cosine = np.nan_to_num(self.calibration.camera.field.cos_alpha, nan=-1.0)
        return cosine > np.cos(np.deg2rad(self.max_angle))

    def relit(self, **changes):
        """The same frame, of whose light something else is believed."""
        return replace(self, calibration=relit(self.calibration, **changes))

    def solve(self, **options):
        """Reconstruct the frame."""
        return el.reconstruct(self.frame, self.calibration, **options)

    def errors_of(self, result):
        """How far a result is from the truth."""
        scored = self.scored & result.problem.mask
        return errors_of(result, self, mask=scored, align=self.align)

    def percent(self, **options):
        """Mean error of the distance, solved with these options, %."""
        return self.errors_of(self.solve(**options)).mean_percent

    def resize(self, width):
        """The same frame on fewer pixels, of this width at most."""
        if self.frame.width <= width:
            return self
        height = round(self.frame.height * width / self.frame.width)
        normals = self.normals
        if normals is not None:
            with np.errstate(invalid="ignore"):
                normals = resample_truth(normals, (height, width))
        return replace(
            self,
            frame=self.frame.resize(width, height, self.calibration.photometry.gamma),
            calibration=self.calibration.resize(width, height),
            distance=resample_truth(self.distance, (height, width)),
            normals=normals,
        )


def drawn(scene, known="simple", width=None, light=None, **how):
    """A scene of the library, or any, rendered by a known endoscope, or any, in its own light or another."""
    if isinstance(known, str):
        known = el.load_calibration(known, width)
    light = light or known.photometry
    seen = el.render(el.SCENES.get(scene, scene), known.camera, light, **how)
    frame = el.Frame(seen.image, seen.mask, str(scene))
    known = replace(known, photometry=seen.photometry)
    return Case(str(scene), frame, known, seen.distance, seen.normals)


def traced(sample):
    """A path-traced frame, or that of a name, at true scale."""
    if isinstance(sample, str):
        sample = el.load_traced(sample)
    others = sample.indirect + sample.mirrored[..., None]
    ratio = others / np.maximum(sample.direct, 0.05 * others + 1e-9)
    return Case(
        sample.frame.name,
        sample.frame,
        sample.calibration,
        sample.distance,
        sample.normals,
        indirect_ratio=np.nan_to_num(ratio),
    )

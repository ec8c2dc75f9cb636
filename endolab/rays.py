"""The rays of a picture's pixels, and the metric by which they turn."""

from __future__ import annotations

from dataclasses import dataclass

from endolab.operators import BoolArray, FloatArray


@dataclass(frozen=True)
class RayField:
    """The rays of every pixel of a camera and the metric that they induce on the grid.

    With J = ∂r/∂u the metric is G = JᵀJ. A map of log-distance v with gradient ∇v is a surface
    with tan²θ = ∇vᵀ G⁻¹ ∇v, whatever the camera.

    Attributes
    ----------
    rays : (H, W, 3) float array
        Unit rays r in the camera frame; nan outside the field.
    jacobian : (H, W, 3, 2) float array
        ∂r/∂(column, row), per pixel.
    inverse_metric : (H, W, 3) float array
        The entries (uu, uv, vv) of G⁻¹, in pixels squared.
    valid : (H, W) bool array
        Pixels that see something: inside the monotone range of the model.
    """

    rays: FloatArray
    jacobian: FloatArray
    inverse_metric: FloatArray
    valid: BoolArray

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.rays.shape[0], self.rays.shape[1]

    @property
    def cos_alpha(self) -> FloatArray:
        """Cosine of the angle α between each ray and the axis: the rays' z."""
        return self.rays[..., 2]

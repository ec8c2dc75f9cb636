import numpy as np
import pytest

from endolab.calibration.geometric.pose import Pose

VECTORS = [[0.3, -0.5, 0.2, 1, 2, 30], [0, 0, 0, 0, 0, 50], [0, np.pi - 1e-3, 0, 5, -5, 20]]


@pytest.mark.parametrize("vector", VECTORS)
def test_a_vector_comes_back_and_makes_a_rotation(vector):
    assert Pose.from_vector(vector).vector == pytest.approx(vector, abs=1e-12)
    rotation = Pose.from_vector(vector).rotation
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1)


def test_a_step_turns_about_the_targets_origin(rng):
    pose = Pose.from_vector([0.3, -0.5, 0.2, 1, 2, 30])
    before = pose.vector
    step = 1e-6 * rng.normal(size=6)
    points = rng.normal(size=(5, 3)) * 20
    turned = pose.transform(points) - pose.translation
    expected = np.cross(step[:3], turned) + step[3:]
    assert pose.moved(step).transform(points) - pose.transform(points) == pytest.approx(expected, abs=1e-9)
    assert pose.moved([0.1, 0.2, 0.3, 0, 0, 0]).translation == pytest.approx(pose.translation)
    assert pose.vector == pytest.approx(before)  # it stays as it was

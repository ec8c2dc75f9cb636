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


def test_points_are_turned_then_shifted():
    pose = Pose.from_vector([0, 0, np.pi / 2, 1, 2, 30])
    assert pose.transform([[1.0, 0, 0], [0, 1.0, 0]]) == pytest.approx(np.array([[1, 3, 30], [0, 2, 30]]))
    assert pose.transform(np.zeros((2, 3, 3))).shape == (2, 3, 3)


@pytest.mark.parametrize("degrees", [0, 40])
def test_tilt_is_the_angle_of_the_turn(degrees):
    pose = Pose.from_vector([np.radians(degrees), 0, 0, 0, 0, 50])
    assert pose.tilt == pytest.approx(np.radians(degrees), abs=1e-7)
    assert pose.normal @ [0, 0, -1] == pytest.approx(np.cos(np.radians(degrees)))  # towards the camera
    assert Pose.from_vector([0, 0, 1.0, 0, 0, 50]).tilt == pytest.approx(0, abs=1e-7)


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

import numpy as np
import pytest

from kinematics import ArgumentError
from kinematics.footprint import skew
from kinematics.transforms import checked_covariance, checked_transform, inverse, transform_points
from kinematics.urdf import rotation_from_rpy


def some_transform(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    transform = np.eye(4)
    transform[:3, :3] = rotation_from_rpy(*rng.uniform(-1, 1, 3))
    transform[:3, 3] = rng.uniform(-1, 1, 3)
    return transform


def test_a_transform_and_its_inverse_give_identity() -> None:
    """Both products of a transform and its inverse are the identity."""
    transform = some_transform(1)
    np.testing.assert_allclose(inverse(transform) @ transform, np.eye(4), atol=1e-15)
    np.testing.assert_allclose(transform @ inverse(transform), np.eye(4), atol=1e-15)


def test_points_of_any_shape_are_taken_through() -> None:
    """Points (..., 3) keep their shape, and each equals the homogeneous product."""
    transform, points = some_transform(2), np.random.default_rng(0).normal(size=(4, 5, 3))
    moved = transform_points(transform, points)
    assert moved.shape == points.shape
    np.testing.assert_allclose(moved[2, 3], (transform @ [*points[2, 3], 1.0])[:3], atol=1e-15)


def test_skew_is_the_cross_product() -> None:
    """skew(a) b is a x b."""
    a, b = np.random.default_rng(4).normal(size=(2, 3))
    np.testing.assert_allclose(skew(a) @ b, np.cross(a, b), atol=1e-15)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t[:3], r"mount has shape \(3, 4\); a finite \(4, 4\) matrix"),
        (lambda t: t * np.nan, "has a value that is not finite; a finite"),
        (
            lambda t: np.diag([1.0, 1.0, -1.0, 1.0]) @ t,
            "mount contains no rotation: R R' - I is up to .*, det R is -1",
        ),
        (
            lambda t: t @ np.diag([1.1, 1.0, 1.0, 1.0]),
            "mount contains no rotation: R R' - I is up to 0.11, det R is 1.1",
        ),
        (lambda t: t + np.diag([0.0, 0.0, 0.0, 1.0]), "mount ends in the row"),
    ],
)
def test_what_is_no_transform_is_refused(change, message: str) -> None:  # noqa: ANN001
    """Wrong shape, NaN, reflections, scales and a wrong last row are rejected by name."""
    with pytest.raises(ArgumentError, match=message):
        checked_transform(change(some_transform(3)), "mount")


@pytest.mark.parametrize(
    ("covariance", "message"),
    [
        (np.eye(3), r"noise has shape \(3, 3\); a finite \(6, 6\)"),
        (np.eye(6) * np.nan, "has a value that is not finite; a finite"),
        (np.eye(6) + np.eye(6, k=1), "noise is not symmetric"),
        (-np.eye(6), "noise has a negative eigenvalue"),
    ],
)
def test_what_is_no_covariance_is_refused(covariance: np.ndarray, message: str) -> None:
    """Wrong shape, NaN, asymmetry and negative eigenvalues are rejected by name."""
    with pytest.raises(ArgumentError, match=message):
        checked_covariance(covariance, "noise")

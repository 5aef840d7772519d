"""The mirror model: reflections, conventions, frames."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from guara_perception.calibration.mirror_model import PARAMETERS, MirrorModel, nominal_mirror, perturbed_mirror
from tests.thorough import examples

POINT = np.array([0.6, 0.0, 0.47])
parameters = st.lists(st.floats(-2, 2), min_size=9, max_size=9).map(
    lambda sigmas: np.array(sigmas) * np.array(list(PARAMETERS.values()))
)
angles = st.floats(-0.3, 0.5)
bounded = settings(max_examples=examples(40), derandomize=True, deadline=None)


def rotation(vector: np.ndarray) -> np.ndarray:
    """Rodrigues' formula, written out."""
    angle = np.linalg.norm(vector)
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def test_nominal_laser_plane_falls_straight_down_and_turns_forward() -> None:
    """At angle zero the laser plane is x = 0.6; at theta it meets the floor 0.47 tan(2 theta) further ahead."""
    planes = nominal_mirror(POINT).planes([0.0, 0.1, -0.05])
    for plane, angle in zip(planes, (0.0, 0.1, -0.05), strict=True):
        x_on_floor = -plane[3] / plane[0]
        np.testing.assert_allclose(x_on_floor, 0.6 + 0.47 * np.tan(2 * angle), atol=1e-12)


@bounded
@given(parameters, angles)
def test_plane_of_a_stripe_is_the_mirror_image_of_the_incoming_plane(p: np.ndarray, angle: float) -> None:
    """Points of the plane that meets the mirror, reflected in it by hand, lie on the plane of the stripe."""
    model = perturbed_mirror(nominal_mirror(POINT), p)
    plane = model.planes([angle])[0]
    np.testing.assert_allclose(np.linalg.norm(plane[:3]), 1, atol=1e-12)
    normal = rotation(model.gain * angle * model.axis) @ model.normal_at_zero
    n0, d0 = model.laser_plane[:3], model.laser_plane[3]
    basis = np.linalg.svd(n0[None])[2][1:]
    for a, b in ((0, 0), (1, 0), (0, 1), (-2, 3)):
        point = -d0 * n0 + a * basis[0] + b * basis[1]
        image = point - 2 * (normal @ (point - model.point)) * normal
        np.testing.assert_allclose(plane[:3] @ image + plane[3], 0, atol=1e-9)


@bounded
@given(parameters, angles)
def test_the_laser_plane_turns_by_twice_the_mirror(p: np.ndarray, angle: float) -> None:
    """With the mirror's face parallel to its axis, each plane is that of angle zero turned by twice the angle."""
    p = p.copy()
    p[list(PARAMETERS).index("mirror_tilt")] = 0
    model = perturbed_mirror(nominal_mirror(POINT), p)
    first, turned = model.planes([0.0, angle])
    expected = rotation(2 * model.gain * angle * model.axis) @ first[:3]
    np.testing.assert_allclose(turned[:3], expected, atol=1e-12)
    # Each laser plane passes the axis at the same distance.
    np.testing.assert_allclose(turned[:3] @ model.point + turned[3], first[:3] @ model.point + first[3], atol=1e-12)


@bounded
@given(parameters, st.lists(st.floats(-2, 2), min_size=6, max_size=6))
def test_change_of_frame_commutes(p: np.ndarray, motion: list[float]) -> None:
    """Planes of the moved model are the moved planes of the model: they hold the moved points."""
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = rotation(np.array(motion[:3])), motion[3:]
    model = perturbed_mirror(nominal_mirror(POINT), p)
    for old, new in zip(model.planes([0.0, 0.2]), model.in_frame(transform).planes([0.0, 0.2]), strict=True):
        for point in -old[3] * old[:3] + np.linalg.svd(old[None, :3])[2][1:]:
            moved = transform[:3, :3] @ point + transform[:3, 3]
            np.testing.assert_allclose(new[:3] @ moved + new[3], 0, atol=1e-9)


def test_record_holds_the_model() -> None:
    """The JSON values build the same model again."""
    model = perturbed_mirror(nominal_mirror(POINT), 0.5 * np.array(list(PARAMETERS.values())))
    stored = model.to_dict()
    again = MirrorModel(
        **{name: np.array(value) for name, value in stored.items() if name != "gain"}, gain=stored["gain"]
    )
    np.testing.assert_array_equal(again.planes([0.1]), model.planes([0.1]))

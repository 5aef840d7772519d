"""Points on the robot, and lines of sight that it blocks."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinematics import ArgumentError, RobotModel, SelfFilter, UnknownName
from kinematics.self_filter import place_shape
from kinematics.urdf import Shape, rotation_from_rpy
from tests.thorough import examples

KINDS = {"box": (0.2, 0.1, 0.3), "cylinder": (0.08, 0.3), "sphere": (0.12,)}


def random_shape(kind: str, seed: int):  # noqa: ANN201
    rng = np.random.default_rng(seed)
    transform = np.eye(4)
    transform[:3, :3] = rotation_from_rpy(*rng.uniform(-3, 3, 3))
    transform[:3, 3] = rng.uniform(-0.3, 0.3, 3)
    return place_shape(Shape(kind, KINDS[kind], np.eye(4)), "link", transform, 0.01)


@settings(max_examples=examples(60), derandomize=True, deadline=None)
@given(kind=st.sampled_from(list(KINDS)), seed=st.integers(0, 1000))
def test_a_segment_is_blocked_where_it_holds_a_point_inside(kind: str, seed: int) -> None:
    """A segment is blocked exactly if one of 400 points on it is in the shape, except for grazing segments."""
    shape, rng = random_shape(kind, seed), np.random.default_rng(seed + 1)
    origins, ends = rng.uniform(-0.6, 0.6, (2, 60, 3))
    fractions = np.linspace(0.0, 1.0, 400)
    samples = origins[:, None] + fractions[:, None] * (ends - origins)[:, None]
    met = shape.contains(samples.reshape(-1, 3)).reshape(60, -1).any(axis=1)
    blocked = shape.blocks(origins, ends - origins)
    assert np.all(blocked[met])
    # A blocked segment without a sample inside only grazes: a shape 2 mm larger contains one of its samples.
    larger = place_shape(Shape(kind, KINDS[kind], np.eye(4)), "link", _transform(shape), 0.012)
    grazed = larger.contains(samples.reshape(-1, 3)).reshape(60, -1).any(axis=1)
    assert np.all(grazed[blocked])


def _transform(shape) -> np.ndarray:  # noqa: ANN001
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = shape.rotation, shape.centre
    return transform


@pytest.mark.parametrize("kind", list(KINDS))
def test_rays_along_the_axes_are_exact(kind: str) -> None:
    """Segments along an axis are blocked if they pass through a shape, not if they end before it or pass beside it."""
    shape = place_shape(Shape(kind, KINDS[kind], np.eye(4)), "link", np.eye(4), 0.0)
    for axis in range(3):
        start = np.zeros(3)
        start[axis] = -1.0
        segment = np.zeros((1, 3))
        segment[0, axis] = 2.0
        assert shape.blocks(start[None], segment)[0]
        assert not shape.blocks(start[None], segment / 10.0)[0]
        beside = start.copy()
        beside[(axis + 1) % 3] = 0.5
        assert not shape.blocks(beside[None], segment)[0]


def test_reach_bounds_every_shape() -> None:
    """Every point inside a shape is within its bounding sphere, margin included."""
    for kind in KINDS:
        for seed in range(20):
            shape = random_shape(kind, seed)
            points = shape.centre + np.random.default_rng(seed).uniform(-0.3, 0.3, (3000, 3))
            inside = points[shape.contains(points)]
            assert len(inside) and np.linalg.norm(inside - shape.centre, axis=1).max() <= shape.reach


def test_points_on_every_link_are_found(robot: RobotModel) -> None:
    """In a random posture, the centre of every collision shape is on the robot, and points 2 m above are not."""
    rng = np.random.default_rng(2)
    state = robot.state(rng.uniform(robot.tree.lower_limits, robot.tree.upper_limits))
    self_filter = SelfFilter(state)
    centres = np.array(
        [
            (state.transform_to_base(name) @ shape.transform_shape_to_link)[:3, 3]
            for name, link in robot.tree.links.items()
            for shape in link.shapes
        ]
    )
    assert len(centres) == len(self_filter.shapes)
    assert self_filter.contains(centres).all()
    assert not self_filter.contains(centres + (0.0, 0.0, 2.0)).any()


def test_coarse_tests_change_nothing(robot: RobotModel) -> None:
    """`contains` and `blocks` agree with tests of every shape for every point, near and far."""
    state = robot.state(robot.posture("scan"))
    self_filter = SelfFilter(state)
    rng = np.random.default_rng(3)
    points = rng.uniform((-0.6, -0.5, -0.5), (1.0, 0.5, 0.2), (4000, 3))
    inside = np.any([shape.contains(points) for shape in self_filter.shapes], axis=0)
    np.testing.assert_array_equal(self_filter.contains(points), inside)
    camera = state.position_in_base(robot.config.camera_frame)
    blocked = np.any([shape.blocks(camera[None], points - camera) for shape in self_filter.shapes], axis=0)
    np.testing.assert_array_equal(self_filter.blocks(camera, points), blocked)
    np.testing.assert_array_equal(self_filter.blocks(np.tile(camera, (4000, 1)), points), blocked)
    assert inside.any() and blocked.any() and not blocked.all()


def test_another_frame_changes_nothing(robot: RobotModel) -> None:
    """Points in a rotated and displaced frame give the same result as in the body's frame."""
    state = robot.state(robot.posture("scan"))
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = rotation_from_rpy(0.1, -0.05, 0.02), (0.02, -0.01, 0.4)
    points = np.random.default_rng(5).uniform((-0.6, -0.5, -0.5), (1.0, 0.5, 0.2), (4000, 3))
    moved = points @ transform[:3, :3].T + transform[:3, 3]
    camera = state.position_in_base(robot.config.camera_frame)
    in_base, in_frame = SelfFilter(state), SelfFilter(state, transform_base_to_frame=transform)
    np.testing.assert_array_equal(in_base.contains(points), in_frame.contains(moved))
    blocked = in_frame.blocks(transform[:3, :3] @ camera + transform[:3, 3], moved)
    np.testing.assert_array_equal(in_base.blocks(camera, points), blocked)
    # Points of a stripe ahead of the robot are on no shape; those of a stripe through its body are.
    strip = np.column_stack((np.full(50, 0.8), np.linspace(-0.3, 0.3, 50), np.full(50, -0.3)))
    assert not in_base.contains(strip).any() and in_base.contains(strip - (0.8, 0.0, -0.3)).any()


def test_what_lies_on_the_robot_is_blocked(robot: RobotModel) -> None:
    """A point on the robot is never visible: its segment ends inside a shape."""
    state = robot.state(robot.posture("scan"))
    self_filter = SelfFilter(state)
    points = np.random.default_rng(4).uniform((-0.4, -0.3, -0.4), (0.4, 0.3, 0.1), (5000, 3))
    camera = state.position_in_base(robot.config.camera_frame)
    assert np.all(self_filter.blocks(camera, points)[self_filter.contains(points)])


def test_a_leg_before_the_camera_shadows_the_ground_behind(guara: RobotModel) -> None:
    """In the scan posture the area is in view; a front leg swung forward hides ground on its side."""
    joints = guara.posture("scan")
    area = guara.config.root.table("grid").table("footprint").values
    x, y = np.meshgrid(np.linspace(*area["x"], 40), np.linspace(*area["y"], 40))  # type: ignore[index]
    ground = np.column_stack([x.ravel(), y.ravel(), np.full(x.size, -0.36)])
    state = guara.state(joints)
    camera, laser = guara.transform_camera_to_base[:3, 3], guara.transform_laser_to_base[:3, 3]
    for sensor_origin in (camera, laser):
        assert SelfFilter(state).blocks(sensor_origin, ground).mean() < 0.01
    joints.update(zip(guara.tree.leg("lf").joints, (0.0, -1.2, 0.6, 0.0), strict=True))
    hidden = SelfFilter(guara.state(joints)).blocks(camera, ground)
    assert hidden.any() and np.all(ground[hidden][:, 1] > 0.0)


def test_margin_grows_the_shapes(guara: RobotModel) -> None:
    """A point 5 mm off the body is on the robot with the usual margin of 10 mm, but not without a margin."""
    state = guara.state(guara.posture("scan"))
    above = np.array([[0.0, 0.0, 0.030]])
    assert SelfFilter(state).contains(above).all()
    assert not SelfFilter(state, margin=0.0).contains(above).any()
    assert not SelfFilter(state, ignore=("base_link",)).contains(above).any()


def test_nan_points_are_not_on_the_robot(robot: RobotModel) -> None:
    """NaN points are neither on the robot nor blocked; empty arrays give empty masks."""
    self_filter = SelfFilter(robot.state(robot.posture("scan")))
    nothing = np.full((2, 3), np.nan)
    camera = robot.transform_camera_to_base[:3, 3]
    assert not self_filter.contains(nothing).any() and not self_filter.blocks(camera, nothing).any()
    assert self_filter.contains(np.zeros((0, 3))).shape == (0,)
    assert self_filter.blocks(camera, np.zeros((0, 3))).shape == (0,)


def test_bad_arguments_are_refused(guara: RobotModel) -> None:
    """Wrong shapes, a negative margin, unknown links and a sensor origin inside the robot are rejected."""
    state = guara.state(guara.posture("scan"))
    self_filter = SelfFilter(state)
    with pytest.raises(ArgumentError, match=r"points_in_base has shape \(3,\); \(n, 3\) is needed"):
        self_filter.contains([0.0, 0.0, 0.0])
    with pytest.raises(ArgumentError, match=r"origins_in_base has shape \(2, 3\); \(3,\) or \(5, 3\)"):
        self_filter.blocks(np.zeros((2, 3)), np.zeros((5, 3)))
    with pytest.raises(ArgumentError, match="an origin lies inside the shape of link 'base_link'.*ignore"):
        self_filter.blocks([0.0, 0.0, 0.0], np.ones((5, 3)))
    with pytest.raises(ArgumentError, match="margin is -1.0; a length of 0 m or more"):
        SelfFilter(state, margin=-1.0)
    with pytest.raises(UnknownName, match="unknown link to ignore 'mast'"):
        SelfFilter(state, ignore=("mast",))

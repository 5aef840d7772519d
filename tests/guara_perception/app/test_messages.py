"""Grids as messages: nothing is lost, and both sides refuse a grid that violates the safety invariant."""

import dataclasses
import json

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.messages import message_to_terrain, terrain_to_message
from guara_perception.terrain.layers.record import ScanRecord
from transport import Health, TerrainMessage, decode_terrain, encode_terrain


@pytest.fixture(scope="module")
def message(paper_terrain: gp.TerrainGrid) -> TerrainMessage:
    """Message of the paper scan's grid."""
    return terrain_to_message(
        paper_terrain, robot="guara", sequence=3, scan_start=5_000_000_000, scan_end=9_000_000_000
    )


def test_grid_comes_back_bit_for_bit(paper_terrain: gp.TerrainGrid, message: TerrainMessage):
    """Grid to message to bytes and back: layers, geometry, times and metadata are unchanged."""
    back = message_to_terrain(decode_terrain(encode_terrain(message)))
    for name, layer in paper_terrain.layers.items():
        assert back.layer(name).tobytes() == layer.tobytes() and back.layer(name).dtype == layer.dtype
    for name in ("origin", "resolution", "shape", "stamp", "step", "extent", "frame"):
        assert getattr(back, name) == getattr(paper_terrain, name)
    added = {"sequence": 3, "scan_start": 5_000_000_000, "scan_end": 9_000_000_000, "instance": "guara"}
    assert dict(back.metadata) == {**json.loads(json.dumps(dict(paper_terrain.metadata))), **added}


def test_message_says_what_the_report_says(paper_terrain: gp.TerrainGrid, message: TerrainMessage):
    """Fields for other tools are also present outside the metadata."""
    report = paper_terrain.metadata
    assert (message.mode, message.method) == ("coarse", "precise")
    assert message.attitude_source == "imu" and message.health is Health.OK
    assert message.calibration_hash == report["calibration_hash"]
    assert (message.valid_for, message.valid_pauses) == (420.0, 0)
    assert dict(message.stance.joint_positions) == report["stance"]["joint_positions"]
    assert message.stance.support_feet == ("lf", "rf", "lh", "rh")
    assert message.coverage == report["coverage"] and dict(message.point_counts) == report["points"]
    assert message.stage_ms["extract"] == pytest.approx(1e3 * report["seconds"]["extract"])


def test_transforms_carry_their_frames_and_covariance(paper_terrain: gp.TerrainGrid, message: TerrainMessage):
    """Base to footprint with covariance, and camera to base; no odometry without a map."""
    report = paper_terrain.metadata
    pose, camera = message.transforms
    assert (pose.source_frame, pose.destination_frame) == ("base_link", "base_footprint")
    np.testing.assert_array_equal(pose.matrix, report["transform_base_to_footprint"])
    np.testing.assert_array_equal(pose.covariance, report["pose_covariance"])
    assert (camera.source_frame, camera.destination_frame) == ("camera_optical_frame", "base_link")
    np.testing.assert_array_equal(camera.matrix, report["transform_camera_to_base"])
    assert camera.covariance is None


def test_obstacles_come_along(paper_terrain: gp.TerrainGrid, message: TerrainMessage):
    """The five boxes of the scan are obstacles of the decoded message, with the values of the grid."""
    held = decode_terrain(encode_terrain(message)).obstacles
    expected = paper_terrain.obstacles()
    assert len(held) == len(expected) >= 4
    for sent, known in zip(held, expected, strict=True):
        np.testing.assert_array_equal(sent.outline, known.outline)
        assert sent.height == known.height and sent.sigma == known.sigma
        assert sent.position == pytest.approx(tuple(known.position)) and sent.hazard == int(known.hazard)


def test_times_default_to_the_grids_stamp(paper_terrain: gp.TerrainGrid):
    """Without times of the first and last frame, both are the stamp of the grid."""
    message = terrain_to_message(paper_terrain, robot="guara", sequence=1)
    assert message.scan_start == message.scan_end == message.stamp == paper_terrain.stamp


def test_degraded_scan_is_reported(paper_terrain: gp.TerrainGrid):
    """Health and reasons are included; an unknown level counts as a warning, never as ok."""
    for level, health in (("degraded", Health.WARN), ("failed", Health.ERROR), ("odd", Health.WARN)):
        metadata = {**paper_terrain.metadata, "health": {"level": level, "reasons": ["stripe 4: blank"]}}
        message = terrain_to_message(
            dataclasses.replace(paper_terrain, record=ScanRecord.from_json(metadata)), robot="guara", sequence=1
        )
        assert message.health is health and message.health_reasons == ("stripe 4: blank",)


def test_grid_without_a_scan_can_be_sent():
    """Terrain assessed from heights has no stance and no report, and can be sent."""
    terrain = gp.assess_terrain(np.zeros((40, 50), np.float32), 0.01)
    back = message_to_terrain(terrain_to_message(terrain, robot="guara", sequence=1))
    np.testing.assert_array_equal(back.hazard, terrain.hazard)


@pytest.mark.parametrize(
    ("layer", "value", "reported"),
    [
        ("hazard", 0x1000, "a cell is traversable with a hazard"),
        ("hazard", 0x0001, "elevation is NaN without an unknown flag, or known with one"),
        ("elevation", np.nan, "elevation is NaN without an unknown flag"),
        ("elevation", np.inf, "elevation is infinite"),
        ("traversability", 0.0, "a cell is traversable with a hazard, or not traversable without one"),
        ("traversability", 1.5, "traversability is outside 0 ... 1"),
        ("variance", -1.0, "variance of a known cell is NaN, infinite or negative"),
    ],
)
def test_broken_grid_is_refused_on_arrival(message: TerrainMessage, layer: str, value: float, reported: str):
    """A safe cell changed to contradict itself is refused, with sender, step, rule and cell."""
    iy, ix = np.argwhere(message.layers["hazard"] == 0)[0]
    layers = {name: array.copy() for name, array in message.layers.items()}
    layers[layer][iy, ix] = value
    with pytest.raises(gp.UnsafeGrid) as caught:
        message_to_terrain(dataclasses.replace(message, layers=layers))
    text = str(caught.value)
    assert text.startswith("grid received from 'guara', step 0: ") and reported in text
    assert f"the first at iy={iy}, ix={ix}" in text

"""Tests of the Terrain message's own checks."""

import dataclasses
import math

import numpy as np
import pytest

import transport
from transport import MessageError, VersionError
from transport.messages.codec import encode
from transport.messages.terrain_message import (
    crop_terrain,
    decode_terrain,
    encode_compact,
    encode_terrain,
    make_terrain,
)
from transport.messages.typestore import message_class


@pytest.mark.parametrize(
    ("changes", "expected_text"),
    [
        ({"extent": "all"}, "extent is 'all'; allowed: 'footprint', 'map'"),
        ({"mode": "fast"}, "mode is 'fast'; allowed: 'coarse', 'standard'"),
        ({"attitude_source": "guess"}, "attitude_source is 'guess'"),
        ({"robot": "a/b"}, "cannot be part of a key"),
        ({"sequence": 2**64}, "sequence of Terrain is 18446744073709551616; allowed: 0 to 2\\^64 - 1"),
        ({"valid_pauses": 2**32}, "valid_pauses"),
        ({"scan_end": 0}, "is before scan_start"),
        ({"valid_for": math.nan}, "valid_for of Terrain is nan"),
        ({"valid_for": -1.0}, "valid_for of Terrain is -1"),
        ({"resolution": 0.0}, "resolution of Terrain is 0; allowed: 0.0001 to 10 m"),
        ({"resolution": math.inf}, "resolution is inf; a finite number"),
        ({"origin": (0.0,)}, "origin has 1 numbers"),
        ({"origin": (0.0, math.nan)}, "origin y is nan"),
        ({"coverage": 1.5}, "coverage of Terrain is 1.5"),
        ({"health": 9}, "health of Terrain is 9"),
        ({"health_reasons": "text"}, "a list of strings is needed"),
        ({"point_counts": {"in": -1}}, "point_counts are {'in': -1}; allowed: 0 to 2\\^64 - 1"),
        ({"point_counts": {"in": 2**64}}, "allowed: 0 to 2\\^64 - 1"),
        ({"stage_ms": {"x": math.inf}}, "time of stage 'x'"),
        ({"metadata": "{"}, "metadata is not JSON"),
        ({"metadata": "[]"}, "not an object"),
    ],
)
def test_a_wrong_field_is_refused_by_name(peer, changes: dict, expected_text: str) -> None:
    """Every field that is not allowed: named, with what was given and what is allowed."""
    with pytest.raises(transport.TransportError, match=expected_text):
        peer.make_terrain(shape=(2, 3), **changes)


def test_a_layer_of_another_dtype_shape_or_number_is_refused(peer) -> None:
    """Layers must all be there, of the exact dtype and of one shape."""
    good = dict(peer.make_terrain(shape=(2, 3)).layers)
    bad = {
        "layer 'slope' is float64": good | {"slope": np.zeros((2, 3))},
        "layer 'slope' is list": good | {"slope": [[0.0] * 3] * 2},
        "layer 'age' has shape": good | {"age": np.zeros((3, 2), np.uint8)},
        "missing layers: slope": {n: a for n, a in good.items() if n != "slope"},
        "1 to 4000000 cells": good | {"elevation": np.broadcast_to(np.float32(0.0), (2001, 2000))},
        "layer 'elevation' of a single number; allowed": good | {"elevation": np.float32(0.0)},
        "layer 'elevation' of 0 x 3 cells": good | {"elevation": np.zeros((0, 3), np.float32)},
    }
    for expected_text, layers in bad.items():
        with pytest.raises(MessageError, match=expected_text):
            peer.make_terrain(layers=layers)


@pytest.mark.parametrize("layer", ["elevation", "traversability"])
def test_one_that_is_withdrawn_and_knows_a_cell_is_refused(peer, layer: str) -> None:
    """What takes a grid back holds nothing that a foot could go to; on arrival too."""
    layers = dict(peer.make_terrain(shape=(2, 3)).layers)
    layers["elevation"] = np.full((2, 3), np.nan, np.float32)
    layers["traversability"] = np.zeros((2, 3), np.float32)
    withdrawn = '{"withdrawn": true}'
    assert peer.make_terrain(layers=layers, metadata=withdrawn).withdrawn
    layers[layer] = np.array([[0, 0, 0], [0, 0.5, 0]], np.float32)
    message = make_terrain(peer.make_terrain(layers=layers))
    message.metadata = withdrawn
    with pytest.raises(MessageError, match="grid is withdrawn, but has known cells; allowed: none"):
        transport.decode_terrain(encode(message))


def test_layers_cannot_be_changed_from_outside(peer) -> None:
    """The message keeps its own copy of arrays that could still be written to, and is read-only itself."""
    good = {name: array.copy() for name, array in peer.make_terrain(shape=(2, 3)).layers.items()}
    terrain = peer.make_terrain(layers=good)
    before = terrain.layers["slope"].copy()
    good["slope"][:] = 9.0
    np.testing.assert_array_equal(terrain.layers["slope"], before)
    with pytest.raises(ValueError, match="read-only"):
        terrain.layers["slope"][0, 0] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        terrain.step = 2


def test_a_transposed_array_keeps_its_meaning(peer) -> None:
    """An array that lies transposed in memory is sent by value, not by memory."""
    layers = dict(peer.make_terrain(shape=(2, 3)).layers)
    layers["slope"] = np.arange(6, dtype=np.float32).reshape(3, 2).T
    back = transport.decode_terrain(transport.encode_terrain(peer.make_terrain(layers=layers)))
    np.testing.assert_array_equal(back.layers["slope"], [[0, 2, 4], [1, 3, 5]])


def test_unknown_layers_are_ignored(peer) -> None:
    """A layer that a later minor version adds does no harm."""
    terrain = peer.make_terrain(shape=(2, 3))
    message = make_terrain(terrain)
    layer = message_class("guara_msgs/msg/TerrainLayer")
    empty = (np.zeros(0, np.uint16), np.zeros(0, np.uint8))
    message.layers.append(layer("temperature", "K", 1, np.zeros(6, np.float32), *empty))
    message.version_minor = 7
    back = transport.decode_terrain(encode(message))
    assert list(back.layers) == list(transport.LAYERS) and back.version == (1, 7)


def test_a_ceiling_is_sent_where_there_is_one_and_is_never_lowered(peer) -> None:
    """A scan has none and sends none; in the compact form a ceiling is rounded up."""
    good = peer.make_terrain(shape=(2, 3))
    none = dataclasses.replace(good, layers={**good.layers, "ceiling": np.full((2, 3), np.nan, np.float32)})
    assert "ceiling" not in [layer.name for layer in make_terrain(none).layers]
    assert np.isnan(decode_terrain(encode_terrain(none)).layers["ceiling"]).all()
    given = np.array([[np.nan, 0.0101, 0.02], [np.nan, -0.0101, 0.0]], np.float32)
    back = decode_terrain(encode_compact(dataclasses.replace(good, layers={**good.layers, "ceiling": given})))
    rounded_by = (back.layers["ceiling"] - given)[:, 1:]
    assert np.isnan(back.layers["ceiling"][:, 0]).all() and (rounded_by >= 0).all() and rounded_by.max() < 2.0**-13


def test_a_message_of_before_has_the_total_alone(peer) -> None:
    """Without `variance_local` the whole variance is taken for it: nothing is surer than the node said."""
    good = peer.make_terrain(shape=(2, 3))
    layers = {name: array for name, array in good.layers.items() if name != "variance_local"}
    back = dataclasses.replace(good, layers=layers)
    np.testing.assert_array_equal(back.layers["variance_local"], good.layers["variance"])


def test_another_major_version_is_refused_in_words(peer) -> None:
    """The message says both versions and what to do."""
    message = make_terrain(peer.make_terrain(shape=(2, 3)))
    message.version_major = 2
    with pytest.raises(VersionError, match=r"version 2\.0; this package supports version 1: install"):
        transport.decode_terrain(encode(message))


def _damage(message, what: str) -> None:
    layer = message.layers[0]
    if what == "short":
        layer.float32_values = layer.float32_values[:-1]
    elif what == "twice":
        message.layers.append(layer)
    elif what == "type":
        layer.type = 2
    elif what == "unit":
        layer.unit = "mm"
    elif what == "other array":
        layer.uint8_values = np.zeros(3, np.uint8)
    elif what == "huge":
        message.nx = message.ny = 60_000
    elif what == "empty":
        message.nx = 0
    elif what == "missing":
        message.layers = [layer for layer in message.layers if layer.name != "looks"]
    elif what == "names":
        message.stage_names = message.stage_names[:-1]
    elif what == "joints":
        message.stance.joint_names = ["a", "a"]
    elif what == "joint count":
        message.stance.joint_names = ["a"]
    elif what == "nan":
        message.stance.joint_positions = np.array([0.0, np.nan])
    elif what == "quaternion":
        message.transforms[0].transform.rotation.w = 5.0
    elif what == "covariance":
        message.transforms[0].covariance = np.zeros(35)
    elif what == "time":
        message.scan_end.nanosec = 2 * 10**9
    elif what == "health":
        message.health = 77


@pytest.mark.parametrize(
    ("what", "expected_text"),
    [
        ("short", "layer 'elevation' has .* values"),
        ("twice", "occurs twice"),
        ("type", "type 2 and unit 'm'; allowed: type 1"),
        ("unit", "unit 'mm'; allowed:"),
        ("other array", "none in the others"),
        ("huge", "grid of 60000 x 60000 cells"),
        ("empty", "nx of Terrain is 0; allowed: 1 to"),
        ("missing", "missing layers: looks"),
        ("names", "stage times: 1 distinct names, 2 values"),
        ("joints", "names a joint twice"),
        ("joint count", "1 joint names but 2 positions"),
        ("nan", "entry .* of joint_positions of Stance is nan"),
        ("quaternion", "w of Quaternion is 5; allowed: -1 to 1"),
        ("covariance", "35 numbers; allowed: 0 or 36"),
        ("time", "nanosec of Time is 2000000000"),
        ("health", "77"),
    ],
)
def test_a_message_that_contradicts_itself_is_refused(peer, what: str, expected_text: str) -> None:
    """What CDR cannot check is checked after decoding: lengths, types, names, numbers."""
    message = make_terrain(peer.make_terrain(shape=(2, 3)))
    _damage(message, what)
    with pytest.raises(MessageError, match=expected_text):
        transport.decode_terrain(encode(message))


@pytest.mark.parametrize(
    ("matrix", "expected_text"),
    [
        (np.eye(3), r"shape \(3, 3\); allowed: \(4, 4\)"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), "does not contain a rotation"),
        (np.diag([2.0, 1.0, 1.0, 1.0]), "does not contain a rotation"),
        (np.diag([1.0, 1.0, 1.0, 2.0]), "last row"),
        (np.full((4, 4), np.nan), "NaN or infinity"),
        ("text", "not an array of numbers"),
    ],
)
def test_a_matrix_that_is_no_transform_is_refused(matrix: object, expected_text: str) -> None:
    """Mirrored, scaled or damaged matrices do not pass."""
    with pytest.raises(MessageError, match=expected_text):
        transport.TransformMessage(source_frame="a", destination_frame="b", matrix=matrix)


def test_other_parts_refuse_bad_numbers(peer) -> None:
    """Ground, obstacle and pause name the field that is wrong."""
    line = [[0, 0], [1, 0]]
    with pytest.raises(MessageError, match="2 corners; at least 3"):
        transport.GroundPatch(outline=line, height=0, sigma=0)
    with pytest.raises(MessageError, match="sigma of GroundPatch is -1"):
        transport.GroundPatch(outline=[*line, [1, 1]], height=0, sigma=-1)
    with pytest.raises(MessageError, match="hazard of an obstacle is 65536"):
        transport.ObstacleMessage(outline=line, height=0, position=(0, 0, 0), sigma=0, hazard=65536)
    for huge in (10**400, 10**5000):
        with pytest.raises(MessageError, match="height of known ground is inf; a finite number is needed"):
            transport.GroundPatch(outline=[*line, [1, 1]], height=huge, sigma=0)
        with pytest.raises(MessageError, match="outline of known ground is not an array of numbers"):
            transport.GroundPatch(outline=[*line, [1, huge]], height=0, sigma=0)
    with pytest.raises(MessageError, match="phase is 9"):
        transport.StancePause(robot="g", step=0, phase=9, stamp=0, stance=peer.make_stance())
    with pytest.raises(MessageError, match="time_available of StancePause is -1; allowed: 0 to 3,600 s"):
        transport.StancePause(robot="g", step=0, phase=1, stamp=0, stance=peer.make_stance(), time_available=-1.0)
    with pytest.raises(MessageError, match="'x' is 'y'; a number is needed"):
        transport.StanceMessage(joint_positions={"x": "y"}, support_feet=())


def test_crop_returns_the_cells_that_the_region_touches(peer) -> None:
    """Values keep their positions in the world; a region that ends on a border takes no further cell."""
    terrain = peer.make_terrain(shape=(10, 20), resolution=0.1, origin=(1.0, -0.5))
    part = crop_terrain(terrain, (1.25, 1.5, -0.4, 0.05))
    assert part.shape == (5, 3)
    np.testing.assert_allclose(part.origin, (1.2, -0.4))
    np.testing.assert_array_equal(part.layers["slope"], terrain.layers["slope"][1:6, 2:5])
    assert crop_terrain(terrain, (-9, 9, -9, 9)).shape == terrain.shape


def test_crop_off_the_grid_is_refused(peer) -> None:
    """The message says what the grid covers."""
    terrain = peer.make_terrain(shape=(10, 20), resolution=0.1, origin=(1.0, -0.5))
    with pytest.raises(MessageError, match=r"is empty or outside the grid, which covers x 1 \.\.\. 3"):
        crop_terrain(terrain, (5, 6, 0, 1))

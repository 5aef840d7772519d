"""Tests of the CDR codec: round trips, an independent reader, types and their hashes."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import transport
from tests.thorough import examples
from tests.transport.messages.samples import FILL_BYTES, STANDING_BYTES, sample_pause, sample_status
from transport import MessageError
from transport.messages import codec, terrain_message
from transport.messages.scan_messages import (
    decode_query_request,
    encode_query_request,
)
from transport.messages.stance_pause import make_stance_pause
from transport.messages.typestore import (
    dds_type_name,
    message_class,
    message_definition,
    message_files,
    type_hash,
    typestore,
)

MSG = Path(transport.__file__).with_name("msg")
_SPEC = importlib.util.spec_from_file_location("independent_cdr", Path(__file__).with_name("independent_cdr.py"))
independent = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(independent)


def test_terrain_round_trip_is_exact(peer) -> None:
    """Every field of a Terrain message comes back as it was, every layer bit for bit and read-only."""
    terrain = peer.make_terrain(7)
    back = transport.decode_terrain(transport.encode_terrain(terrain))
    for name in terrain.__dataclass_fields__:
        if name not in ("layers", "transforms", "obstacles"):
            assert getattr(back, name) == getattr(terrain, name), name
    assert list(back.layers) == list(transport.LAYERS)
    for name, array in terrain.layers.items():
        assert back.layers[name].dtype == transport.LAYERS[name].dtype
        assert back.layers[name].shape == (108, 90)
        assert back.layers[name].tobytes() == array.tobytes()
        assert not back.layers[name].flags.writeable and back.layers[name].flags.aligned
    for original, decoded in zip(terrain.transforms, back.transforms, strict=True):
        assert (original.source_frame, original.destination_frame) == (decoded.source_frame, decoded.destination_frame)
        np.testing.assert_allclose(decoded.matrix, original.matrix, atol=1e-15)
    np.testing.assert_array_equal(back.transforms[0].covariance, terrain.transforms[0].covariance)
    assert back.transforms[1].covariance is None
    assert back.obstacles[0].position == terrain.obstacles[0].position
    np.testing.assert_array_equal(back.obstacles[0].outline, terrain.obstacles[0].outline)


def test_stance_pause_round_trip_is_exact(peer) -> None:
    """Every field of a StancePause comes back as it was."""
    pause = sample_pause(peer)
    back = transport.decode_stance_pause(transport.encode_stance_pause(pause))
    for name in ("robot", "step", "phase", "stamp", "stance", "time_available", "frame_id", "epoch", "standing_pauses"):
        assert getattr(back, name) == getattr(pause, name), name
    np.testing.assert_array_equal(back.known_ground[0].outline, pause.known_ground[0].outline)
    assert (back.known_ground[0].height, back.known_ground[0].sigma) == (0.01, 0.002)


@pytest.mark.parametrize("byte_order", ["little", "big"])
def test_pauses_of_a_gait_that_knows_no_walks_are_read(peer, byte_order: str) -> None:
    """What was sent before walks had an identity ends where `epoch` begins: it is read, and the epoch is empty."""
    message = make_stance_pause(replace(sample_pause(peer), epoch="", standing_pauses=()))
    whole = bytes(typestore().serialize_cdr(message, message.__msgtype__, little_endian=byte_order == "little"))
    old = transport.decode_stance_pause(whole[: -5 - 3 - 4])
    assert (old.step, old.phase, old.epoch, old.known_ground[0].sigma) == (-3, transport.PausePhase.END, "", 0.002)
    assert old.standing_pauses == ()
    with pytest.raises(MessageError):
        transport.decode_stance_pause(whole[: -9 - 3 - 4])


@pytest.mark.parametrize("byte_order", ["little", "big"])
def test_pauses_of_a_gait_that_does_not_say_which_feet_stood_are_read(peer, byte_order: str) -> None:
    """What was sent before ends where the bytes up to `standing_pauses` begin, or these: it is read, nothing stood."""
    message = make_stance_pause(sample_pause(peer))
    whole = bytes(typestore().serialize_cdr(message, message.__msgtype__, little_endian=byte_order == "little"))
    for cut in (STANDING_BYTES, STANDING_BYTES + FILL_BYTES):
        old = transport.decode_stance_pause(whole[:-cut])
        assert (old.step, old.epoch, old.standing_pauses) == (-3, "walk-7", ())


def test_standing_pauses_are_those_of_the_support_feet(peer) -> None:
    """One for each, or none."""
    with pytest.raises(MessageError, match="standing_pauses has 2 entries; allowed: none, or one for each of the 3"):
        replace(sample_pause(peer), standing_pauses=(1, 2))
    for wrong in ((-1, 0, 0), (2**32, 0, 0), ("two", 0, 0)):
        with pytest.raises(MessageError, match="standing_pauses is .*; allowed: integers from 0"):
            replace(sample_pause(peer), standing_pauses=wrong)


def test_a_phase_of_a_later_version_is_distinguished_from_damage(peer) -> None:
    """It is refused with a message that says which phases are known, by an error of its own."""
    message = make_stance_pause(sample_pause(peer))
    message.phase = 9
    with pytest.raises(transport.UnknownPhase, match=r"phase is 9; known: 1 \(BEGIN\), 2 \(END\) and 3 \(HOLD\)"):
        transport.decode_stance_pause(bytes(transport.encode(message)))


@pytest.mark.parametrize("fields", [{"step": 2**53 + 1}, {"step": -(2**63)}, {"epoch": "x" * 101}])
def test_a_pause_of_absurd_numbers_is_refused(peer, fields: dict[str, object]) -> None:
    """No number of a pause that would overflow a counter, no endless epoch."""
    with pytest.raises(MessageError, match=next(iter(fields))):
        replace(sample_pause(peer), **fields)


def test_an_announcement_beyond_the_limit_is_refused() -> None:
    """A gait has no 256 kB to say; nothing of it is decoded."""
    with pytest.raises(MessageError, match="stance pause of 262145 bytes refused; allowed: up to 262144 bytes"):
        transport.decode_stance_pause(bytes(256 * 1024 + 1))


def test_unknown_gravity_stays_unknown(peer) -> None:
    """No gravity is distinguished from a gravity of zero."""
    stance = transport.StanceMessage(joint_positions={}, support_feet=())
    terrain = peer.make_terrain(shape=(1, 1), stance=stance)
    assert transport.decode_terrain(transport.encode_terrain(terrain)).stance.gravity_in_base is None


def test_small_messages_round_trip(payloads, peer) -> None:
    """Requests, replies, refusals, queries and status come back as they were."""
    for kind, (payload, decode) in payloads.items():
        message = decode(payload)
        if kind == "guara_msgs/ScanReply":
            assert (message.step, message.sequence, message.stamp, message.stripes_total) == (-1, 9, 5, 35)
        if kind == "guara_msgs/QueryRequest":
            assert message == transport.QueryRequest(extent="map", region=(0.0, 1.0, -1.0, 0.5))
        if kind == "diagnostic_msgs/DiagnosticArray":
            assert message == sample_status(peer)
    assert decode_query_request(encode_query_request(transport.QueryRequest())).region is None


@given(
    text=st.text(st.characters(exclude_characters="\x00", exclude_categories=["Cs"]), max_size=40),
    numbers=st.lists(st.floats(-1e6, 1e6), max_size=8),
)
@settings(max_examples=examples(60), derandomize=True, deadline=None)
def test_any_stance_round_trips(text: str, numbers: list[float]) -> None:
    """Joint names of any text and positions of any number that is allowed survive the codec."""
    stance = transport.StanceMessage(
        joint_positions={f"{text}{i}": value for i, value in enumerate(numbers)}, support_feet=(text,)
    )
    pause = transport.StancePause(robot="r", step=0, phase=1, stamp=0, stance=stance)
    assert transport.decode_stance_pause(transport.encode_stance_pause(pause)).stance == stance


def test_an_independent_reader_reads_every_message(payloads, peer) -> None:
    """A reader that shares no code, only the `.msg` files, uses up each payload and finds the same values."""
    for kind, (payload, _) in payloads.items():
        assert independent.read(payload, kind, MSG), kind
    terrain = peer.make_terrain(3, shape=(2, 3))
    found = independent.read(transport.encode_terrain(terrain), "guara_msgs/Terrain", MSG)
    assert (found["nx"], found["ny"], found["sequence"], found["step"]) == (3, 2, 3, 3)
    assert found["header"]["stamp"] == {"sec": 1_700_000_000, "nanosec": 0}
    assert found["scan_start"] == {"sec": 1_699_999_998, "nanosec": 0}
    for layer in found["layers"]:
        name = layer["name"]
        field = {1: "float32_values", 2: "uint16_values", 3: "uint8_values"}[layer["type"]]
        values = np.array(layer[field], dtype=terrain.layers[name].dtype)
        np.testing.assert_array_equal(values, terrain.layers[name].ravel())
    transform = found["transforms"][0]["transform"]
    half = np.sqrt(0.5)
    assert transform["translation"] == {"x": 1.0, "y": 2.0, "z": 0.36}
    np.testing.assert_allclose([transform["rotation"][n] for n in "xyzw"], [0, 0, half, half], atol=1e-15)
    assert found["transforms"][0]["covariance"][::7] == [1, 2, 3, 4, 5, 6]
    assert found["stage_names"] == ["stripes", "finish"] and found["stage_ms"] == [12.5, 30.0]


def test_big_endian_payloads_are_read_too(peer) -> None:
    """A machine of the other byte order is understood: the header says which order it is."""
    terrain = peer.make_terrain(5, shape=(2, 3))
    message = terrain_message.make_terrain(terrain)
    payload = bytes(typestore().serialize_cdr(message, message.__msgtype__, little_endian=False))
    assert payload[:2] == b"\x00\x00"
    back = transport.decode_terrain(payload)
    for name, array in terrain.layers.items():
        assert back.layers[name].tobytes() == array.tobytes(), name


def test_type_hashes_are_those_of_ros() -> None:
    """The hashes of the two mirrored types equal those found with a second implementation."""
    assert type_hash("nav_msgs/msg/OccupancyGrid") == (
        "RIHS01_8d348150c12913a31ee0ec170fbf25089e4745d17035792a1ba94d6f0bc0cfc7"
    )
    assert type_hash("grid_map_msgs/msg/GridMap") == (
        "RIHS01_343b0e72887541beda6b035cc053f2d6fffaad9d6dcb2773c15a808dfca31fde"
    )
    assert dds_type_name("nav_msgs/msg/OccupancyGrid") == "nav_msgs::msg::dds_::OccupancyGrid_"


def test_every_message_file_is_known_and_defined() -> None:
    """Each `.msg` file gives a class, and a definition that names all types it uses."""
    standard = list((MSG / "standard").rglob("*.msg"))
    assert len(message_files()) == len(list(MSG.rglob("*.msg"))) - len(standard)
    for name in message_files():
        assert message_class(name).__msgtype__ == name
    assert "MSG: guara_msgs/TerrainLayer" in message_definition("guara_msgs/msg/Terrain")


def test_the_definitions_beside_suffice_without_ros(peer) -> None:
    """With the files of `transport/msg` alone, in an empty store, everything on the wire is read; hashes as of ROS."""
    alone = get_typestore(Stores.EMPTY)
    standard = {f"{path.parent.name}/msg/{path.stem}": path.read_text() for path in (MSG / "standard").rglob("*.msg")}
    for name, text in (standard | message_files()).items():
        alone.register(get_types_from_msg(text, name))
    for name in (*standard, *message_files()):
        assert alone.hash_rihs01(name) == type_hash(name)
    payload = bytes(transport.encode_terrain(peer.make_terrain(3)))
    message = alone.deserialize_cdr(payload, "guara_msgs/msg/Terrain")
    assert message.sequence == 3 and bytes(alone.serialize_cdr(message, "guara_msgs/msg/Terrain")) == payload
    for name in ("nav_msgs/msg/OccupancyGrid", "diagnostic_msgs/msg/DiagnosticArray", "grid_map_msgs/msg/GridMap"):
        assert "\nMSG: " in alone.generate_msgdef(name, ros_version=2)[0]


def test_an_unknown_type_is_refused() -> None:
    """The message lists the types of this package."""
    with pytest.raises(MessageError, match="guara_msgs/msg/Terrain"):
        transport.decode(b"\x00\x01\x00\x00", "guara_msgs/msg/Nothing")


def test_only_message_objects_are_encoded() -> None:
    """Anything else is refused by name."""
    with pytest.raises(MessageError, match="dict is not a ROS 2 message"):
        transport.encode({})


def test_an_array_of_another_dtype_is_refused() -> None:
    """An array that is not of the exact type is refused as a message error."""
    grid = transport.occupancy_message(np.zeros((2, 2), np.int8), 0.1, (0, 0), "f", 0)
    grid.data = np.zeros((2, 2))
    with pytest.raises(MessageError, match="cannot encode nav_msgs/msg/OccupancyGrid"):
        transport.encode(grid)


@pytest.mark.parametrize("stamp", [-1, 2**31 * 10**9])
def test_a_stamp_that_ros_cannot_hold_is_refused(stamp: int) -> None:
    """The message says which stamps are allowed."""
    with pytest.raises(MessageError, match="out of range; allowed: 0 to"):
        codec.make_time(stamp)


@given(st.integers(0, 2**31 * 10**9 - 1))
@settings(max_examples=examples(50), derandomize=True, deadline=None)
def test_time_round_trips(stamp: int) -> None:
    """A stamp survives to the nanosecond."""
    assert codec.read_time(codec.make_time(stamp)) == stamp


def test_an_impossible_time_is_refused() -> None:
    """More nanoseconds than a second has, or negative seconds, are no time."""
    time = message_class("builtin_interfaces/msg/Time")
    for sec, nanosec in ((0, 10**9), (-1, 0)):
        with pytest.raises(MessageError, match="is not valid"):
            codec.read_time(time(sec, nanosec))

"""The examples in other languages: a grid of a node over Zenoh alone, read in JavaScript and C++ as in Python."""

import dataclasses
import json
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

import guara_perception as gp
from guara_perception.app.map_summary import message_to_summary, summary_payload
from guara_perception.app.messages import message_to_terrain, terrain_to_message
from guara_perception.app.publisher import send_terrain
from kinematics import RobotModel, Stance
from tests.interop.conftest import INSTALL
from tests.interop.ros_environment import environment
from tests.ports import free_endpoint
from transport import (
    Health,
    PerceptionServer,
    StanceStream,
    StanceStreamReceiver,
    Status,
    StatusItem,
    decode_terrain,
    encode_terrain,
    open_client,
    open_node,
)
from transport.grids.evidence import objections, read_report
from transport.messages.codec import encode
from transport.messages.map_messages import decode_summary
from transport.messages.status_message import encode_status
from transport.messages.terrain_message import make_terrain

pytestmark = pytest.mark.interop
POSITIONS = ((0.7, 0.0), (0.62, -0.21), (0.502, 0.262), (0.9, 0.1), (3.0, 0.0))


@pytest.fixture(scope="module")
def endpoint(paper_terrain: gp.TerrainGrid) -> Iterator[str]:
    """A node that has published the grid of a recorded scan."""
    endpoint = free_endpoint()
    with open_node(listen=endpoint) as session:
        server = PerceptionServer(session)
        send_terrain(server, paper_terrain)
        server.flush()
        yield endpoint


@pytest.fixture(scope="module")
def payloads(endpoint: str, root: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Payloads by key, as examples/plain_zenoh.py brings them."""
    folder = tmp_path_factory.mktemp("payloads")
    found = {}
    for name, said in (
        ("terrain", "application/cdr;guara_msgs/msg/Terrain"),
        ("compact/terrain", "application/zstd;shuffle=4;application/cdr;guara_msgs/msg/Terrain"),
        ("status", "application/cdr;diagnostic_msgs/msg/DiagnosticArray"),
    ):
        path = folder / f"{name.replace('/', '_')}.bin"
        command = [sys.executable, root / "examples" / "plain_zenoh.py", endpoint, f"guara/perception/v1/{name}", path]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == 0, done.stderr
        assert done.stdout == f"guara/perception/v1/{name}: {path.stat().st_size} bytes of {said}\n"
        found[name] = path
    return found


def first_line(terrain: gp.TerrainGrid) -> str:
    return f"guara, footprint of step 0: 90 x 108 cells, {int((terrain.hazard == 0).sum())} safe"


@pytest.mark.parametrize("name", ["terrain", "compact/terrain"])
def test_javascript_reads_what_python_reads(payloads: dict[str, Path], root: Path, name: str) -> None:
    """Foxglove's libraries and this project's definitions; JavaScript decompresses and unshuffles the compact one."""
    folder = root / "examples" / "javascript"
    if shutil.which("node") is None:
        pytest.skip("node is not installed")
    if not (folder / "node_modules" / "fzstd").is_dir():
        pytest.skip(f"libraries of the example are missing: {INSTALL}")
    terrain = message_to_terrain(decode_terrain(payloads[name].read_bytes()))
    assert ("rounding" in terrain.metadata) == (name != "terrain")
    for x, y in POSITIONS:
        command = ["node", folder / "read_terrain.mjs", payloads[name], str(x), str(y)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == 0, done.stderr
        what, cell = done.stdout.splitlines()
        assert what == first_line(terrain)
        found = json.loads(cell)
        hazard = terrain.hazard_at(x, y)
        assert found["safe"] == terrain.is_traversable(x, y)
        assert found["known"] == (hazard & 0x3F == 0)
        if x < 1.0:
            assert found["hazard"] == int(hazard)
        if found["known"]:
            assert found["elevation"] == terrain.height_at(x, y)


STATES: dict[str, tuple[dict[str, object], dict[str, object]]] = {
    "in its pause": ({}, {}),
    "in the swing after": ({}, {"standing": "false"}),
    "provisional in its pause": ({"provisional": True}, {}),
    "provisional, and the pause over": ({"provisional": True}, {"standing": "false"}),
    "the next pause": ({}, {"step": 4}),
    "a pause later, by a status of before": ({}, {"step": 2}),
    "another walk": ({}, {"epoch": "walk-b", "step": 0}),
    "another run": ({}, {"run": "run-2"}),
    "another run that knows no pause": ({}, {"run": "run-2", "step": "", "epoch": "", "standing": ""}),
    "a newer one lost": ({}, {"last_scan_sequence": 2}),
    "too old": ({}, {"clock_s": 1000.0}),
    "withdrawn": ({"withdrawn": True}, {}),
    "nobody announces pauses": ({"epoch": ""}, {"epoch": "", "standing": ""}),
}


@pytest.fixture(scope="module")
def judged(
    paper_terrain: gp.TerrainGrid, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, tuple[Path, Path, bool]]:
    """By state: payload of a grid, of the node's status after it, and whether a Python client would use the grid."""
    folder, found = tmp_path_factory.mktemp("judged"), {}
    at_pause = dataclasses.replace(paper_terrain, step=3)
    for state, (stated, values) in STATES.items():
        known = {"run": "run-1", "epoch": "walk-a", "scan_end_clock": 100.0, "provisional": False, **stated}
        message = terrain_to_message(
            at_pause, robot="guara", sequence=1, valid_for=420.0, stated=known | {"withdrawn": False}
        )
        if known.get("withdrawn"):
            message = message.emptied(message.stamp, "moved")
        said = {
            "run": "run-1",
            "clock_s": 101.0,
            "epoch": "walk-a",
            "step": 3,
            "standing": "true",
            "last_scan_sequence": 1,
        }
        items = (StatusItem(name="transport", level=Health.OK, values=said | values),)
        status = Status(stamp=1, items=items)
        paths = folder / f"{len(found)}.bin", folder / f"{len(found)}.status"
        paths[0].write_bytes(encode_terrain(message))
        paths[1].write_bytes(encode_status(status))
        report = read_report(status, 0.0)
        age = float((said | values)["clock_s"]) - 100.0
        found[state] = (*paths, not objections(message, report, age=age, limit=message.valid_for))
    return found


@pytest.mark.parametrize("state", STATES)
def test_javascript_judges_as_python_does(judged: dict[str, tuple[Path, Path, bool]], root: Path, state: str) -> None:
    """With the node's status of now: a robot steps by the same grids, and by no other."""
    folder = root / "examples" / "javascript"
    if shutil.which("node") is None or not (folder / "node_modules" / "fzstd").is_dir():
        pytest.skip(f"node or libraries of the example are missing: {INSTALL}")
    payload, status, may_be_used = judged[state]
    command = ["node", folder / "read_terrain.mjs", payload, "0.7", "0", status]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0, done.stderr
    _, cell, verdict = done.stdout.splitlines()
    assert (verdict == "may be used") == may_be_used, verdict
    assert may_be_used or not json.loads(cell)["safe"]
    assert state != "the next pause" or "it is 1 pause old; allowed: 0" in verdict


def test_javascript_reads_the_summary_as_python_does(paper_terrain: gp.TerrainGrid, root: Path, tmp_path: Path) -> None:
    """Three layers in small numbers, which JavaScript decompresses and unshuffles."""
    folder = root / "examples" / "javascript"
    if shutil.which("node") is None or not (folder / "node_modules" / "fzstd").is_dir():
        pytest.skip(f"node or libraries of the example are missing: {INSTALL}")
    sent = summary_payload(terrain_to_message(paper_terrain, robot="rex", sequence=1))
    payload = tmp_path / "summary.bin"
    payload.write_bytes(sent)
    summary = message_to_summary(decode_summary(sent))
    for x, y in POSITIONS:
        command = ["node", folder / "read_summary.mjs", payload, str(x), str(y)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
        assert done.returncode == 0, done.stderr
        what, cell = done.stdout.splitlines()
        assert what == f"rex, summary of step 0: 90 x 108 cells, {int((summary.hazard == 0).sum())} safe"
        found = json.loads(cell)
        assert found["safe"] == summary.is_traversable(x, y)
        assert found["known"] == (not np.isnan(summary.height_at(x, y)))
        if found["known"]:
            assert found["elevation"] == pytest.approx(summary.height_at(x, y), abs=1e-6)
    payload.write_bytes(payload.read_bytes()[:-20])
    command = ["node", folder / "read_summary.mjs", payload, "0.7", "0"]
    assert subprocess.run(command, capture_output=True, timeout=60, check=False).returncode != 0


def test_javascript_leaves_out_layers_of_later_types_and_refuses_known_ones_of_another(
    paper_terrain: gp.TerrainGrid, root: Path, tmp_path: Path
) -> None:
    """A layer that nobody knows here changes nothing; hazard in another form, or none, ends in one line."""
    folder = root / "examples" / "javascript"
    if shutil.which("node") is None or not (folder / "node_modules" / "fzstd").is_dir():
        pytest.skip(f"node or libraries of the example are missing: {INSTALL}")
    payload = tmp_path / "terrain.bin"

    def said(layer_name: str, **changes: object) -> subprocess.CompletedProcess[str]:
        message = make_terrain(terrain_to_message(paper_terrain, robot="rex", sequence=1))
        (layer,) = (layer for layer in message.layers if layer.name == layer_name)
        for field, value in changes.items():
            setattr(layer, field, value)
        payload.write_bytes(encode(message))
        command = ["node", folder / "read_terrain.mjs", payload, "0.7", "0"]
        return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)

    later = said("slope", name="colour", type=9)
    assert later.returncode == 0 and json.loads(later.stdout.splitlines()[1])["known"], later.stderr
    for changes, expected_text in (
        ({"type": 9}, "layer hazard has type 9, 2 is read here"),
        ({"type": 1}, "layer hazard has type 1, 2 is read here"),
        ({"name": "danger"}, "layers hazard are missing"),
    ):
        refused = said("hazard", **changes)
        assert (refused.returncode, refused.stdout, refused.stderr) == (1, "", expected_text + "\n")


def check_gait(program: list[object], root: Path, robot: RobotModel) -> None:
    """A simulated node scans and confirms the pause that a program in another language announces."""
    endpoint = free_endpoint()
    arguments = ["run", "--simulated", "--gait", "external", "--mode", "coarse", "--listen", endpoint]
    node = subprocess.Popen(
        [sys.executable, "-m", "guara_perception.app.main", *arguments], stdout=subprocess.PIPE, text=True
    )
    command = [sys.executable, root / "examples" / "relay_gait.py", endpoint, *map(str, program), "1", "60"]
    try:
        assert node.stdout is not None
        assert any("waiting for your gait" in line for line in node.stdout)
        with gp.TerrainClient(endpoint, timeout=180) as client, ExitStack() as stack:
            streamed: list[StanceStream] = []
            session = stack.enter_context(open_client(endpoint, timeout=180.0))
            StanceStreamReceiver(session, on_batch=streamed.append)
            relay = subprocess.Popen(command)
            terrain = client.wait_for_step(0, timeout=180, confirmed_only=True)
            relay.terminate()
            relay.wait(60)
        node.send_signal(signal.SIGINT)
        node.communicate(timeout=180)
    finally:
        node.kill()
    assert node.returncode == 0
    # As many as the scan takes time: a fast machine confirms it after a second and a half.
    assert len(streamed) > 3 and [batch.sequence for batch in streamed] == list(range(len(streamed)))
    samples = sum(len(batch.stamps) for batch in streamed)
    assert all(batch.gravity_in_base is None and batch.angular_velocity is None for batch in streamed)
    assert samples > len(streamed) and all(batch.supports.all() and batch.legs == robot.legs for batch in streamed)
    assert dict(zip(streamed[0].joint_names, streamed[0].joint_positions[0], strict=True)) == pytest.approx(
        robot.posture(robot.config.scan_posture), abs=0.002
    )
    assert not terrain.is_provisional and np.isfinite(terrain.elevation).mean() > 0.7
    received = terrain.record.stance
    assert received is not None and set(received.support_feet) == set(robot.legs)
    assert received.joint_positions == pytest.approx(robot.posture(robot.config.scan_posture), abs=0.002)


def test_a_gait_in_javascript_gets_its_scans_confirmed(root: Path, robot: RobotModel, tmp_path: Path) -> None:
    """StancePause and the clock's answer come from JavaScript."""
    folder = root / "examples" / "javascript"
    if shutil.which("node") is None or not (folder / "node_modules" / "fzstd").is_dir():
        pytest.skip(f"node or libraries of the example are missing: {INSTALL}")
    stance = Stance(robot.posture(robot.config.scan_posture), robot.legs, None)
    (tmp_path / "stance.json").write_text(json.dumps(stance.to_dict()))
    check_gait(["node", folder / "gait.mjs", tmp_path / "stance.json"], root, robot)


def test_javascript_refuses_what_is_no_grid(root: Path, tmp_path: Path) -> None:
    folder = root / "examples" / "javascript"
    if shutil.which("node") is None or not (folder / "node_modules" / "fzstd").is_dir():
        pytest.skip(f"node or libraries of the example are missing: {INSTALL}")
    (tmp_path / "x").write_bytes(b"\x00\x01\x00\x00 no grid")
    command = ["node", folder / "read_terrain.mjs", tmp_path / "x", "0.7", "0"]
    assert subprocess.run(command, capture_output=True, timeout=60, check=False).returncode != 0


@pytest.fixture(scope="module")
def build(root: Path, ros: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """Builds a folder of C++ with ROS 2's wheels."""

    def made(folder: str) -> Path:
        target = tmp_path_factory.mktemp("build")
        options = {"Python3_EXECUTABLE": ros / "bin" / "python", "CMAKE_CXX_FLAGS": "-Wall -Wextra -Werror"}
        given = [f"-D{name}={value}" for name, value in options.items()]
        for command in (
            ["cmake", "-G", "Ninja", "-S", root / folder, "-B", target, *given],
            ["cmake", "--build", target],
        ):
            done = subprocess.run(
                command, env=environment(ros), capture_output=True, text=True, timeout=300, check=False
            )
            if "Could NOT find OpenSSL" in done.stderr:
                pytest.skip("Fast DDS of the wheels wants OpenSSL's headers (Debian: libssl-dev)")
            assert done.returncode == 0, done.stdout + done.stderr
        return target

    return made


def test_cpp_reads_and_judges_as_python_does(
    build: Callable[[str], Path],
    payloads: dict[str, Path],
    judged: dict[str, tuple[Path, Path, bool]],
    ros: Path,
) -> None:
    """guara_msgs as rosidl generates it, read by the middleware's own deserialiser."""
    program = build("examples/cpp") / "read_terrain"
    terrain = message_to_terrain(decode_terrain(payloads["terrain"].read_bytes()))

    def run(*arguments: object) -> subprocess.CompletedProcess[str]:
        given = [program, *map(str, arguments)]
        return subprocess.run(given, env=environment(ros), capture_output=True, text=True, timeout=60, check=False)

    for x, y in POSITIONS:
        done = run(payloads["terrain"], x, y)
        assert done.returncode == 0, done.stderr
        what, cell = done.stdout.splitlines()
        assert what == first_line(terrain)
        if x > 1.0:
            assert cell == "off the grid: nothing is known"
            continue
        hazard = terrain.hazard_at(x, y)
        known, safe = (("unknown", "known")[hazard & 0x3F == 0], ("not safe", "safe")[terrain.is_traversable(x, y)])
        assert cell.startswith(f"{known}, {safe}, hazard {int(hazard)}, elevation ")
        if known == "known":
            (height,) = re.findall(r"elevation (-?[0-9.]+)", cell)
            assert float(height) == pytest.approx(terrain.height_at(x, y), abs=1e-6)
    for state, (payload, status, may_be_used) in judged.items():
        done = run(payload, 0.7, 0.0, status)
        assert done.returncode == 0, done.stderr
        _, cell, verdict = done.stdout.splitlines()
        assert (verdict == "may be used") == may_be_used, (state, verdict)
        assert may_be_used or ", not safe, " in cell
    done = run(payloads["compact/terrain"], 0.7, 0.0)
    assert done.returncode == 1 and "no Terrain message" in done.stderr
    assert run().returncode == 2


def test_a_gait_in_cpp_gets_its_scans_confirmed(
    build: Callable[[str], Path], ros: Path, root: Path, robot: RobotModel, tmp_path: Path
) -> None:
    """StancePause and the clock's answer come from C++, written by the middleware's own serialiser."""
    program = build("examples/cpp") / "gait"
    joints = robot.posture(robot.config.scan_posture)
    lines = [f"{name} {angle}" for name, angle in joints.items()] + [f"FOOT {leg}" for leg in robot.legs]
    (tmp_path / "stance.txt").write_text("\n".join(lines))
    # The relay is a program of this environment, the gait one of ROS 2's.
    names = ("LD_LIBRARY_PATH", "AMENT_PREFIX_PATH", "RMW_IMPLEMENTATION")
    variables = environment(ros)
    wrapped = ["env", *(f"{name}={variables[name]}" for name in names), str(program), str(tmp_path / "stance.txt")]
    check_gait(wrapped, root, robot)
    assert subprocess.run(wrapped[:-1], capture_output=True, timeout=60, check=False).returncode == 2

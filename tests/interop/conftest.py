"""What the tests against other software need: a recording of the demo, ROS 2 from its wheels, Foxglove's libraries."""

import json
import shutil
import subprocess
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from mcap.reader import make_reader

from guara_perception.app.main import run
from tests.interop.ros_environment import environment

HERE = Path(__file__).parent
INSTALL = "`make install-interop` was not run, or could not"


@pytest.fixture(scope="session")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What `guara demo` leaves, of five pauses."""
    out = tmp_path_factory.mktemp("demo")
    assert run(["demo", "--cycles", "1", "--out", str(out)]) == 0
    return out / "walk.mcap"


@pytest.fixture(scope="session")
def counts(recording: Path) -> dict[str, int]:
    """Messages of each topic, by MCAP's own reader in Python."""
    with recording.open("rb") as file:
        return dict(Counter(channel.topic for _, channel, _ in make_reader(file).iter_messages()))


@pytest.fixture(scope="session")
def ros(root: Path) -> Path:
    """The environment with ROS 2; skips where there is none."""
    folder = root / ".venv-ros"
    if not (folder / "overlay" / "share" / "tf2_msgs").is_dir():
        pytest.skip(f"no ROS 2 in {folder.name}: {INSTALL}")
    return folder


@pytest.fixture(scope="session")
def read_by_ros(ros: Path, recording: Path) -> dict[str, Any]:
    """What rclpy makes of the recording."""
    command = [ros / "bin" / "python", HERE / "decode_ros2.py", recording, ros / "overlay", ros]
    done = subprocess.run(command, env=environment(ros), capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads(done.stdout)


@pytest.fixture(scope="session")
def read_by_foxglove(recording: Path) -> dict[str, Any]:
    """What Foxglove's libraries make of the recording; skips where node or they are missing."""
    if shutil.which("node") is None:
        pytest.skip("node is not installed")
    if not (HERE / "js" / "node_modules" / "@foxglove").is_dir():
        pytest.skip(f"Foxglove's libraries are missing: {INSTALL}")
    command = ["node", HERE / "js" / "decode.mjs", recording]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr[-3000:]
    return json.loads(done.stdout)

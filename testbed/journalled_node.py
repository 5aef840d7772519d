"""Node with a journal, for a robot that continues to walk while the node is killed and restarted.

`python -m testbed.journalled_node ENDPOINT STATE WALK [RECORDINGS PORT]` connects to the router at ENDPOINT and ends
when its standard input is closed. WALK is a file written by `Walk.save`; in every run of the node, the simulated robot
stands at the pause of the announced step. With a folder RECORDINGS, the node also records and serves metrics at PORT.
"""

from __future__ import annotations

import pickle
import subprocess
import sys
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from guara_perception.app.files.recording_files import LEAST_LIMIT
from guara_perception.app.logs import log_to_stderr
from guara_perception.app.metrics import metrics_served
from guara_perception.app.node.claim import Seal
from guara_perception.app.node.journal import Journal
from guara_perception.app.node.node import PerceptionNode
from guara_perception.app.node.node_status import NodeStatus
from guara_perception.app.node.pause_scanner import PauseScanner
from guara_perception.app.node.rangefinder import Rangefinder
from guara_perception.app.node.recorder import ScanRecorder
from guara_perception.app.node.simulated import SimulatedRobot
from guara_perception.simulation.scene_view import SceneView
from guara_perception.simulation.walk import WalkPause
from guara_perception.simulation.world import World
from transport import PausePhase, StancePause, open_node
from transport.server import PerceptionServer
from transport.stance_link import StanceReceiver

CONNECT_S = 60.0
JPEG_QUALITY = 90
ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True)
class Walk:
    """World, seed of calibration and noise, pauses by step, size of frames [px], and name or folder of the robot."""

    world: World
    seed: int
    pauses: tuple[WalkPause, ...]
    size: tuple[int, int] = (640, 512)
    robot: str | Path = "guara"

    def save(self, path: Path) -> None:
        """Write the walk to a file for the node."""
        path.write_bytes(pickle.dumps(self))


def start(
    endpoint: str, state: Path, walk: Path, log: Path | None = None, recordings: Path | None = None, port: int = 0
) -> subprocess.Popen[str]:
    """Start the node in a separate process."""
    command = [sys.executable, "-m", "testbed.journalled_node", endpoint, str(state), str(walk)]
    command += [] if recordings is None else [str(recordings), str(port)]
    with (log or Path("/dev/null")).open("a") as errors:
        return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=errors, stderr=errors, text=True, cwd=ROOT)


class Placing:
    """Rangefinder that moves the simulated robot to the current pause of the walk when a sweep begins.

    Moving the robot computes the view of a whole scan, which at BEGIN would delay the reception of gait messages. Views
    are cached, because the robot returns to the same pauses; the noise is new in each frame.
    """

    def __init__(self, rangefinder: Rangefinder, simulated: SimulatedRobot, walk: Walk) -> None:
        """Start at the first pause."""
        self._rangefinder, self._simulated, self._walk, self.step = rangefinder, simulated, walk, 0
        self._views: dict[int, SceneView] = {}

    def __getattr__(self, name: str) -> Any:
        """Return other attributes of the rangefinder."""
        return getattr(self._rangefinder, name)

    def sweep(self, *arguments: Any) -> Any:
        """Move the robot to its pause, and sweep."""
        step = self.step
        self._views[step] = self._simulated.stand_at(self._walk.pauses[step], self._views.get(step))
        return self._rangefinder.sweep(*arguments)


def main() -> None:
    """Run until standard input ends."""
    endpoint, state, file, *recorded = sys.argv[1:]
    log_to_stderr("text")
    walk: Walk = pickle.loads(Path(file).read_bytes())
    simulated = SimulatedRobot(walk.robot, world=walk.world, seed=walk.seed, size=walk.size)
    robot, calibration = simulated.robot, simulated.calibration
    status = NodeStatus(calibration)
    with ExitStack() as stack:
        session = stack.enter_context(open_node(connect=endpoint, timeout=CONNECT_S))
        rangefinder: Any = Placing(stack.enter_context(simulated.rangefinder), simulated, walk)
        journal = stack.enter_context(Journal(Path(state), robot, Seal.of("guara", robot, calibration)))
        server = PerceptionServer(session, collect_status=status.items)
        recorder = None
        if recorded:
            made = ScanRecorder(
                recorded[0], robot="guara", calibration=calibration, jpeg_quality=JPEG_QUALITY, limit=LEAST_LIMIT
            )
            recorder = stack.enter_context(made)
            stack.enter_context(metrics_served(int(recorded[1]), "guara", server.status_items))
        parts = (robot, calibration, rangefinder, server)
        node = PerceptionNode(PauseScanner(*parts, status=status, recorder=recorder, journal=journal), "coarse")
        stack.enter_context(node)

        def on_pause(announcement: StancePause) -> None:
            if announcement.phase is PausePhase.BEGIN:
                rangefinder.step = announcement.step
            node.on_pause(announcement)

        StanceReceiver(session, on_pause=on_pause, on_refused=node.on_refused)
        sys.stdin.read()


if __name__ == "__main__":
    main()

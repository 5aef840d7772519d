"""A node in its own process that publishes one stored grid when asked to; arguments: endpoint, robot, grid file, and
"connect" where a router is there already.

Commands on standard input, each answered by "done": `publish STEP [AGE_S [EPOCH [provisional]]]`, `map STEP [EPOCH
[provisional]]`, `break STEP` (a grid with one flipped bit), `views` (points and picture of the scan that was published
last), `pause STEP [EPOCH]`, `end`, `gait` (ask for the gait's clock), `serve`, `quit`.
"""

import dataclasses
import sys
import time

import cv2
import numpy as np

import guara_perception as gp
from guara_perception.app.messages import terrain_to_message
from guara_perception.app.publisher import send_terrain
from transport import ScanFailed, encode_terrain, open_node, point_cloud_message
from transport.keys import terrain_key
from transport.links.publisher import Publisher
from transport.recording import FrameRecord
from transport.recording.records import make_frame
from transport.server import PerceptionServer


class Node:
    def __init__(self, endpoint: str, robot: str, path: str, how: str = "listen") -> None:
        self.terrain = gp.load_terrain(path)
        self.session = open_node(listen=endpoint) if how == "listen" else open_node(connect=endpoint, timeout=180.0)
        self.server = PerceptionServer(self.session, robot=robot)
        self.broken: Publisher | None = None
        self.step, self.stamp = "", 0

    def publish(self, step: str, age: str = "0", epoch: str = "", state: str = "") -> None:
        if self.broken is not None:
            # Otherwise this second publisher would pass the damaged grid to clients that connect later.
            self.broken.close()
            self.broken = None
        stamp = time.time_ns() - round(float(age) * 1e9)
        self.step, self.stamp = step, stamp
        send_terrain(
            self.server, dataclasses.replace(self.terrain, stamp=stamp, step=int(step)), stated=walk(epoch, state)
        )
        self.server.flush(30)

    def views(self) -> None:
        xyz = {name: np.linspace(0.5, 0.9, 9, dtype=np.float32) for name in "xyz"}
        jpeg = cv2.imencode(".jpg", np.full((40, 60, 3), 90, np.uint8))[1].tobytes()
        picture = make_frame(FrameRecord(data=jpeg, format="jpeg", stamp=self.stamp), self.stamp)
        self.server.views.send(lambda: (point_cloud_message(xyz, "base_footprint", self.stamp), picture))
        self.server.views.flush(30)

    def map(self, step: str, epoch: str = "", state: str = "") -> None:
        # A map has the stamp of its scan.
        stamp = self.stamp if step == self.step else time.time_ns()
        terrain = dataclasses.replace(self.terrain, stamp=stamp, step=int(step), extent="map", pictures={})
        send_terrain(self.server, terrain, stated=walk(epoch, state))
        self.server.flush(30)

    def break_(self, step: str) -> None:
        """Publish a grid with a flipped bit in the hazard flags of a safe cell."""
        terrain = dataclasses.replace(self.terrain, stamp=time.time_ns(), step=int(step))
        message = terrain_to_message(terrain, robot=self.server.robot, sequence=self.server.next_sequence("footprint"))
        payload = bytearray(encode_terrain(message))
        hazard = np.asarray(terrain.hazard)
        safe = int(np.flatnonzero(hazard.ravel() == 0)[0])
        payload[payload.index(hazard.tobytes()) + 2 * safe + 1] ^= 0x10
        self.broken = Publisher(self.session, terrain_key(self.server.robot))
        self.broken.put(bytes(payload))

    def pause(self, step: str, epoch: str = "") -> None:
        self.server.begin_step(int(step), epoch)

    def end(self) -> None:
        self.server.end_step()

    def gait(self) -> None:
        self.server.gait_clock(lambda: None)

    def serve(self) -> None:
        def handle(job):
            if job.request.mode == "coarse":
                raise ScanFailed("the mirror did not move", code="mirror")
            for done in range(3):
                job.progress(done + 1, 3)
            return send_terrain(self.server, dataclasses.replace(self.terrain, stamp=time.time_ns(), step=1000))

        self.server.serve_scans(handle)


def walk(epoch: str, state: str) -> dict[str, object]:
    return {"epoch": epoch, "provisional": state == "provisional"} if epoch else {}


def main() -> None:
    node = Node(*sys.argv[1:])
    print("ready", flush=True)
    for line in sys.stdin:
        command, *arguments = line.split()
        if command == "quit":
            break
        getattr(node, "break_" if command == "break" else command)(*arguments)
        print("done", flush=True)
    node.session.close()


if __name__ == "__main__":
    main()

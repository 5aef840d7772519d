"""Processes that the transport's tests start: a node, a planner, a router, and the message that they exchange.

Started as `python peer.py COMMAND ENDPOINT ...`; says `ready` when it is, obeys lines on its standard input.
"""

import resource
import sys
import threading
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
import zenoh

import transport
from testbed.terrain_message import STAMP, make_stance, make_terrain  # noqa: F401
from transport.recording import FrameRecord, RecordingWriter, ScanRecord


def is_whole(terrain: transport.TerrainMessage) -> bool:
    """Whether all of a grid made by `make_terrain` comes from one sequence."""
    same = np.all(terrain.layers["variance"] == terrain.sequence)
    return bool(same and np.all(terrain.layers["looks"] == terrain.sequence % 256))


def say(*values: object) -> None:
    """A line to the test."""
    print(*values, flush=True)


def scan_handler(server: transport.PerceptionServer):
    """A scanner that does as the id of the request says."""

    def scan(job: transport.ScanJob) -> transport.TerrainMessage:
        say("scanning", job.request.id)
        # A request may ask for a behaviour by its id, as `fail-1`.
        behaviour = job.request.id.partition("-")[0]
        for stripe in range(3):
            job.progress(stripe + 1, 3)
            time.sleep(0.02)
        if behaviour == "fail":
            raise transport.ScanFailed("the camera is gone", "no_camera")
        if behaviour == "crash":
            raise ZeroDivisionError("a mistake")
        if behaviour == "slow":
            job.cancelled.wait(60.0)
        terrain = make_terrain(server.next_sequence("footprint"), robot=server.robot, stamp=time.time_ns())
        server.publish(terrain)
        if behaviour == "large":
            number = server.next_sequence("map")
            server.publish(make_terrain(number, extent="map", shape=(240, 260), stamp=time.time_ns()))
        return terrain

    return scan


def run_node(endpoint: str, mode: str = "listen", security: str = "", robot: str = "guara", uplink: str = "") -> None:
    """A node; `publish N`, `stream N PERIOD ROWS`, `map N`, `quit`, `crash`."""
    options = {"listen": endpoint} if mode == "listen" else {"connect": endpoint, "timeout": 20.0}
    if uplink:
        options["uplink"] = uplink
    with transport.open_node(**options, security=security or None) as session:
        server = transport.PerceptionServer(session, robot=robot, ros2_domain=0 if mode == "listen" else None)

        def admit(request: transport.ScanRequest) -> None:
            if request.id.startswith("walking"):
                raise transport.ScanFailed("the robot walks", "not_stationary")

        server.serve_scans(scan_handler(server), admission=admit)
        pauses = transport.StanceReceiver(session, robot=robot, on_pause=lambda p: say("pause", p.step, p.phase.name))
        say("ready")
        for line in sys.stdin:
            command, *arguments = line.split()
            if command == "publish":
                values = np.zeros((108, 90), np.int8)
                server.publish(make_terrain(int(arguments[0]), robot=robot, stamp=time.time_ns()), occupancy=values)
                server.flush()
            elif command == "map":
                server.publish(make_terrain(int(arguments[0]), robot=robot, extent="map", shape=(140, 320)))
                server.flush()
            elif command == "stream":
                shape = (int(arguments[2]), 400)
                grids = [make_terrain(n, shape=shape) for n in range(1, int(arguments[0]) + 1)]
                for grid in grids:
                    server.publish(grid)
                    server.flush(30.0)
                    time.sleep(float(arguments[1]))
                say("streamed", grids[-1].sequence)
            elif command == "step":
                server.begin_step(int(arguments[0]))
            elif command == "crash":
                raise RuntimeError("crashed as asked")
            elif command == "quit":
                break
        pauses.close()


def run_router(endpoint: str) -> None:
    """A Zenoh router and nothing else."""
    with transport.open_node(listen=endpoint):
        say("ready")
        sys.stdin.read()


def run_zenohd(configuration: str) -> None:
    """A Zenoh router from its own configuration file, as `zenohd -c` would run it."""
    with zenoh.open(zenoh.Config.from_file(configuration)):
        say("ready")
        sys.stdin.read()


def run_viewer(endpoint: str, security: str = "", robot: str = "guara") -> None:
    """A viewer behind a slow link: receives both extents and says so."""
    session = transport.open_client(endpoint, security=security or None, timeout=30.0, shared_memory=False)
    with transport.PerceptionClient(session, robot=robot) as client:
        for extent in ("footprint", "map"):
            client.on_terrain(lambda terrain: say("got", terrain.extent, terrain.sequence), extent=extent)
        say("ready")
        sys.stdin.read()


def run_planner(endpoint: str) -> None:
    """A planner that receives and says so."""
    with transport.open_client(endpoint, timeout=120.0) as session:
        client = transport.PerceptionClient(session)
        client.on_terrain(lambda terrain: say("got", terrain.sequence, is_whole(terrain)))
        say("ready")
        sys.stdin.read()


def run_exit(endpoint: str, how: str) -> None:
    """A planner script that ends in one of many ways, mostly without closing anything."""
    client = transport.PerceptionClient(transport.open_client(endpoint, timeout=120.0))
    entered = threading.Event()

    def stuck(_: object) -> None:
        entered.set()
        threading.Event().wait()

    if how == "stuck":
        client.on_terrain(stuck)
        entered.wait(20.0)
    elif how == "exit_in_callback":
        client.on_terrain(lambda _: (entered.set(), sys.exit(3)))
        entered.wait(20.0)
    elif how != "plain":
        client.on_terrain(lambda _: None)
    say("ready")
    if how == "raise":
        raise RuntimeError("crashed as asked")
    if how == "sys_exit":
        sys.exit(5)
    if how == "wait_grid":
        client.wait_for_step(10**6, timeout=120.0)
    if how == "wait_scan":
        client.request_scan(timeout=120.0, request_id="slow-exit")
    if how == "wait_connect":
        transport.open_client("tcp/127.0.0.1:1", timeout=120.0)
    if how == "thread":
        threading.Thread(target=client.wait_for_step, args=(10**6,), kwargs={"timeout": 120.0}).start()


def run_record(path: str) -> None:
    """Records scans and grids for ever; says which are acknowledged."""
    pixels = np.arange(640 * 64, dtype=np.uint8).reshape(64, 640)
    writer = RecordingWriter(path, calibration=b'{"format": "guara-calibration/1"}')
    say("ready")
    for step in range(100_000):
        scan = ScanRecord(robot="guara", mode="coarse", stamp=STAMP + step * 10**9, step=step, stance=make_stance())
        writer.begin_scan(scan)
        off = writer.add_frame(FrameRecord(pixels=pixels), laser_on=False)
        for index in range(4):
            writer.add_stripe(2 * index, 0.01 * index, FrameRecord(pixels=pixels + index), off)
        writer.end_scan(stance_end=make_stance())
        writer.add_terrain(make_terrain(step + 1, shape=(4, 5)))
        say("acknowledged", step)


def run_record_full(path: str) -> None:
    """Records scans while the disk is full for some of them, says which are acknowledged, and waits to be killed."""
    writer = RecordingWriter(path, calibration=b'{"format": "guara-calibration/1"}')
    rng = np.random.default_rng(0)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    say("ready")
    for step in range(12):
        # Full in the middle of the frames of step 4, until step 8.
        if step == 4:
            resource.setrlimit(resource.RLIMIT_FSIZE, (writer.path.stat().st_size + 100_000, hard))
        if step == 8:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        writer.begin_scan(
            ScanRecord(robot="guara", mode="coarse", stamp=STAMP + step * 10**9, step=step, stance=make_stance())
        )
        for index in range(4):
            pixels = rng.integers(0, 256, (600, 640), np.uint8)
            writer.add_stripe(2 * index, 0.01 * index, FrameRecord(pixels=pixels), None)
        try:
            writer.end_scan(stance_end=make_stance())
            writer.add_terrain(make_terrain(step + 1, shape=(4, 5)))
        except transport.TransportError as error:
            say("refused", step, error)
        else:
            say("acknowledged", step)
    say("waiting")
    sys.stdin.read()


if __name__ == "__main__":
    commands = {
        "node": run_node,
        "router": run_router,
        "zenohd": run_zenohd,
        "planner": run_planner,
        "viewer": run_viewer,
        "exit": run_exit,
        "record": run_record,
        "record_full": run_record_full,
    }
    commands[sys.argv[1]](*sys.argv[2:])

"""Two rooms with three robots each, a router per room, one above both, mutual TLS: who may do what, who outlives whom.

Every robot and router is a process of its own. Each robot is its own router and has an uplink to that of its room.
"""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import pytest

import transport
from tests.ports import free_port
from tests.transport.conftest import forked_program, starter
from transport import PerceptionClient, open_client
from transport.fleet import robot_states
from transport.keys import terrain_key
from transport.links.publisher import Publisher
from transport.security.certificates import add
from transport.security.folder import CONFIGURATION, init_security
from transport.security.router_folder import make_router

pytestmark = pytest.mark.soak

ROOMS = {"north": ("n1", "n2", "n3"), "south": ("s1", "s2", "s3")}
ROBOTS = tuple(robot for robots in ROOMS.values() for robot in robots)
PATIENCE = 60.0
# How long to wait for what must not arrive; what may arrive does so within milliseconds [s].
QUIET = 1.5


@dataclass
class Site:
    """Keys, endpoints and processes of all that runs."""

    keys: Path
    endpoints: dict[str, str]
    start: Callable
    processes: dict[str, object] = field(default_factory=dict)
    step: int = 0

    def run(self, name: str) -> None:
        if name in ROBOTS:
            room = next(room for room, robots in ROOMS.items() if name in robots)
            arguments = ("node", self.endpoints[name], "listen", str(self.keys / name), name, self.endpoints[room])
        else:
            arguments = ("zenohd", str(self.keys / name / CONFIGURATION))
        self.processes[name] = self.start(*arguments)

    def kill(self, name: str) -> None:
        self.processes.pop(name).kill()

    def publish(self, robots=ROBOTS) -> int:
        """The next pause of the robots; its step."""
        self.step += 1
        for robot in robots:
            if robot in self.processes:
                self.processes[robot].tell(f"publish {self.step}")
        return self.step

    def client(self, router: str, member: str, robot: str) -> PerceptionClient:
        session = open_client(self.endpoints[router], security=self.keys / member, timeout=PATIENCE)
        return PerceptionClient(session, robot=robot)


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Site]:
    """Six robots and three routers, each in a process."""

    keys = init_security(tmp_path_factory.mktemp("site") / "keys", robot=ROBOTS)
    ports = {name: free_port() for name in (*ROBOTS, "top", *ROOMS)}
    make_router(keys, ROBOTS, name="top", listen=f"tls/127.0.0.1:{ports['top']}")
    for room, robots in ROOMS.items():
        make_router(keys, robots, name=room, listen=f"tls/127.0.0.1:{ports[room]}", uplink="top")
    add(keys, "desk", "fleet")
    for start in starter(forked_program):
        made = Site(keys, {name: f"tls/localhost:{port}" for name, port in ports.items()}, start)
        for name in ports:
            made.run(name)
        yield made


# What each may do, by the table of docs/messages.md: where it connects, as whom, with which robot.
READ, SCAN, STANCE = "read", "scan", "stance"
MAY = {
    ("n1", "n1/planner", "n1"): {READ, SCAN},
    ("n1", "n1/viewer", "n1"): {READ},
    ("n1", "n1/gait", "n1"): {STANCE},
    ("n1", "n2/planner", "n1"): set(),
    ("n1", "desk", "n1"): set(),
    # A router dials as `viewer` at most, with its own keys and with those of its clients alike.
    ("n1", "north", "n1"): {READ},
    ("n1", "south", "n1"): set(),
    ("north", "n1/planner", "n1"): {READ},
    ("north", "n1/planner", "n2"): set(),
    ("north", "n1/gait", "n1"): set(),
    ("north", "s1/viewer", "s1"): set(),
    ("top", "n1/planner", "n1"): {READ},
    ("top", "s3/viewer", "s3"): {READ},
    ("top", "s3/viewer", "n3"): set(),
    ("top", "desk", "n1"): set(),
}


@pytest.mark.parametrize(("router", "member", "robot"), MAY)
def test_each_may_do_what_the_table_says_and_nothing_else(
    site: Site, peer, router: str, member: str, robot: str
) -> None:
    """Tried on the running site: reading the newest, asking, requesting a scan, announcing a pause, forging.

    What is not expected must not happen within a while; what is expected has all the time it needs.
    """
    expected, found = MAY[router, member, robot], set()
    site.publish([robot])
    with site.client(router, member, robot) as client:
        try:
            if client.wait_for_step(site.step, timeout=PATIENCE if READ in expected else QUIET).robot == robot:
                found.add(READ)
        except transport.TransportError:
            pass
        try:
            assert client.query(timeout=PATIENCE if READ in expected else QUIET).robot == robot and READ in found
        except transport.TransportError:
            assert READ not in found
        try:
            request = f"of-{member.replace('/', '-')}-{router}"
            client.request_scan(timeout=PATIENCE if SCAN in expected else QUIET, request_id=request)
            found.add(SCAN)
        except transport.TransportError:
            pass
        process = site.processes[robot]
        site.step += 1
        stance = transport.StancePublisher(client._session, robot=robot)
        stance.publish(
            transport.StancePause(robot=robot, step=10_000 + site.step, phase=1, stamp=1, stance=peer.make_stance())
        )
        try:
            process.expect(f"pause {10_000 + site.step}", PATIENCE if STANCE in expected else QUIET)
            found.add(STANCE)
        except AssertionError:
            pass
        forged = Publisher(client._session, terrain_key(robot), latched=False)
        with site.client(robot, f"{robot}/viewer", robot) as witness:
            receiver = witness.receiver()
            forged.put(b"forged")
            with pytest.raises(transport.ReceiveTimeout):
                receiver.wait_for(lambda _: receiver.rejected > 0, QUIET / 3)
            assert receiver.rejected == 0
    assert found == expected


def test_who_has_no_certificate_gets_no_link(site: Site) -> None:
    """Neither at a robot nor at a router."""
    for router in ("n1", "north", "top"):
        with pytest.raises(transport.ConnectionFailed):
            open_client(site.endpoints[router], timeout=0.5)


def test_the_fleet_is_seen_from_the_top(site: Site, eventually) -> None:
    """All six robots of both rooms, by a member that may see nothing else of them."""
    with open_client(site.endpoints["top"], security=site.keys / "desk", timeout=PATIENCE) as session:
        assert eventually(lambda: [state.robot for state in robot_states(session)] == list(ROBOTS))
        states = robot_states(session)
        assert all(state.health is transport.Health.OK and state.links >= 1 for state in states)
    with open_client(site.endpoints["top"], security=site.keys / "n1" / "viewer", timeout=PATIENCE) as session:
        assert [state.robot for state in robot_states(session, robots=["n1", "n2"])] == ["n1"]
        with pytest.raises(transport.ScannerUnavailable, match="the role `fleet` sees all"):
            robot_states(session)


@pytest.mark.parametrize("victim", ["n1", "north", "top", "planner", "s3", "south"])
def test_killing_any_one_leaves_the_others_served(site: Site, victim: str) -> None:
    """Each robot's own planner gets every pause, and so do readers that the victim does not connect; then all again."""
    planner = None
    if victim == "planner":
        planner = site.start("viewer", site.endpoints["n2"], str(site.keys / "n2" / "planner"), "n2")
    with ExitStack() as stack:
        readers = {}
        for room, robots in ROOMS.items():
            for robot in robots:
                for router, member in ((robot, "planner"), (room, "viewer"), ("top", "viewer")):
                    routers = {"top": {robot, room, "top"}, room: {robot, room}, robot: {robot}}[router]
                    client = stack.enter_context(site.client(router, f"{robot}/{member}", robot))
                    readers[router, robot] = (client, routers)
        first = site.publish()
        _all_get(readers.values(), first)
        if planner is not None:
            planner.expect(f"got footprint {first}")
            planner.kill()
        else:
            site.kill(victim)
        untouched = [(client, routers) for client, routers in readers.values() if victim not in routers]
        assert len(untouched) >= 9
        for _ in range(3):
            _all_get(untouched, site.publish())
        if planner is None:
            site.run(victim)
        _all_get(readers.values(), site.publish())


def _all_get(readers, step: int) -> None:
    for client, _ in readers:
        assert client.wait_for_step(step, timeout=PATIENCE).step == step

"""Several robots by one CA: the names in their certificates, and routers that serve them, as a stock `zenohd` would."""

import contextlib
import json
from pathlib import Path

import pytest
from cryptography import x509

import transport
from tests.ports import free_port
from transport import SecurityError, zenoh_api
from transport.keys import summary_key, terrain_key
from transport.links.publisher import Publisher
from transport.security.access_rules import ROLES
from transport.security.authority import Credentials, make_certificate
from transport.security.certificates import add, add_robot, renew, revoke
from transport.security.folder import CONFIGURATION, configured_endpoints, init_security
from transport.security.router_folder import make_router
from transport.security_check import check_router, check_security


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two robots, a router for both, one below it for the first, and a watcher of the fleet; never changed."""
    folder = tmp_path_factory.mktemp("site") / "keys"
    make_router(folder, ["rex", "ada"], name="top")
    make_router(folder, ["rex"], name="room", uplink="top")
    add(folder, "desk", "fleet")
    return folder


def _wrong(permissions) -> set[tuple[str, str, bool]]:
    return {(p.role, p.action, p.allowed) for p in permissions if p.allowed != p.expected}


def _may(permissions, role: str) -> set[str]:
    return {p.action for p in permissions if p.role == role and p.allowed}


def test_certificates_are_named_after_robot_and_role(site: Path) -> None:
    """One CA signs all; each machine's folder holds nothing of another."""
    authority = x509.load_pem_x509_certificate((site / "ca" / "ca.pem").read_bytes())
    folders = {f"{robot}.{role}": site / robot / role for robot in ("rex", "ada") for role in ROLES}
    folders |= {"top.router": site / "top", "room.router": site / "room", "desk.fleet": site / "desk"}
    for name, folder in folders.items():
        certificate = x509.load_pem_x509_certificate((folder / f"{folder.name}.pem").read_bytes())
        certificate.verify_directly_issued_by(authority)
        assert certificate.subject.rfc4514_string() == f"CN={name}"
        assert (folder / f"{folder.name}.key").stat().st_mode & 0o777 == 0o600
        assert not list(folder.glob("**/ca.key"))


@pytest.mark.slow
def test_the_rules_of_nodes_are_as_meant(site: Path) -> None:
    """Another robot's planner and node get a link and nothing on it; a router reads and can trigger nothing."""
    permissions = check_security(site, robot="rex")
    assert _wrong(permissions) == set()
    assert _may(permissions, "ada.planner") == _may(permissions, "ada.node") == {"connect"}
    assert _may(permissions, "top.router") == _may(permissions, "viewer")


@pytest.mark.slow
@pytest.mark.parametrize(("router", "robot"), [("top", "rex"), ("top", "ada"), ("room", "rex")])
def test_the_rules_of_routers_are_as_meant(site: Path, router: str, robot: str) -> None:
    """Each robot's roles do there what they do at its node; the router below brings its own robot's grids only."""
    permissions = check_router(site, router, robot=robot)
    assert _wrong(permissions) == set()
    other = "ada" if robot == "rex" else "rex"
    assert _may(permissions, f"{other}.planner") == {"connect"}
    assert "request a scan" in _may(permissions, "planner")
    if router == "top":
        assert ("forge grids" in _may(permissions, "room.router")) == (robot == "rex")
    else:
        assert _may(permissions, "top.router") == _may(permissions, "viewer")
    assert _may(permissions, "desk.fleet") == {"connect", "see the status"}


@pytest.mark.slow
def test_scans_through_a_router_are_allowed_only_where_asked_for(tmp_path: Path) -> None:
    """With `scans` a router may trigger at nodes that dial it, and pass on what comes from above."""
    folder = tmp_path / "keys"
    make_router(folder, ["rex"], name="top")
    make_router(folder, ["rex"], name="room", uplink="top", scans=True)
    at_node, at_room = check_security(folder), check_router(folder, "room")
    assert _wrong(at_node) == _wrong(at_room) == set()
    assert "request a scan" in _may(at_node, "room.router") and "request a scan" not in _may(at_node, "top.router")
    assert "request a scan" in _may(at_room, "top.router")


@pytest.mark.slow
def test_a_thin_link_carries_summaries_and_status_alone(start, tmp_path: Path) -> None:
    """Above the room a viewer gets the summary and the status, no grid, and no key of one is declared there."""
    folder, ports = tmp_path / "keys", (free_port(), free_port())
    make_router(folder, ["rex"], name="top", listen=f"tls/127.0.0.1:{ports[0]}")
    make_router(folder, ["rex"], name="room", listen=f"tls/127.0.0.1:{ports[1]}", uplink="top", summary_only=True)
    assert _wrong(check_router(folder, "room")) == set()
    top, room = (f"tls/localhost:{port}" for port in ports)
    for name in ("top", "room"):
        start("zenohd", str(folder / name / CONFIGURATION))
    with (
        transport.open_node(connect=room, security=folder, timeout=20.0) as node,
        transport.open_client(top, security=folder / "viewer", timeout=20.0) as far,
    ):
        summaries = Publisher(node, summary_key("rex"), latched=False)
        Publisher(node, terrain_key("rex")).put(b"grid")
        small = transport.NewestReceiver(far, summary_key("rex"), bytes, latched=False)
        large = transport.NewestReceiver(far, terrain_key("rex"), bytes)
        with pytest.raises(transport.ReceiveTimeout):
            large.wait_for(lambda _: True, 1.5)
        for _ in range(30):
            summaries.put(b"summary")
            with contextlib.suppress(transport.ReceiveTimeout):
                small.wait_for(lambda _: True, 1.0)
                break
        assert small.latest().message == b"summary" and large.latest() is None


@pytest.mark.slow
def test_a_zenoh_router_takes_the_configuration_as_it_stands(start, tmp_path: Path) -> None:
    """Read from its file by Zenoh itself, in another process: robots dial in, readers read, others do not."""
    folder, port = tmp_path / "keys", free_port()
    made = make_router(folder, ["rex", "ada"], listen=f"tls/127.0.0.1:{port}")
    endpoint = f"tls/localhost:{port}"
    start("zenohd", str(made / CONFIGURATION))
    with transport.open_node(connect=endpoint, security=folder / "rex", timeout=20.0) as node:
        Publisher(node, terrain_key("rex")).put(b"grid of rex")
        for reader, hears in (("rex/planner", True), ("rex/viewer", True), ("ada/planner", False)):
            with transport.open_client(endpoint, security=folder / reader, timeout=20.0) as session:
                receiver = transport.NewestReceiver(session, terrain_key("rex"), bytes)
                if hears:
                    assert receiver.wait_for(lambda _: True, 20.0).message == b"grid of rex"
                else:
                    with pytest.raises(transport.ReceiveTimeout):
                        receiver.wait_for(lambda _: True, 1.5)


def test_the_files_lie_where_the_router_will_run(tmp_path: Path) -> None:
    """Paths in the configuration are absolute: in the folder where it was made, or in the folder that was given."""
    here = make_router(tmp_path / "keys", ["rex"])
    there = make_router(tmp_path / "keys", ["rex"], name="top", place="/etc/zenohd/")
    for made, lies_in in ((here, str(here)), (there, "/etc/zenohd")):
        tls = json.loads((made / CONFIGURATION).read_text())["transport"]["link"]["tls"]
        files = {value for value in tls.values() if isinstance(value, str)}
        assert files == {f"{lies_in}/{name}" for name in ("ca.pem", f"{made.name}.pem", f"{made.name}.key")}
        assert zenoh_api.configuration_value((made / CONFIGURATION).read_text(), "mode") == "router"
    # A member that is added or revoked later changes its rules, though its files lie elsewhere.
    second = add(tmp_path / "keys", "second", "planner")
    assert '"rex.second"' in (there / CONFIGURATION).read_text()
    assert revoke(tmp_path / "keys", "second") == (tmp_path / "keys" / "node", here, there) and second.is_dir()


def test_names_never_stand_for_two(site: Path, tmp_path: Path) -> None:
    """A member cannot take the name in another's certificate; robots, routers and watchers share one set of names."""
    for name in ("rex.router", "rex.fleet", "rex.planner"):
        with pytest.raises(SecurityError, match="is reserved, taken or revoked"):
            add(site, name, "planner")
    for name in ("rex", "top", "desk"):
        with pytest.raises(SecurityError, match="is reserved, taken or revoked"):
            add_robot(site, name)
        with pytest.raises(SecurityError, match="is reserved, taken or revoked"):
            make_router(site, ["rex"], name=name)
        with pytest.raises(SecurityError, match="is reserved, taken or revoked"):
            add(site, name, "fleet")
    with pytest.raises(SecurityError, match="'rex.p+' is too long"):
        add(site, "rex." + "p" * 60, "planner")
    with pytest.raises(SecurityError, match="does not serve 'ada'; it serves rex"):
        check_router(site, "room", robot="ada")
    with pytest.raises(SecurityError, match="has no router 'hall'"):
        check_router(site, "hall")
    with pytest.raises(SecurityError, match="give each robot once"):
        init_security(tmp_path / "twice", robot=["rex", "rex"])
    with pytest.raises(SecurityError, match="hosts given: 1, robots: 2"):
        init_security(tmp_path / "hosts", robot=["rex", "ada"], hosts=["rex.local"])
    with pytest.raises(SecurityError, match="give at least one"):
        make_router(site, [], name="hall")


def test_who_is_shut_out_is_so_everywhere(tmp_path: Path) -> None:
    """The rules of the node and of every router of the robot lose the name; other robots' rules do not change."""
    folder = tmp_path / "keys"
    make_router(folder, ["rex", "ada"], name="top")
    make_router(folder, ["rex"], name="room", uplink="top")
    add(folder, "rex.second", "planner")
    before = (folder / "ada" / "node" / CONFIGURATION).read_bytes()
    assert revoke(folder, "rex.planner") == tuple(folder / name for name in ("rex/node", "top", "room"))
    assert revoke(folder, "room.router") == (folder / "rex" / "node", folder / "top")
    assert (folder / "ada" / "node" / CONFIGURATION).read_bytes() == before
    for member in ("rex/node", "top", "room"):
        text = (folder / member / CONFIGURATION).read_text()
        assert '"rex.second"' in text and '"rex.planner"' not in text and '"room.router"' not in text
    with pytest.raises(SecurityError, match=r"room\.router was revoked"):
        renew(folder, ("room",))
    with pytest.raises(SecurityError, match="has no router 'room' for the uplink; routers: top"):
        make_router(folder, ["rex"], name="hall", uplink="room")


def test_a_folder_that_cannot_be_changed_is_left_as_it_was(tmp_path: Path) -> None:
    """Where one configuration was edited beyond reading, nobody is added or revoked, and names stay free."""
    folder = tmp_path / "keys"
    make_router(folder, ["rex", "ada"], name="top")
    path = folder / "top" / CONFIGURATION
    whole = path.read_text()
    path.write_text("// by hand\n" + whole)
    before = {each: each.read_bytes() for each in folder.rglob("*") if each.is_file()}
    for change in (
        lambda: add(folder, "rex.second", "planner"),
        lambda: add(folder, "desk", "fleet"),
        lambda: add_robot(folder, "bob"),
        lambda: make_router(folder, ["rex"], name="room", uplink="top"),
        lambda: revoke(folder, "rex.planner"),
    ):
        with pytest.raises(SecurityError, match=r"cannot change .*top/zenoh\.json5"):
            change()
        assert {each: each.read_bytes() for each in folder.rglob("*") if each.is_file()} == before
    path.write_text(whole)
    assert add(folder, "rex.second", "planner").is_dir() and add_robot(folder, "bob").is_dir()


@pytest.mark.slow
def test_the_check_sees_forged_grids_whoever_is_shut_out(tmp_path: Path) -> None:
    """A reader that is left looks for them; where none is left, the check says so instead of "no"."""
    folder = tmp_path / "keys"
    make_router(folder, ["rex"], name="top")
    make_router(folder, ["rex"], name="room", uplink="top")
    revoke(folder, "viewer")
    permissions = check_router(folder, "top")
    assert _wrong(permissions) == set() and "forge grids" in _may(permissions, "room.router")
    revoke(folder, "planner")
    with pytest.raises(SecurityError, match="no planner or viewer of rex is left"):
        check_router(folder, "top")
    add(folder, "second", "viewer")
    assert _wrong(check_router(folder, "top")) == set()


@pytest.mark.slow
def test_role_folders_of_an_earlier_version_go_on_working(tmp_path: Path) -> None:
    """Names are the roles alone: all keep their rights; members that are added or renewed get such names too."""
    folder = init_security(tmp_path / "keys")
    ca = Credentials((folder / "ca" / "ca.pem").read_bytes(), (folder / "ca" / "ca.key").read_bytes())
    for role in ROLES:
        made = make_certificate(ca, role, ["localhost", "127.0.0.1"])
        (folder / role / f"{role}.pem").write_bytes(made.certificate)
        (folder / role / f"{role}.key").write_bytes(made.key)
    path = folder / "node" / CONFIGURATION
    path.write_text(path.read_text().replace('"guara.', '"'))
    (folder / "ca" / "members.json").write_text('{"added": {}, "revoked": []}')
    before = path.read_bytes()
    assert _wrong(check_security(folder)) == set()
    renew(folder)
    assert path.read_bytes() == before
    second = add(folder, "planner-2", "planner")
    names = x509.load_pem_x509_certificate((second / "planner-2.pem").read_bytes()).subject.rfc4514_string()
    assert names == "CN=planner-2" and '"planner-2"' in path.read_text()
    make_router(folder, ["guara", "rex"])
    assert _wrong(check_security(folder, robot="guara")) == _wrong(check_router(folder, "router")) == set()


def test_a_router_of_a_hundred_robots_is_made(tmp_path: Path) -> None:
    folder = make_router(tmp_path / "keys", [f"robot{number:03d}" for number in range(100)])
    assert configured_endpoints(folder, "listen")

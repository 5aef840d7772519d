"""`guara security`: members are renewed, added and revoked, and doctor and status report on the folder."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from guara_perception.app.node.node_status import certificates_item
from transport import Health, init_security, open_client
from transport.client import PerceptionClient
from transport.security.authority import Credentials, make_certificate
from transport.security.folder import CONFIGURATION

GUARA = ("-m", "guara_perception.app.main")
PATIENCE = 180.0


@pytest.fixture
def keys(tmp_path: Path) -> Path:
    return init_security(tmp_path / "keys")


def _give(keys: Path, name: str, days: int) -> None:
    """Replace a certificate by one that expires in `days` days."""
    ca = Credentials((keys / "ca" / "ca.pem").read_bytes(), (keys / "ca" / "ca.key").read_bytes())
    made = make_certificate(ca, name, [name, "localhost"], days=days)
    (keys / name / f"{name}.pem").write_bytes(made.certificate)
    (keys / name / f"{name}.key").write_bytes(made.key)


def test_renew_says_whom_and_what_to_do(guara, keys: Path) -> None:
    """All members, or the named ones, get new keys with mode 600."""
    before = (keys / "viewer" / "viewer.key").read_bytes()
    said = guara("security", "renew", keys)
    assert said.code == 0 and said.err == ""
    assert said.out == (
        "renewed: node, gait, planner, viewer; copy each folder to its machine again and restart the programs there\n"
    )
    after = (keys / "viewer" / "viewer.key").read_bytes()
    assert guara("security", "renew", keys, "planner").out.startswith("renewed: planner; copy")
    assert before != after == (keys / "viewer" / "viewer.key").read_bytes()
    assert (keys / "viewer" / "viewer.key").stat().st_mode & 0o777 == 0o600


def test_add_and_revoke_say_what_to_copy(guara, keys: Path) -> None:
    """A second planner is added and the first revoked; the node's rules contain only the second."""
    said = guara("security", "add", keys, "planner-2")
    assert said.code == 0 and f"{keys / 'planner-2'}: for the new planner; copy {keys / 'node'}" in said.out
    said = guara("security", "revoke", keys, "planner")
    assert said.code == 0 and said.out.startswith(f"copy {keys / 'node'} to the machines again")
    subjects = json.loads((keys / "node" / CONFIGURATION).read_text())["access_control"]["subjects"]
    names = {subject["id"]: subject["cert_common_names"] for subject in subjects}
    assert names["planner"] == ["guara.planner-2"] and names["viewer"] == ["guara.viewer"]
    assert guara("security", "renew", keys).out.startswith("renewed: node, gait, viewer, planner-2;")


@pytest.mark.parametrize(
    ("arguments", "reported"),
    [
        (["router", "KEYS", "--robot", "guara", "--robot", "r/x"], "r/x"),
        (["router", "KEYS", "--robot", "node"], "robot name 'node' is too long or reserved"),
        (["router", "KEYS", "--robot", "r" * 32], "allowed: at most 31 characters"),
        (["router", "KEYS", "--robot", "guara", "--name", "ca"], "the name 'ca' is reserved, taken or revoked"),
        (["router", "KEYS", "--robot", "guara", "--name", "r" * 32], "is too long for a certificate"),
        (
            ["router", "KEYS", "--robot", "guara", "--uplink", "site"],
            "has no router 'site' for the uplink; routers: none",
        ),
        (["router", "KEYS", "--robot", "guara", "--listen", "tcp/0.0.0.0:1"], "is not encrypted"),
        (["router", "KEYS", "--robot", "guara", "--summary-only"], "restricts what the router above receives"),
        (["router", "KEYS"], "Missing option '--robot'"),
        (["robot", "KEYS", "guara"], "the name 'guara' is reserved, taken or revoked"),
        (["robot", "NOWHERE", "rex"], "cannot read the CA of"),
        (["check", "NOWHERE"], "nowhere' does not exist"),
        (["check", "KEYS", "--robot", "rex"], "has no robot 'rex'; robots: guara"),
        (["add", "KEYS", "router"], "the name 'router' is reserved, taken or revoked"),
        (["add", "KEYS", "rex.planner-2"], "write ROBOT.planner-2, where ROBOT is one of"),
        (["renew", "KEYS", "rex"], "has no member 'rex'; members: node, gait, planner, viewer"),
        (["renew", "NOWHERE"], "cannot read the CA of"),
        (["add", "KEYS", "viewer"], "the name 'viewer' is reserved, taken or revoked"),
        (["add", "KEYS", "a/b"], "a/b"),
        (["add", "KEYS", "second", "--role", "node"], "'node' is not one of"),
        (["add", "NOWHERE", "second"], "cannot read the CA of"),
        (["revoke", "KEYS", "node"], "the node cannot be revoked"),
        (["revoke", "KEYS", "rex"], "has no member 'rex'"),
    ],
)
def test_mistakes_end_in_one_line(guara, keys: Path, tmp_path: Path, arguments: list[str], reported: str) -> None:
    """Exit 2, and the folder is unchanged."""
    before = sorted(path.relative_to(keys) for path in keys.rglob("*"))
    given = {"KEYS": keys, "NOWHERE": tmp_path / "nowhere"}
    said = guara("security", *(given.get(word, word) for word in arguments))
    assert said.code == 2 and reported in said.err and said.err.count("\n") == 1 and said.out == ""
    assert sorted(path.relative_to(keys) for path in keys.rglob("*")) == before


FLAWS: dict[str, tuple[Callable[[Path], None], Health, str, str, int]] = {
    "none": (lambda keys: None, Health.OK, "ok", "certificates, the first expires in", 0),
    "31 days left": (lambda keys: _give(keys, "node", 31), Health.OK, "ok", "expires in 31 days (node/node.pem)", 0),
    "29 days left": (lambda keys: _give(keys, "node", 29), Health.WARN, "warn", "node/node.pem expires in 29 days", 0),
    "expired": (lambda keys: _give(keys, "node", -2), Health.ERROR, "FAIL", "node/node.pem expired 2 days ago", 1),
    "readable": (
        lambda keys: (keys / "node" / "node.key").chmod(0o640),
        Health.ERROR,
        "FAIL",
        "node/node.key can be read by others on this machine; run chmod 600 on it",
        1,
    ),
}


@pytest.mark.parametrize("flaw", FLAWS)
def test_doctor_and_status_warn_in_time(guara, keys: Path, flaw: str) -> None:
    """Doctor and status use the same words; doctor exits 1 only if nothing would start."""
    make, level, word, reported, code = FLAWS[flaw]
    make(keys)
    item = certificates_item(keys)
    assert item.name == "certificates" and item.level is level and reported in item.message
    said = guara("doctor", "--only", "certificates", "--security", keys)
    assert said.code == code and said.out.startswith(word) and reported in said.out


def test_doctor_says_when_it_was_given_no_folder(guara, tmp_path: Path) -> None:
    """A skipped check is not reported as "ok"; an empty folder is not a security folder."""
    assert guara("doctor", "--only", "certificates").out.startswith("skip")
    said = guara("doctor", "--only", "certificates", "--security", tmp_path)
    assert said.code == 1 and "contains no certificate" in said.out


@pytest.mark.slow
@pytest.mark.parametrize(("arguments", "key"), [(["listen"], "planner"), (["run", "--simulated"], "node")])
def test_keys_that_others_can_read_start_nothing(guara, keys: Path, arguments: list[str], key: str) -> None:
    """Node and planner refuse such keys in one line that names the remedy."""
    (keys / key / f"{key}.key").chmod(0o644)
    said = guara(*arguments, "--security", keys)
    assert said.code == 2 and f"{key}.key has mode 644" in said.err and "chmod 600" in said.err
    assert said.err.count("\n") == 1


@pytest.mark.slow
def test_a_running_node_warns_planners(start, keys: Path, free_endpoint: str, eventually) -> None:
    """A planner's status over TLS names the certificate that expires soon."""
    _give(keys, "node", 20)
    endpoint = free_endpoint.replace("tcp/127.0.0.1", "tls/localhost")
    node = start(*GUARA, "run", "--simulated", "--mode", "coarse", "--security", keys / "node", "--listen", endpoint)
    assert node.line(PATIENCE) == f"guara: listening on {endpoint}; press Ctrl-C to stop"
    with PerceptionClient(open_client(endpoint, security=keys / "planner", timeout=PATIENCE)) as client:
        assert eventually(lambda: client.status() is not None and client.status().item("certificates") is not None)
        item = client.status().item("certificates")
    assert item.level is Health.WARN and "node.pem expires in 20 days" in item.message
    assert node.interrupt() == 0


@pytest.mark.slow
def test_a_router_for_several_robots_says_what_to_do(guara, tmp_path: Path) -> None:
    """CA, robots and router first; then a router below it, another robot, a fleet member, and all revoked."""
    site = tmp_path / "site"
    said = guara("security", "router", site, "--robot", "rex", "--robot", "ada", "--name", "top", "--host", "top.local")
    assert said.code == 0 and f"{site / 'top'}: for rex, ada; start it with: zenohd -c" in said.out
    assert "with a folder per role: rex, ada" in said.out and "copy the node folder" in said.out
    said = guara("security", "router", site, "--robot", "rex", "--name", "room", "--uplink", "top")
    assert said.code == 0 and "added to" not in said.out and "and the folder of top to" in said.out
    room = json.loads((site / "room" / CONFIGURATION).read_text())
    assert room["connect"]["endpoints"] == ["tls/top.local:7447"]
    said = guara("security", "router", site, "--robot", "bob", "--name", "hall", "--uplink", "top")
    assert said.code == 2 and "router 'top' does not serve bob" in said.err and not (site / "hall").exists()
    assert guara("security", "robot", site, "bob").out.startswith(f"{site / 'bob'}: node, gait, planner, viewer")
    said = guara("security", "add", site, "rex.planner-2")
    assert f"copy {site / 'rex' / 'node'}" in said.out and "also copy the folders of these routers" in said.out
    said = guara("security", "add", site, "desk", "--role", "fleet")
    expected = (
        f"{site / 'desk'}: for the new fleet member; copy the folders of the routers again and restart the routers"
    )
    assert said.out.strip() == expected
    assert "write ROBOT.planner-3, where ROBOT is one of" in guara("security", "add", site, "planner-3").err
    said = guara("security", "revoke", site, "rex.planner")
    changed = ", ".join(str(site / name) for name in ("rex/node", "top", "room"))
    assert said.out.startswith(f"copy {changed} to the machines again") and "rex.planner keeps its access" in said.out
    assert "was already revoked" in guara("security", "revoke", site, "rex.planner").out
    assert str(site / "top") in guara("security", "revoke", site, "room").out
    renewed = guara("security", "renew", site).out
    assert "ada.planner," in renewed and "top.router, desk.fleet;" in renewed
    assert "room.router" not in renewed and "rex.planner," not in renewed
    assert certificates_item(site).level is Health.OK


@pytest.mark.slow
def test_the_check_of_a_site_tries_nodes_and_routers(guara, tmp_path: Path) -> None:
    """Each node and router is named; a planner reaches only its own robot; exit 0 if all rights are as expected."""
    site = tmp_path / "site"
    assert guara("security", "router", site, "--robot", "rex", "--robot", "ada").code == 0
    said = guara("security", "check", site, "--robot", "rex")
    assert said.code == 0, said.out
    assert said.out.startswith("node of rex:\n") and "\nrouter router, robot rex:\n" in said.out
    assert said.out.count("ada.planner") == 2 and "!" not in said.out

"""Certificates live and end: renewed, added, revoked, warned of; keys that others can read are refused."""

import json
import time
from pathlib import Path

import pytest

import transport
from transport import Health, SecurityError, clock
from transport.configuration import QUEUES
from transport.keys import status_key, terrain_key
from transport.links.publisher import Publisher
from transport.security.authority import Credentials, make_certificate
from transport.security.certificates import add, days_left, judge_security, renew, revoke
from transport.security.folder import CONFIGURATION


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return transport.init_security(tmp_path / "keys", hosts=["robot.example"])


def _secured(endpoint: str) -> str:
    return endpoint.replace("tcp/127.0.0.1", "tls/localhost")


def _hears(endpoint: str, role: Path, expected: bool) -> bool:
    with transport.open_client(_secured(endpoint), security=role, timeout=20.0) as session:
        receiver = transport.NewestReceiver(session, terrain_key(), bytes)
        try:
            return receiver.wait_for(lambda _: True, 20.0 if expected else 1.5).message == b"grid"
        except transport.ReceiveTimeout:
            return False


@pytest.mark.slow
def test_an_added_member_gets_in_and_one_that_was_shut_out_gets_nothing(endpoint: str, folder: Path) -> None:
    """A second planner reads; the first, stolen, connects and reads nothing, also with a new certificate."""
    second = add(folder, "planner-2", "planner")
    revoke(folder, "planner")
    with transport.open_node(listen=_secured(endpoint), security=folder) as session:
        Publisher(session, terrain_key()).put(b"grid")
        assert _hears(endpoint, second, True)
        assert not _hears(endpoint, folder / "planner", False)
    with pytest.raises(SecurityError, match="planner was revoked"):
        renew(folder, ("planner",))
    for name in ("planner", "planner-2", "ca"):
        with pytest.raises(SecurityError, match="is reserved, taken or revoked"):
            add(folder, name, "planner")


@pytest.mark.slow
def test_renewed_members_get_in_and_keep_their_names(endpoint: str, folder: Path) -> None:
    """New keys by the same CA, for all or for one; the node still answers to its host."""
    before = (folder / "viewer" / "viewer.pem").read_bytes()
    assert renew(folder) == ("node", "gait", "planner", "viewer")
    assert renew(folder, ("viewer",)) == ("viewer",)
    assert (folder / "viewer" / "viewer.pem").read_bytes() != before
    assert (folder / "node" / "node.key").stat().st_mode & 0o777 == 0o600
    with transport.open_node(listen=_secured(endpoint), security=folder) as session:
        Publisher(session, terrain_key()).put(b"grid")
        assert _hears(endpoint, folder / "viewer", True)


def test_the_end_of_a_certificate_is_said_in_time(folder: Path) -> None:
    """More than 30 days left: well; less: a warning; none: expired."""
    assert judge_security(folder)[0] is judge_security(folder / "node")[0] is Health.OK
    ca = Credentials((folder / "ca" / "ca.pem").read_bytes(), (folder / "ca" / "ca.key").read_bytes())
    ends = {20: (Health.WARN, "expires in 20 days"), -3: (Health.ERROR, "expired 3 days ago")}
    for days, (level, reported) in ends.items():
        (folder / "gait" / "gait.pem").write_bytes(make_certificate(ca, "gait", ["gait"], days=days).certificate)
        assert abs(days_left(folder / "gait" / "gait.pem") - days) < 0.1
        found, message = judge_security(folder)
        assert found is level and f"gait/gait.pem {reported}" in message and "guara security renew" in message


def test_a_key_that_others_can_read_is_refused(endpoint: str, folder: Path) -> None:
    """Nothing starts with it; the message says what to do."""
    (folder / "planner" / "planner.key").chmod(0o644)
    with pytest.raises(SecurityError, match="planner.key has mode 644.*chmod 600"):
        transport.open_client(_secured(endpoint), security=folder / "planner", timeout=0.1)


def _make_old(folder: Path) -> None:
    """As an earlier version made it: nobody may ask for the status, nothing is said of what waits for a link."""
    for role in ("node", "planner"):
        path = folder / role / CONFIGURATION
        configuration = json.loads(path.read_text())
        del configuration["transport"]["link"]["tx"]["queue"]["size"]
        configuration["transport"]["link"]["tx"]["lease"] = 1500
        if role == "node":
            access = configuration["access_control"]
            access["rules"] = [rule for rule in access["rules"] if rule["id"] != "claim"]
            access["subjects"] = [subject for subject in access["subjects"] if subject["id"] != "node"]
            access["policies"] = [policy for policy in access["policies"] if policy["subjects"] != ["node"]]
            (ask,) = [rule for rule in access["rules"] if rule["id"] == "ask"]
            ask["key_exprs"].remove(status_key("guara"))
        path.write_text(json.dumps(configuration))


@pytest.mark.slow
def test_a_folder_of_an_earlier_version_works_and_says_so_until_it_is_renewed(
    endpoint: str, peer, folder: Path, caplog
) -> None:
    """Planners get grids but not the node's clock: ages by the wall clocks, and a warning; `renew` mends it."""
    _make_old(folder)
    level, message = judge_security(folder / "node")
    assert level is Health.WARN and "the access rules were made by another version" in message
    for is_renewed in (False, True):
        with transport.open_node(listen=_secured(endpoint), security=folder) as session:
            server = transport.PerceptionServer(session)
            metadata = json.dumps({"run": server.run, "scan_end_clock": clock.now()})
            server.publish(peer.make_terrain(1, stamp=time.time_ns(), metadata=metadata))
            with transport.open_client(_secured(endpoint), security=folder / "planner", timeout=20.0) as other:
                client = transport.PerceptionClient(other)
                assert client.wait_for_step(1, timeout=20.0, max_age=60.0).sequence == 1
                assert (client.clock_offset is not None) == is_renewed
        assert ("does not report its clock" in caplog.text) != is_renewed
        caplog.clear()
        if not is_renewed:
            renew(folder)
            assert judge_security(folder)[0] is Health.OK
            tx = json.loads((folder / "planner" / CONFIGURATION).read_text())["transport"]["link"]["tx"]
            # What its owner had changed stays.
            assert tx["lease"] == 1500 and tx["queue"]["size"] == QUEUES


def test_mistakes_are_reported(folder: Path, tmp_path: Path) -> None:
    """No such member, no CA, a role that cannot be shared."""
    with pytest.raises(SecurityError, match="no member 'rex'; members: node, gait"):
        revoke(folder, "rex")
    with pytest.raises(SecurityError, match="cannot be revoked"):
        revoke(folder, "node")
    with pytest.raises(SecurityError, match="role is 'node'"):
        add(folder, "node-2", "node")
    with pytest.raises(SecurityError, match="cannot read the CA"):
        renew(tmp_path)

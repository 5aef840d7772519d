"""Certificates live and end: renewed, added, shut out, warned of; keys that others can read are refused."""

from pathlib import Path

import pytest

import transport
from transport import SecurityError
from transport.authority import Credentials, make_certificate
from transport.certificates import add, days_left, judge_expiries, renew, revoke
from transport.keys import terrain_key
from transport.publisher import Publisher


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


def test_an_added_member_gets_in_and_one_that_was_shut_out_gets_nothing(endpoint: str, folder: Path) -> None:
    """A second planner reads; the first, stolen, connects and reads nothing, also with a new certificate."""
    second = add(folder, "planner-2", "planner")
    revoke(folder, "planner")
    with transport.open_node(listen=_secured(endpoint), security=folder) as session:
        Publisher(session, terrain_key()).put(b"grid")
        assert _hears(endpoint, second, True)
        assert not _hears(endpoint, folder / "planner", False)
    with pytest.raises(SecurityError, match="planner was shut out"):
        renew(folder, ("planner",))
    for name in ("planner", "planner-2", "ca"):
        with pytest.raises(SecurityError, match="is taken or was shut out"):
            add(folder, name, "planner")


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
    assert judge_expiries(folder)[0] and judge_expiries(folder / "node")[0]
    ca = Credentials((folder / "ca" / "ca.pem").read_bytes(), (folder / "ca" / "ca.key").read_bytes())
    for days, told in ((20, "gait/gait.pem expires in 20 days"), (-3, "gait/gait.pem expired 3 days ago")):
        (folder / "gait" / "gait.pem").write_bytes(make_certificate(ca, "gait", ["gait"], days=days).certificate)
        assert abs(days_left(folder / "gait" / "gait.pem") - days) < 0.1
        is_well, message = judge_expiries(folder)
        assert not is_well and told in message and "guara security renew" in message


def test_a_key_that_others_can_read_is_refused(endpoint: str, folder: Path) -> None:
    """Nothing starts with it; the message says what to do."""
    (folder / "planner" / "planner.key").chmod(0o644)
    with pytest.raises(SecurityError, match="planner.key has mode 644.*chmod 600"):
        transport.open_client(_secured(endpoint), security=folder / "planner", timeout=0.1)


def test_mistakes_are_told(folder: Path, tmp_path: Path) -> None:
    """No such member, no CA, a role that cannot be shared."""
    with pytest.raises(SecurityError, match="no member 'rex'; members: node, gait"):
        revoke(folder, "rex")
    with pytest.raises(SecurityError, match="cannot be shut out of itself"):
        revoke(folder, "node")
    with pytest.raises(SecurityError, match="role is 'node'"):
        add(folder, "node-2", "node")
    with pytest.raises(SecurityError, match="cannot read the CA"):
        renew(tmp_path)

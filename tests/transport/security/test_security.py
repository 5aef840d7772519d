"""Tests of certificates, roles and the security folder."""

import json
import stat
from pathlib import Path

import pytest
from cryptography import x509

import transport
from transport import ConfigurationError, SecurityError
from transport.security.access_rules import ROLES
from transport.security.authority import Credentials, make_authority, make_certificate
from transport.security.folder import configured_endpoints, configured_robot, load_configuration, role_folder
from transport.security_check import EXPECTED, check_security, format_matrix


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A security folder; made once, never changed."""
    return transport.init_security(tmp_path_factory.mktemp("security") / "keys")


def _secure(endpoint: str) -> str:
    return endpoint.replace("tcp/127.0.0.1", "tls/localhost")


def test_each_role_gets_its_own_folder(folder: Path) -> None:
    """CA and roles have certificate, configuration and a key that only its owner reads."""
    assert sorted(path.name for path in folder.iterdir()) == sorted([*ROLES, "ca"])
    authority = x509.load_pem_x509_certificate((folder / "ca" / "ca.pem").read_bytes())
    for role in ROLES:
        certificate = x509.load_pem_x509_certificate((folder / role / f"{role}.pem").read_bytes())
        certificate.verify_directly_issued_by(authority)
        assert certificate.subject.rfc4514_string() == f"CN=guara.{role}"
        assert stat.S_IMODE((folder / role / f"{role}.key").stat().st_mode) == 0o600
        assert json.loads((folder / role / "zenoh.json5").read_text())
        assert not (folder / role / "ca.key").exists()
    assert stat.S_IMODE((folder / "ca" / "ca.key").stat().st_mode) == 0o600


def test_the_node_is_known_by_its_hosts(tmp_path: Path) -> None:
    """The node's certificate names the hosts that were given, names and addresses, beside localhost."""
    made = transport.init_security(tmp_path / "s", hosts=["robot.example", "192.168.1.9"])
    certificate = x509.load_pem_x509_certificate((made / "node" / "node.pem").read_bytes())
    names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert {"robot.example", "localhost"} <= set(names.get_values_for_type(x509.DNSName))
    assert "192.168.1.9" in map(str, names.get_values_for_type(x509.IPAddress))
    planner = json.loads((made / "planner" / "zenoh.json5").read_text())
    assert planner["connect"]["endpoints"] == ["tls/robot.example:7447"]
    six = transport.init_security(tmp_path / "six", hosts=["fd00::9"])
    assert configured_endpoints(six / "planner", "connect") == ("tls/[fd00::9]:7447",)


@pytest.mark.slow
def test_the_matrix_is_as_meant(folder: Path) -> None:
    """Connecting as each role shows exactly what it is meant to be allowed, and nothing for a stranger."""
    permissions = check_security(folder)
    found = {role: tuple(p.action for p in permissions if p.role == role and p.allowed) for role in EXPECTED}
    assert found == EXPECTED
    text = format_matrix(permissions)
    assert "!" not in text and len(text.splitlines()) == 1 + len(EXPECTED)


@pytest.mark.slow
def test_the_check_finds_a_door_left_open(tmp_path: Path) -> None:
    """With the access rules switched off the matrix shows what should not be possible, for any robot's name."""
    made = transport.init_security(tmp_path / "s", robot="rex")
    assert configured_robot(made / "node") == "rex"
    with pytest.raises(SecurityError, match="cannot find the access rules"):
        configured_robot(made / "viewer")
    path = made / "node" / "zenoh.json5"
    configuration = json.loads(path.read_text())
    configuration["access_control"]["enabled"] = False
    path.write_text(json.dumps(configuration))
    permissions = check_security(made)
    wrong = {(p.role, p.action) for p in permissions if p.allowed != p.expected}
    assert ("viewer", "request a scan") in wrong and ("gait", "forge grids") in wrong
    assert not any(role == "nobody" for role, _ in wrong)
    assert "yes !" in format_matrix(permissions)


def test_roles_work_end_to_end(start, endpoint: str, folder: Path, peer) -> None:
    """Over TLS a planner gets history and scans, a viewer queries, gait announces, each with its own folder."""
    secure = _secure(endpoint)
    node = start("node", secure, "listen", str(folder))
    node.tell("publish 1")
    with transport.open_client(secure, security=folder / "planner", timeout=180.0) as session:
        client = transport.PerceptionClient(session)
        assert client.wait_for_step(1, timeout=180.0).sequence == 1
        assert client.request_scan(timeout=180.0).sequence == 1
    with transport.open_client(secure, security=folder / "viewer", timeout=180.0) as session:
        client = transport.PerceptionClient(session)
        assert client.wait_for_step(1, timeout=180.0) is client.latest()
        assert client.query().sequence == 1
        with pytest.raises(transport.ScannerUnavailable, match="the role of this client's certificate"):
            client.request_scan(timeout=5.0)
    with transport.open_client(secure, security=folder / "gait", timeout=180.0) as session:
        publisher = transport.StancePublisher(session)
        for step, phase in enumerate((1, 2, 1)):
            pause = transport.StancePause(robot="guara", step=step, phase=phase, stamp=1, stance=peer.make_stance())
            publisher.publish(pause)
            assert node.expect("pause").startswith(f"pause {step}")
        with pytest.raises(transport.ScannerUnavailable):
            transport.PerceptionClient(session).latest()


@pytest.mark.parametrize("is_open", [False, True])
def test_the_administration_space_of_the_node_answers_nobody(endpoint: str, tmp_path: Path, is_open: bool) -> None:
    """Each role reads what Zenoh tells of its own session alone, unless the folder opens that of the node."""
    secure = _secure(endpoint)
    folder = transport.init_security(tmp_path / "s")
    if is_open:
        path = folder / "node" / "zenoh.json5"
        configuration = json.loads(path.read_text())
        configuration["adminspace"] = {"enabled": True}
        configuration["access_control"]["enabled"] = False
        path.write_text(json.dumps(configuration))
    with transport.open_node(listen=secure, security=folder) as node:
        for role in ("gait", "planner", "viewer"):
            with transport.open_client(secure, security=folder / role, timeout=180.0) as session:
                told = [str(reply.ok.key_expr) for reply in session.raw.get("@/**", timeout=10.0)]
                assert any(key.startswith(f"@/{node.zenoh_id}") for key in told) == is_open, (role, told)


def _certificate_of(authority: Credentials, folder: Path, days: int = 825) -> Path:
    """A copy of the planner's folder with another certificate."""
    credentials = make_certificate(authority, "planner", ["planner"], days=days)
    (folder / "planner.pem").write_bytes(credentials.certificate)
    (folder / "planner.key").write_bytes(credentials.key)
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("flaw", ["other CA", "expired", "plain tcp", "no certificate"])
def test_who_has_no_valid_certificate_does_not_get_in(endpoint: str, folder: Path, tmp_path: Path, flaw: str) -> None:
    """Every refused connection ends in the one message that says what to check."""
    import shutil

    secure = _secure(endpoint)
    own = Path(shutil.copytree(folder / "planner", tmp_path / "planner"))
    if flaw == "other CA":
        _certificate_of(make_authority("other"), own)
    elif flaw == "expired":
        ca = Credentials((folder / "ca" / "ca.pem").read_bytes(), (folder / "ca" / "ca.key").read_bytes())
        _certificate_of(ca, own, days=-1)
    with transport.open_node(listen=secure, security=folder):
        with pytest.raises(transport.ConnectionFailed, match=r"from the same CA as the node's"):
            if flaw == "plain tcp":
                transport.open_client(secure.replace("tls/", "tcp/"), timeout=0.5)
            elif flaw == "no certificate":
                transport.open_client(secure, timeout=0.5)
            else:
                transport.open_client(secure, security=own, timeout=0.5)
        with transport.open_client(secure, security=folder / "planner", timeout=180.0) as session:
            assert session.links()


def test_an_existing_folder_is_not_touched(tmp_path: Path) -> None:
    """Keys are never overwritten; an empty folder is fine."""
    (tmp_path / "a").mkdir()
    made = transport.init_security(tmp_path / "a")
    before = (made / "ca" / "ca.key").read_bytes()
    with pytest.raises(SecurityError, match="exists and is not empty"):
        transport.init_security(made)
    assert (made / "ca" / "ca.key").read_bytes() == before
    with pytest.raises(SecurityError, match="cannot write"):
        transport.init_security(made / "ca" / "ca.pem" / "x")
    assert not list(tmp_path.glob(".*"))


def test_endpoints_without_encryption_are_refused(folder: Path, endpoint: str) -> None:
    """With a security folder nothing travels in the clear."""
    for attempt in (
        lambda: transport.open_node(listen=endpoint, security=folder),
        lambda: transport.open_node(connect=endpoint, security=folder),
        lambda: transport.open_client(endpoint, security=folder / "planner"),
        lambda: transport.init_security(folder / "new", listen="tcp/0.0.0.0:7447"),
    ):
        with pytest.raises(ConfigurationError, match="is not encrypted"):
            attempt()


def test_a_broken_folder_is_named(folder: Path, tmp_path: Path) -> None:
    """A folder without configuration, one that does not parse and a missing file are distinguished."""
    with pytest.raises(SecurityError, match=r"neither .* contains zenoh.json5.*guara security init"):
        transport.open_client(security=tmp_path)
    (tmp_path / "zenoh.json5").write_text("{ mode: ")
    with pytest.raises(SecurityError, match=r"cannot use .*zenoh.json5"):
        load_configuration(role_folder(tmp_path, "planner"))
    (tmp_path / "zenoh.json5").write_text((folder / "planner" / "zenoh.json5").read_text())
    with pytest.raises(SecurityError, match=r"No such file .*planner|No such file .*ca\.pem"):
        load_configuration(role_folder(tmp_path, "planner"))
    with pytest.raises(SecurityError, match="neither .* contains"):
        check_security(tmp_path)

"""The security folder: a CA, and per role a folder with certificate, key and Zenoh configuration."""

from __future__ import annotations

import json
import os
import shutil
import socket
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from transport import zenoh_api
from transport.access_rules import ROLES, access_control
from transport.authority import make_authority, make_certificate
from transport.configuration import check_endpoint, client_configuration, node_configuration, sending
from transport.exceptions import ConfigurationError, SecurityError
from transport.keys import DEFAULT_ROBOT, check_name

# Name of the Zenoh configuration in a role's folder.
CONFIGURATION = "zenoh.json5"

# Where a secured node listens: on all of its networks, because nobody gets in without a certificate.
DEFAULT_LISTEN = "tls/0.0.0.0:7447"

# [byte] and levels: ours has 3 kB and six. Zenoh's reader ends the process where nesting takes all of its stack.
LARGEST_CONFIGURATION = 256 * 1024
DEEPEST_CONFIGURATION = 32

TLS = "transport/link/tls"
FILES = (
    "root_ca_certificate",
    "listen_private_key",
    "listen_certificate",
    "connect_private_key",
    "connect_certificate",
)


def _role_configuration(role: str, robot: str, listen: str, connect: str) -> dict[str, Any]:
    files = {
        "root_ca_certificate": "ca.pem",
        "connect_private_key": f"{role}.key",
        "connect_certificate": f"{role}.pem",
    }
    if role == "node":
        configuration = node_configuration([listen])
        files |= {"listen_private_key": f"{role}.key", "listen_certificate": f"{role}.pem"}
        configuration["adminspace"] = {"enabled": False}
        configuration["access_control"] = access_control(robot)
    else:
        configuration = client_configuration(connect)
    tls = {**files, "enable_mtls": True, "close_link_on_expiration": True}
    configuration["transport"]["link"] |= {"protocols": ["tls"], "tls": tls, "tx": sending()}
    return configuration


def _write(path: Path, data: bytes, *, private: bool = False) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600 if private else 0o644)
    with os.fdopen(descriptor, "wb") as file:
        file.write(data)


def init_security(
    folder: str | Path,
    *,
    robot: str = DEFAULT_ROBOT,
    hosts: Sequence[str] = (),
    listen: str = DEFAULT_LISTEN,
) -> Path:
    """Make a CA and the folders of all roles: `ca`, `node`, `gait`, `planner`, `viewer`.

    Give each machine only the folders of its roles, and keep `ca` off the robot. The folder appears whole or
    not at all.

    Args:
        folder: new folder.
        robot: instance name; the access rules hold for its keys.
        hosts: names and addresses by which clients reach the node, beside localhost and this machine's name.
        listen: where the node will listen.

    Returns:
        The folder.

    Raises:
        SecurityError: the folder exists and is not empty, or cannot be written.
        ConfigurationError: `listen` is no TLS endpoint.
    """
    check_name(robot)
    if not check_endpoint(listen).startswith("tls/"):
        raise ConfigurationError(f"endpoint {listen!r} is not encrypted; write tls/host:port")
    target = Path(folder)
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise SecurityError(f"{target} exists and is not empty; give a new folder, or remove it first")
    own_hosts = list(dict.fromkeys([*hosts, "localhost", "127.0.0.1", "::1", socket.gethostname()]))
    port = listen.rpartition(":")[2]
    connect = f"tls/{hosts[0] if hosts else 'localhost'}:{port}"
    authority = make_authority(f"{robot} CA")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        staging = Path(tempfile.mkdtemp(prefix=f".{target.name}-", dir=target.parent))
    except OSError as error:
        raise SecurityError(f"cannot write {target}: {error.strerror}") from error
    try:
        (staging / "ca").mkdir()
        _write(staging / "ca" / "ca.pem", authority.certificate)
        _write(staging / "ca" / "ca.key", authority.key, private=True)
        for role in ROLES:
            own = staging / role
            own.mkdir()
            credentials = make_certificate(authority, role, own_hosts if role == "node" else [role])
            configuration = _role_configuration(role, robot, listen, connect)
            _write(own / "ca.pem", authority.certificate)
            _write(own / f"{role}.pem", credentials.certificate)
            _write(own / f"{role}.key", credentials.key, private=True)
            _write(own / CONFIGURATION, (json.dumps(configuration, indent=2) + "\n").encode())
        if target.exists():
            target.rmdir()
        staging.rename(target)
    except OSError as error:
        shutil.rmtree(staging, ignore_errors=True)
        raise SecurityError(f"cannot write {target}: {error.strerror}") from error
    return target


def role_folder(folder: str | Path, role: str) -> Path:
    """The folder of one role, given itself or the folder that `init_security` made.

    Raises:
        SecurityError: there is no Zenoh configuration in either.
    """
    path = Path(folder)
    for candidate in (path, path / role):
        if (candidate / CONFIGURATION).is_file():
            return candidate
    raise SecurityError(
        f"{path} holds no {CONFIGURATION}, nor does {path / role}; give the folder of a role, "
        f"made by `guara security init`"
    )


def _configuration_text(folder: Path) -> str:
    """The text of a role's Zenoh configuration; ValueError when it nests so deep that Zenoh's reader would crash."""
    with (folder / CONFIGURATION).open("rb") as file:
        content = file.read(LARGEST_CONFIGURATION + 1)
    if len(content) > LARGEST_CONFIGURATION:
        raise ValueError(f"it has more than {LARGEST_CONFIGURATION} bytes")
    depth = 0
    for character in content:
        depth += (character in b"[{") - (character in b"]}")
        if depth > DEEPEST_CONFIGURATION:
            raise ValueError(f"it nests more than {DEEPEST_CONFIGURATION} deep")
    return content.decode()


def load_configuration(
    folder: Path,
    *,
    listen: Sequence[str] = (),
    connect: str | None = None,
    shared_memory: bool = True,
) -> str:
    """The Zenoh configuration of a role's folder, with the paths of its files made absolute.

    Args:
        folder: folder of a role.
        listen: endpoints instead of the configured ones.
        connect: endpoint instead of the configured one; a node then is a client of that router.
        shared_memory: let Zenoh pass large payloads through /dev/shm between processes of one machine.

    Raises:
        SecurityError: the configuration cannot be read, or a file that it names is missing.
        ConfigurationError: an endpoint without encryption.
    """
    for endpoint in (*listen, *(() if connect is None else (connect,))):
        if not check_endpoint(endpoint).startswith(("tls/", "quic/")):
            raise ConfigurationError(
                f"endpoint {endpoint!r} is not encrypted although a security folder is given; use tls/host:port"
            )
    try:
        text = _configuration_text(folder)
        values: dict[str, Any] = {}
        for name in FILES:
            value = zenoh_api.configuration_value(text, f"{TLS}/{name}")
            if value is not None:
                values[f"{TLS}/{name}"] = str(_existing(folder, value, is_key=name.endswith("private_key")))
    except (OSError, ValueError, zenoh_api.zenoh_error()) as error:
        raise SecurityError(f"cannot use {folder / CONFIGURATION}: {error}") from error
    values["transport/shared_memory/enabled"] = shared_memory
    if listen:
        values["listen/endpoints"] = list(listen)
    if connect is not None:
        values |= {"connect/endpoints": [connect], "mode": "client", "connect/timeout_ms": 0}
        values |= {"access_control/enabled": False, "listen/endpoints": []}
    return zenoh_api.with_values(text, values)


def _existing(folder: Path, name: str, *, is_key: bool) -> Path:
    path = (folder / name).resolve()
    with path.open("rb") as file:
        mode = os.fstat(file.fileno()).st_mode & 0o777
    if is_key and mode & 0o077:
        raise SecurityError(
            f"{path} has mode {mode:03o}: others on this machine can read the key and act as its owner. "
            f"chmod 600 it; if it was so for long, `guara security renew` makes a new one"
        )
    return path


def read_configuration(folder: Path, key: str) -> Any:
    """One value of a role's Zenoh configuration, None where it is not set; `key` is a path with slashes.

    Raises:
        SecurityError: the configuration cannot be read.
    """
    try:
        return zenoh_api.configuration_value(_configuration_text(folder), key)
    except (OSError, ValueError, zenoh_api.zenoh_error()) as error:
        raise SecurityError(f"cannot use {folder / CONFIGURATION}: {error}") from error


def configured_robot(folder: Path) -> str:
    """The instance name for which the access rules of a node's folder were made.

    Raises:
        SecurityError: the configuration cannot be read, or holds no rules.
    """
    try:
        rules = read_configuration(folder, "access_control/rules") or []
        return str(rules[0]["key_exprs"][0]).partition("/")[0]
    except (LookupError, TypeError) as error:
        raise SecurityError(f"cannot find the access rules in {folder / CONFIGURATION}: {error}") from error


def configured_endpoints(folder: Path, kind: str) -> tuple[str, ...]:
    """The endpoints of a role's folder; kind is "listen" or "connect".

    Raises:
        SecurityError: the configuration cannot be read.
    """
    found = read_configuration(folder, f"{kind}/endpoints")
    # Zenoh writes endpoints either as one list, or as one list per mode of a session.
    if isinstance(found, dict):
        found = [endpoint for endpoints in found.values() for endpoint in endpoints]
    return tuple(found or ())

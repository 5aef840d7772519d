"""Security folder: a CA, and for each role a folder with certificate, key and Zenoh configuration."""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from transport import zenoh_api
from transport.configuration import (
    PATIENT_WAIT_US,
    WAIT_BEFORE_DROP_US,
    check_tls,
    client_configuration,
    dialling,
    node_configuration,
    tls_endpoint,
)
from transport.exceptions import SecurityError, errors_as
from transport.keys import DEFAULT_ROBOT, check_name
from transport.security.access_rules import ROLES, access_control
from transport.security.authority import Credentials, make_authority, make_certificate
from transport.security.whole_folder import create_folder, write_file

# Name of the Zenoh configuration in a role's folder.
CONFIGURATION = "zenoh.json5"

# Default endpoint of a secured node. It may listen on all interfaces, because clients need a certificate.
DEFAULT_LISTEN = "tls/0.0.0.0:7447"

# Largest size [bytes] and nesting of a configuration; a node's takes 5 kB and has seven levels. Deep nesting
# overflows the stack of Zenoh's parser, which terminates the process.
LARGEST_CONFIGURATION = 1024 * 1024
DEEPEST_CONFIGURATION = 32

# Longest name of a robot or router [characters]: a common name is two names and a dot, and at most 64 characters long.
LONGEST_NAME = 31
# Names that robots, routers and added members cannot have, because other folders in a security folder have them.
RESERVED = (*ROLES, "ca")

TLS = "transport/link/tls"
WAIT = "transport/link/tx/queue/congestion_control/drop/max_wait_before_drop_fragments"
FILES = (
    "root_ca_certificate",
    "listen_private_key",
    "listen_certificate",
    "connect_private_key",
    "connect_certificate",
)


def tls_links(name: str, *, listens: bool, prefix: str = "") -> dict[str, Any]:
    """Return the TLS part of `transport/link` for the member `name`; `prefix` is put before the names of its files."""
    files = {
        "root_ca_certificate": f"{prefix}ca.pem",
        "connect_private_key": f"{prefix}{name}.key",
        "connect_certificate": f"{prefix}{name}.pem",
    }
    if listens:
        files |= {"listen_private_key": f"{prefix}{name}.key", "listen_certificate": f"{prefix}{name}.pem"}
    tls = {**files, "enable_mtls": True, "close_link_on_expiration": True}
    return {"protocols": ["tls"], "tls": tls}


def _role_configuration(role: str, robot: str, listen: str, connect: str) -> dict[str, Any]:
    if role == "node":
        configuration = node_configuration([listen])
        configuration["adminspace"] = {"enabled": False}
        configuration["access_control"] = access_control(robot, {name: [f"{robot}.{name}"] for name in ROLES})
    else:
        configuration = client_configuration(connect)
    configuration["transport"]["link"] |= tls_links(role, listens=role == "node")
    return configuration


def init_security(
    folder: str | Path,
    *,
    robot: str | Sequence[str] = DEFAULT_ROBOT,
    hosts: Sequence[str] = (),
    listen: str = DEFAULT_LISTEN,
) -> Path:
    """Make a CA, and the folders of all roles: `node`, `gait`, `planner`, `viewer`.

    The common name of a certificate is `<robot>.<role>`. Several robots share the CA, and each has a folder that
    contains the folders of its roles. Copy to each machine only the folders of its roles, and keep `ca` off the robot.
    The folder is created atomically.

    Args:
        folder: new folder, or an empty one.
        robot: one or several instance names; the access rules of each apply to its own keys.
        hosts: host names and addresses at which clients reach the node, besides localhost and this machine's name.
            With several robots: one per robot in the same order, or none.
        listen: endpoint of the node.

    Returns:
        The folder.

    Raises:
        SecurityError: the folder exists and is not empty, or cannot be written; no robot is given, or one is given
            twice; a name is too long or reserved; or there are several robots and hosts, but not one host per robot.
        KeyNameError: a name cannot be part of a key.
        ConfigurationError: `listen` is not a TLS endpoint.
    """
    robots = [robot] if isinstance(robot, str) else list(robot)
    for name in robots:
        check_robot(name)
    if len(set(robots)) != len(robots) or not robots:
        raise SecurityError(f"robots are {', '.join(robots) or 'none'}; give one or more, and give each robot once")
    if len(robots) > 1 and hosts and len(hosts) != len(robots):
        raise SecurityError(
            f"hosts given: {len(hosts)}, robots: {len(robots)}; give one host per robot in the same order, or none"
        )
    target = Path(folder)
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise SecurityError(f"{target} exists and is not empty; give a new folder, or remove it first")
    authority = make_authority(f"{robots[0]} CA")

    def write(staging: Path) -> None:
        (staging / "ca").mkdir()
        write_file(staging / "ca" / "ca.pem", authority.certificate)
        write_file(staging / "ca" / "ca.key", authority.key, private=True)
        for number, name in enumerate(robots):
            own = hosts if len(robots) == 1 else hosts[number : number + 1]
            of_robot = staging if len(robots) == 1 else staging / name
            of_robot.mkdir(exist_ok=True)
            write_roles(of_robot, authority, name, hosts=own, listen=listen)

    check_tls(listen)
    create_folder(target, write)
    return target


def check_robot(name: str) -> str:
    """Check that a name can be an instance name and the first part of a common name; return the name.

    Raises:
        KeyNameError: the name cannot be part of a key.
        SecurityError: the name is too long, or reserved for another folder in a security folder.
    """
    check_name(name)
    if len(name) > LONGEST_NAME or name in RESERVED:
        raise SecurityError(
            f"robot name {name!r} is too long or reserved; allowed: at most {LONGEST_NAME} characters, and none "
            f"of {', '.join(RESERVED)}"
        )
    return name


def write_roles(folder: Path, authority: Credentials, robot: str, *, hosts: Sequence[str], listen: str) -> None:
    """Write the folders of all roles of a robot into `folder`."""
    for role in ROLES:
        own = folder / role
        own.mkdir()
        names = own_hosts(hosts) if role == "node" else [f"{robot}.{role}"]
        connect = tls_endpoint(hosts[0] if hosts else "localhost", listen.rpartition(":")[2])
        configuration = _role_configuration(role, robot, listen, connect)
        write_member(own, authority, f"{robot}.{role}", names, json_text(configuration))


def own_hosts(hosts: Sequence[str]) -> list[str]:
    """Return the given host names and addresses, those of localhost, and this machine's name, without duplicates."""
    return list(dict.fromkeys([*hosts, "localhost", "127.0.0.1", "::1", socket.gethostname()]))


def write_member(own: Path, authority: Credentials, common_name: str, hosts: Sequence[str], configuration: str) -> None:
    """Write certificate, key and configuration (JSON) of a member into its folder, which must be empty.

    The certificate and key files are named after the folder.
    """
    credentials = make_certificate(authority, common_name, hosts)
    write_file(own / "ca.pem", authority.certificate)
    write_file(own / f"{own.name}.pem", credentials.certificate)
    write_file(own / f"{own.name}.key", credentials.key, private=True)
    write_file(own / CONFIGURATION, configuration.encode())


def json_text(value: Any) -> str:
    """Return a value as the text of a JSON file."""
    return json.dumps(value, indent=2) + "\n"


def role_folder(folder: str | Path, role: str) -> Path:
    """Return the folder of a role, given that folder itself or the security folder that contains it.

    Raises:
        SecurityError: neither `folder` nor its subfolder `role` contains a Zenoh configuration.
    """
    path = Path(folder)
    for candidate in (path, path / role):
        if (candidate / CONFIGURATION).is_file():
            return candidate
    raise SecurityError(
        f"neither {path} nor {path / role} contains {CONFIGURATION}; give the folder of a role, "
        f"made by `guara security init`"
    )


def _configuration_text(folder: Path) -> str:
    """Read a role's Zenoh configuration; ValueError if it is too large or too deeply nested."""
    with (folder / CONFIGURATION).open("rb") as file:
        content = file.read(LARGEST_CONFIGURATION + 1)
    if len(content) > LARGEST_CONFIGURATION:
        raise ValueError(f"it has more than {LARGEST_CONFIGURATION} bytes")
    depth = 0
    for character in content:
        depth += (character in b"[{") - (character in b"]}")
        if depth > DEEPEST_CONFIGURATION:
            raise ValueError(f"it is nested more than {DEEPEST_CONFIGURATION} levels deep")
    return content.decode()


def load_configuration(
    folder: Path,
    *,
    listen: Sequence[str] = (),
    connect: str | None = None,
    uplink: str | None = None,
    shared_memory: bool = True,
    local: bool = False,
) -> str:
    """Return the Zenoh configuration in a role's folder, with absolute paths of the files that it names.

    Args:
        folder: folder of a role.
        listen: endpoints that replace the configured ones; empty = no change.
        connect: endpoint that replaces the configured ones; a node becomes a client of the router there.
        uplink: endpoint of another router to which a node connects; it reconnects after each loss of the link.
        shared_memory: True = Zenoh passes large payloads through /dev/shm between processes of one machine.
        local: True = use the files in this folder, whatever paths are configured, and connect only to `connect` and
            `uplink`.

    Raises:
        SecurityError: the configuration cannot be read, a file that it names is missing, or others can read a private
            key.
        ConfigurationError: a given endpoint is not valid or not encrypted.
    """
    for endpoint in (*listen, *(endpoint for endpoint in (connect, uplink) if endpoint is not None)):
        check_tls(endpoint, allows_quic=True)
    with errors_as(SecurityError, f"cannot use {folder / CONFIGURATION}", OSError, ValueError, zenoh_api.zenoh_error()):
        text = _configuration_text(folder)
        values: dict[str, Any] = {}
        for name in FILES:
            value = zenoh_api.configuration_value(text, f"{TLS}/{name}")
            if value is not None:
                value = Path(value).name if local else value
                values[f"{TLS}/{name}"] = str(_existing(folder, value, is_key=name.endswith("private_key")))
    values["transport/shared_memory/enabled"] = shared_memory
    if local:
        values["connect/endpoints"] = []
    if listen:
        values["listen/endpoints"] = list(listen)
    if connect is not None:
        values |= {"connect/endpoints": [connect], "mode": "client", "connect/timeout_ms": 0}
        values |= {"access_control/enabled": False, "listen/endpoints": []}
        if zenoh_api.configuration_value(text, WAIT) == WAIT_BEFORE_DROP_US:
            values[WAIT] = PATIENT_WAIT_US
    if uplink is not None:
        values["connect"] = dialling(uplink)
    return zenoh_api.with_values(text, values)


def _existing(folder: Path, name: str, *, is_key: bool) -> Path:
    path = (folder / name).resolve()
    with path.open("rb") as file:
        mode = os.fstat(file.fileno()).st_mode & 0o777
    if is_key and mode & 0o077:
        raise SecurityError(
            f"{path} has mode {mode:03o}: others on this machine can read the key and act as its owner. "
            "Run chmod 600 on it. If others may have read it, revoke the member with `guara security revoke` and add "
            "a new one; for a node, make a new folder with `guara security init`"
        )
    return path


def read_configuration(folder: Path, key: str) -> Any:
    """Return one value of a role's Zenoh configuration, or None if it is not set; `key` is a path with slashes.

    Raises:
        SecurityError: the configuration cannot be read.
    """
    with errors_as(SecurityError, f"cannot use {folder / CONFIGURATION}", OSError, ValueError, zenoh_api.zenoh_error()):
        return zenoh_api.configuration_value(_configuration_text(folder), key)


def configured_robot(folder: Path) -> str:
    """Return the instance name for which the access rules in a node's folder were made.

    Raises:
        SecurityError: the configuration cannot be read, or has no access rules.
    """
    with errors_as(SecurityError, f"cannot find the access rules in {folder / CONFIGURATION}", LookupError, TypeError):
        rules = read_configuration(folder, "access_control/rules") or []
        return str(rules[0]["key_exprs"][0]).partition("/")[0]


def configured_endpoints(folder: Path, kind: str) -> tuple[str, ...]:
    """Return the endpoints configured in a role's folder; `kind` is "listen" or "connect".

    Raises:
        SecurityError: the configuration cannot be read.
    """
    found = read_configuration(folder, f"{kind}/endpoints")
    # Zenoh accepts one list of endpoints, or one list per mode of the session.
    if isinstance(found, dict):
        found = [endpoint for endpoints in found.values() for endpoint in endpoints]
    return tuple(found or ())

"""Management of a security folder's certificates: expiry, renewal, and addition and revocation of members."""

from __future__ import annotations

import dataclasses
import datetime
from functools import partial
from pathlib import Path
from typing import Any

from transport.configuration import DEFAULT_ENDPOINT, client_configuration, sending
from transport.exceptions import SecurityError, errors_as
from transport.keys import check_name
from transport.messages.terrain_message import Health
from transport.security.access_rules import FLEET, ROLES, ROUTER, access_control
from transport.security.authority import Credentials, make_certificate, read_certificate
from transport.security.folder import (
    CONFIGURATION,
    DEFAULT_LISTEN,
    LONGEST_NAME,
    RESERVED,
    check_robot,
    configured_robot,
    json_text,
    read_configuration,
    tls_links,
    write_member,
    write_roles,
)
from transport.security.members import (
    Members,
    add_folder,
    common_name,
    edit_configuration,
    open_authority,
    open_members,
    replace_file,
)

# Remaining validity at or below which a certificate causes a warning [days].
WARNING_DAYS = 30
RENEW = "run `guara security renew`, then copy the folder again"


def days_left(certificate: str | Path) -> float:
    """Return the remaining validity of a certificate [days]; negative after it has expired.

    Raises:
        SecurityError: the certificate cannot be read.
    """
    end = read_certificate(Path(certificate), lambda read: read.not_valid_after_utc)
    return (end - datetime.datetime.now(datetime.UTC)).total_seconds() / 86400.0


def _files(root: Path, ending: str) -> list[Path]:
    return sorted(path for depth in ("", "*/", "*/*/") for path in root.glob(f"{depth}*.{ending}"))


def judge_security(folder: str | Path) -> tuple[Health, str]:
    """Check a security folder for keys that others can read, expiring certificates and outdated access rules.

    Returns:
        Health and its description: ERROR for a key that others can read or an expired certificate; otherwise WARN for a
        certificate that expires within `WARNING_DAYS` or for access rules of another version; otherwise OK.

    Raises:
        SecurityError: there is no certificate, a file cannot be read, or a node's configuration has no access rules.
    """
    root = Path(folder)
    left = {str(path.relative_to(root)): days_left(path) for path in _files(root, "pem")}
    if not left:
        raise SecurityError(f"{folder} contains no certificate; give a folder that `guara security init` made")
    readable = [path for path in _files(root, "key") if _is_open(path)]
    if readable:
        name = str(readable[0].relative_to(root))
        return Health.ERROR, f"{name} can be read by others on this machine; run chmod 600 on it"
    name, days = min(left.items(), key=lambda item: item[1])
    if days <= 0:
        return Health.ERROR, f"{name} expired {-days:.0f} day{'s' * (round(-days) != 1)} ago; {RENEW}"
    if days <= WARNING_DAYS:
        return Health.WARN, f"{name} expires in {days:.0f} day{'s' * (round(days) != 1)}; {RENEW}"
    for node in (root, root / "node", *sorted(root.glob("*/node"))):
        if (node / "node.pem").is_file() and (node / CONFIGURATION).is_file() and not _has_current_rules(node):
            return Health.WARN, (
                "the access rules were made by another version: planners may have to compute ages by wall clocks, and "
                f"the gait may not be allowed to report its clock, without which no scan is confirmed; {RENEW}"
            )
    return Health.OK, f"{len(left)} certificates, the first expires in {days:.0f} days ({name})"


def _is_open(key: Path) -> bool:
    with errors_as(SecurityError, f"cannot read {key}"):
        return bool(key.stat().st_mode & 0o077)


def _has_current_rules(node: Path) -> bool:
    configured = {rule["id"]: set(rule["key_exprs"]) for rule in read_configuration(node, "access_control/rules") or []}
    made = access_control(configured_robot(node))["rules"]
    return all(configured.get(rule["id"], set()) >= set(rule["key_exprs"]) for rule in made)


def renew(folder: str | Path, names: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Renew keys and certificates of members, with the same CA and common names.

    Also updates configurations of earlier versions: link queues of the renewed members and, if a node or router is
    among them, the access rules of all nodes and routers.

    Args:
        folder: folder made by `init_security`.
        names: names of members, as in `Members.find`, such as `planner` or, with several robots, `<robot>.planner`.
            Empty = all that are not revoked.

    Returns:
        Names of the renewed members.

    Raises:
        SecurityError: a member does not exist or was revoked, the folder lacks its CA, a file cannot be read, or a
            configuration cannot be changed.
        OSError: a key or certificate cannot be written.
    """
    authority, members = open_authority(folder), open_members(folder)
    gone = members.revoked_names
    chosen = dict(members.find(name) for name in names) or {
        name: member for name, member in members.folders.items() if name not in gone
    }
    for name in chosen:
        if name in gone:
            raise SecurityError(f"{name} was revoked; add a member with another name instead")
    for member in chosen.values():
        certificate = member / f"{member.name}.pem"
        credentials = make_certificate(authority, common_name(certificate), hosts_of(certificate))
        replace_file(member / f"{member.name}.key", credentials.key, private=True)
        replace_file(certificate, credentials.certificate)
        edit_configuration(member / CONFIGURATION, _complete_queues)
    if any(member.name == "node" or name.endswith(f".{ROUTER}") for name, member in chosen.items()):
        members.save()
    return tuple(chosen)


def _complete_queues(configuration: dict[str, Any]) -> bool:
    """Add missing settings of link queues to a configuration, and keep existing ones. Always return True (changed)."""
    link, made = configuration["transport"]["link"], sending()
    configured = link.get("tx", {})
    link["tx"] = {**made, **configured, "queue": {**made["queue"], **configured.get("queue", {})}}
    return True


def add_robot(folder: str | Path, robot: str, *, hosts: tuple[str, ...] = ()) -> Path:
    """Add a robot: create the folders of its roles, with certificates from the same CA.

    Args:
        folder: folder made by `init_security`.
        robot: instance name.
        hosts: host names and addresses at which clients reach its node, besides localhost and this machine's name.

    Returns:
        The folder of the robot, which contains the folders of its roles.

    Raises:
        SecurityError: the name is too long, reserved, taken or revoked, or the folder lacks its CA or cannot be
            read or written.
        KeyNameError: the name cannot be part of a key.
    """
    authority, members = open_authority(folder), open_members(folder)
    target = members.root / check_robot(robot)
    check_free(members, robot, target)
    write = partial(write_roles, authority=authority, robot=robot, hosts=hosts, listen=DEFAULT_LISTEN)
    return add_folder(target, write, lambda: open_members(folder))


def check_free(members: Members, name: str, member: Path) -> None:
    """Check that a name is not reserved, and that no robot, router or fleet member has or had it.

    Raises:
        SecurityError: the name is not free.
    """
    if member.exists() or name in RESERVED or name in members.robots or name in members.revoked:
        raise SecurityError(f"the name {name!r} is reserved, taken or revoked; names are never used again")


def add(folder: str | Path, name: str, role: str) -> Path:
    """Add a member with the rights of a role, such as a second planner.

    Args:
        folder: folder made by `init_security`.
        name: name of the member; with several robots `<robot>.<name>`.
        role: role of the member: "planner", "viewer" or "gait" of a robot, or "fleet", which may list the live robots
            on a router and read their status.

    Returns:
        The folder of the member. The folders of the node and its routers may change too; copy them to their machines
        again.

    Raises:
        SecurityError: the name is too long, reserved, taken or revoked, the robot or role is unknown, the role is
            `node`, or the folder lacks its CA or cannot be read or written.
        KeyNameError: the name cannot be part of a key.
    """
    authority, members = open_authority(folder), open_members(folder)
    allowed = (*(other for other in ROLES if other != "node"), FLEET)
    if role not in allowed:
        raise SecurityError(f"role is {role!r}; allowed: {', '.join(allowed)}")
    if role == FLEET:
        return _add_fleet_member(members, authority, name.removesuffix(f".{FLEET}"))
    robot, own_name = _split(members, name)
    check_name(own_name, "member")
    own = members.robots[robot]
    target = own.folder / own_name
    if own_name in own.revoked or own_name in (*RESERVED, ROUTER, FLEET) or target.exists():
        raise SecurityError(f"the name {own_name!r} is reserved, taken or revoked; names are never used again")
    # Prefix of the common names of the robot's members; empty in folders made by an earlier version.
    prefix = common_name(own.folder / "node" / "node.pem").removesuffix("node")
    full = prefix + own_name
    _check_length(full)
    text = (own.folder / role / CONFIGURATION).read_text(encoding="utf-8")
    for ending in ("key", "pem"):
        text = text.replace(f'"{role}.{ending}"', f'"{own_name}.{ending}"')
    larger = members.with_robot(robot, dataclasses.replace(own, added={**own.added, own_name: role}))
    return add_folder(target, lambda member: write_member(member, authority, full, [full], text), lambda: larger)


def _split(members: Members, name: str) -> tuple[str, str]:
    robot, dot, own_name = name.partition(".")
    if not dot and len(members.robots) == 1:
        return next(iter(members.robots)), name
    if not dot or robot not in members.robots:
        raise SecurityError(
            f"member name is {name!r}; write ROBOT.{own_name or robot}, where ROBOT is one of the robots in "
            f"{members.root}: {', '.join(members.robots)}"
        )
    return robot, own_name


def _add_fleet_member(members: Members, authority: Credentials, name: str) -> Path:
    target = members.root / check_name(name, "member")
    check_free(members, name, target)
    full = f"{name}.{FLEET}"
    _check_length(full)
    configuration = client_configuration(DEFAULT_ENDPOINT.replace("tcp/127.0.0.1", "tls/localhost"))
    configuration["transport"]["link"] |= tls_links(name, listens=False)
    text, larger = json_text(configuration), dataclasses.replace(members, fleet=(*members.fleet, name))
    return add_folder(target, lambda member: write_member(member, authority, full, [full], text), lambda: larger)


def _check_length(full: str) -> None:
    if len(full) > 2 * LONGEST_NAME:
        raise SecurityError(f"{full!r} is too long for a certificate; allowed: {2 * LONGEST_NAME} characters in total")


def revoke(folder: str | Path, name: str) -> tuple[Path, ...]:
    """Revoke a member. It can still connect with its certificate, but no longer has any rights.

    Returns:
        Changed folders of nodes and routers; empty if the member was already revoked. Copy them to their machines and
        restart the programs there, because they read their configuration only at start.

    Raises:
        SecurityError: there is no such member, the member is a node, or the folder lacks its CA or cannot be read or
            written.
    """
    open_authority(folder)
    members = open_members(folder)
    full, member = members.find(name)
    if member.name == "node":
        raise SecurityError(
            "the node cannot be revoked; if its key is no longer secret, make a new folder with `guara security init`"
        )
    if full in members.revoked_names:
        return ()
    for robot, own in members.robots.items():
        if member.parent == own.folder and member.name in own.names:
            return members.with_robot(robot, dataclasses.replace(own, revoked=(*own.revoked, member.name))).save()
    return dataclasses.replace(members, revoked=(*members.revoked, member.name)).save()


def hosts_of(certificate: Path) -> list[str]:
    """Return the host names and addresses in a certificate; SecurityError if there are none or it cannot be read."""
    from cryptography import x509

    kind = x509.SubjectAlternativeName
    names = read_certificate(certificate, lambda read: read.extensions.get_extension_for_class(kind).value)
    return [str(entry.value) for entry in names]

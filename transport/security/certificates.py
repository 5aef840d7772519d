"""Life of certificates: validity, renewal, adding and revoking members."""

from __future__ import annotations

import dataclasses
import datetime
from pathlib import Path
from typing import Any

from transport.configuration import sending
from transport.exceptions import SecurityError
from transport.keys import check_name
from transport.messages.terrain_message import Health
from transport.security.access_rules import FLEET, ROLES, ROUTER, access_control
from transport.security.authority import Credentials, make_certificate, read_certificate
from transport.security.folder import (
    CONFIGURATION,
    LONGEST_NAME,
    RESERVED,
    check_robot,
    configured_robot,
    read_configuration,
    write_member,
    write_roles,
)
from transport.security.members import (
    Members,
    common_name,
    edit_configuration,
    open_authority,
    open_members,
    replace_file,
    take_in,
)
from transport.security.whole_folder import write_file

# [days] A warning is given this long before a certificate ends.
WARNING_DAYS = 30


def days_left(certificate: str | Path) -> float:
    """[days] that a certificate is still valid; negative when it has expired.

    Raises:
        SecurityError: it cannot be read.
    """
    end = read_certificate(Path(certificate), lambda read: read.not_valid_after_utc)
    return (end - datetime.datetime.now(datetime.UTC)).total_seconds() / 86400.0


def expiries(folder: str | Path) -> dict[str, float]:
    """[days] left of each certificate below a security folder, or of the folder of one role, by its path."""
    root = Path(folder)
    return {str(path.relative_to(root)): days_left(path) for path in _files(root, "pem")}


def _files(root: Path, ending: str) -> list[Path]:
    return sorted(path for depth in ("", "*/", "*/*/") for path in root.glob(f"{depth}*.{ending}"))


def judge_security(folder: str | Path) -> tuple[Health, str]:
    """Assess a security folder: keys that others can read, certificates that end, outdated access rules.

    Returns:
        ERROR for a key that others can read or a certificate that has expired, WARN for one that ends within
        `WARNING_DAYS` and for access rules of an earlier version, else OK.

    Raises:
        SecurityError: there is no certificate, or a file cannot be read.
    """
    root, left = Path(folder), expiries(folder)
    if not left:
        raise SecurityError(f"{folder} holds no certificate; give what `guara security init` made, or a role's folder")
    readable = [path for path in _files(root, "key") if _is_open(path)]
    if readable:
        return Health.ERROR, f"{readable[0].relative_to(root)} can be read by others on this machine; chmod 600 it"
    name, days = min(left.items(), key=lambda item: item[1])
    if days <= 0:
        return Health.ERROR, f"{name} expired {-days:.0f} days ago; `guara security renew`, then copy the folder again"
    if days <= WARNING_DAYS:
        return Health.WARN, f"{name} expires in {days:.0f} days; `guara security renew`, then copy the folder again"
    for node in (root, root / "node", *sorted(root.glob("*/node"))):
        if (node / "node.pem").is_file() and (node / CONFIGURATION).is_file() and not _has_present_rules(node):
            return Health.WARN, (
                "the access rules were made by another version: planners may have to judge ages by wall clocks, and "
                "the gait may not tell its clock, without which no scan is confirmed; "
                "`guara security renew`, then copy the folder again"
            )
    return Health.OK, f"{len(left)} certificates, the first ends in {days:.0f} days ({name})"


def _is_open(key: Path) -> bool:
    try:
        return bool(key.stat().st_mode & 0o077)
    except OSError as error:
        raise SecurityError(f"cannot read {key}: {error.strerror}") from error


def _has_present_rules(node: Path) -> bool:
    configured = {rule["id"]: set(rule["key_exprs"]) for rule in read_configuration(node, "access_control/rules") or []}
    made = access_control(configured_robot(node))["rules"]
    return all(configured.get(rule["id"], set()) >= set(rule["key_exprs"]) for rule in made)


def renew(folder: str | Path, names: tuple[str, ...] = ()) -> tuple[str, ...]:
    """Give members new keys and certificates by the same CA; empty `names` renews all. Common names stay.

    What an earlier version wrote into their configurations is brought up to date: the access rules of the node, and
    how much waits for a link.

    Args:
        folder: made by `init_security`.
        names: names of roles or members; with several robots `<robot>.<role>`; routers as `<name>.router`.

    Returns:
        Names of the members that were renewed.

    Raises:
        SecurityError: no such member, or the folder lacks its CA.
    """
    authority, members = open_authority(folder), open_members(folder)
    gone = members.shut_out
    chosen = dict(members.find(name) for name in names) or {
        name: member for name, member in members.everybody.items() if name not in gone
    }
    for name in chosen:
        if name in gone:
            raise SecurityError(f"{name} was shut out; add a member of another name instead")
    for member in chosen.values():
        certificate = member / f"{member.name}.pem"
        _put_certificate(member, make_certificate(authority, common_name(certificate), hosts_of(certificate)))
        edit_configuration(member / CONFIGURATION, _bring_up_to_date)
    if any(member.name == "node" or name.endswith(f".{ROUTER}") for name, member in chosen.items()):
        members.save()
    return tuple(chosen)


def _bring_up_to_date(configuration: dict[str, Any]) -> bool:
    """Add what a member's configuration does not say yet; what its owner changed stays."""
    link, made = configuration["transport"]["link"], sending()
    configured = link.get("tx", {})
    link["tx"] = {**made, **configured, "queue": {**made["queue"], **configured.get("queue", {})}}
    return True


def add_robot(folder: str | Path, robot: str, *, hosts: tuple[str, ...] = (), listen: str = "tls/0.0.0.0:7447") -> Path:
    """Make the folders of the roles of one more robot, by the same CA.

    Args:
        folder: made by `init_security`.
        robot: instance name.
        hosts: names and addresses by which clients reach its node.
        listen: where its node will listen.

    Returns:
        The folder of the robot, which holds those of its roles.

    Raises:
        SecurityError: the name is taken, or the folder lacks its CA.
    """
    authority, members = open_authority(folder), open_members(folder)
    target = members.root / check_robot(robot)
    check_free(members, robot, target)
    return take_in(
        target,
        lambda member: write_roles(member, authority, robot, hosts=hosts, listen=listen),
        lambda: open_members(folder),
    )


def check_free(members: Members, name: str, member: Path) -> None:
    """Refuse the name of a robot, a router or a fleet member that is taken, or was: SecurityError."""
    if member.exists() or name in RESERVED or name in members.robots or name in members.revoked:
        raise SecurityError(f"the name {name!r} is taken or was shut out; names are never used again")


def add(folder: str | Path, name: str, role: str) -> Path:
    """Make a member of its own name with the rights of a role, such as a second planner.

    Args:
        folder: made by `init_security`.
        name: name of the member; with several robots `<robot>.<name>`.
        role: "planner", "viewer" or "gait" of the robot; or "fleet", which sees at routers which robots live.

    Returns:
        Its folder. The folders of the node and of its routers change too and must be copied to where they run.

    Raises:
        SecurityError: the name is taken or was shut out, the role cannot be shared, or the folder lacks its CA.
    """
    authority, members = open_authority(folder), open_members(folder)
    allowed = (*(other for other in ROLES if other != "node"), FLEET)
    if role not in allowed:
        raise SecurityError(f"role is {role!r}; allowed: {', '.join(allowed)}")
    if role == FLEET:
        return _add_watcher(members, authority, name.removesuffix(f".{FLEET}"))
    robot, own_name = _split(members, name)
    check_name(own_name, "member")
    own = members.robots[robot]
    target = own.folder / own_name
    if own_name in own.revoked or own_name in (*RESERVED, ROUTER, FLEET) or target.exists():
        raise SecurityError(f"the name {own_name!r} is taken or was shut out; names are never used again")
    # As the robot's other members are called: in folders of an earlier version without the robot's name.
    before = common_name(own.folder / "node" / "node.pem").removesuffix("node")
    full = before + own_name
    _check_length(full)
    text = (own.folder / role / CONFIGURATION).read_text(encoding="utf-8")
    for ending in ("key", "pem"):
        text = text.replace(f'"{role}.{ending}"', f'"{own_name}.{ending}"')

    def write(member: Path) -> None:
        write_file(member / CONFIGURATION, text.encode())
        write_file(member / "ca.pem", authority.certificate)
        _put_certificate(member, make_certificate(authority, full, [full]))

    larger = members.with_robot(robot, dataclasses.replace(own, added={**own.added, own_name: role}))
    return take_in(target, write, lambda: larger)


def _split(members: Members, name: str) -> tuple[str, str]:
    robot, dot, own_name = name.partition(".")
    if not dot and len(members.robots) == 1:
        return next(iter(members.robots)), name
    if not dot or robot not in members.robots:
        raise SecurityError(
            f"{members.root} holds several robots: write ROBOT.{own_name or robot}, with one of "
            f"{', '.join(members.robots)}"
        )
    return robot, own_name


def _add_watcher(members: Members, authority: Credentials, name: str) -> Path:
    from transport.configuration import DEFAULT_ENDPOINT, client_configuration
    from transport.security.folder import tls_links

    target = members.root / check_name(name, "member")
    check_free(members, name, target)
    _check_length(f"{name}.{FLEET}")
    configuration = client_configuration(DEFAULT_ENDPOINT.replace("tcp/127.0.0.1", "tls/localhost"))
    configuration["transport"]["link"] |= tls_links(name, listens=False)
    full = f"{name}.{FLEET}"
    larger = dataclasses.replace(members, fleet=(*members.fleet, name))
    return take_in(target, lambda member: write_member(member, authority, full, [full], configuration), lambda: larger)


def _check_length(full: str) -> None:
    if len(full) > 2 * LONGEST_NAME:
        raise SecurityError(f"{full!r} is too long for a certificate; allowed: {2 * LONGEST_NAME} characters in all")


def revoke(folder: str | Path, name: str) -> tuple[Path, ...]:
    """Shut a member out: its certificate still opens a link, on which nothing is allowed any more.

    Returns:
        The folders of nodes and routers that changed and must be copied to where they run; they read them when they
        start.

    Raises:
        SecurityError: no such member, or it is the node itself.
    """
    open_authority(folder)
    members = open_members(folder)
    full, member = members.find(name)
    if member.name == "node":
        raise SecurityError("the node cannot be shut out of itself; if its key is lost, make a new folder by init")
    if full in members.shut_out:
        return ()
    for robot, own in members.robots.items():
        if member.parent == own.folder and member.name in own.names:
            return members.with_robot(robot, dataclasses.replace(own, revoked=(*own.revoked, member.name))).save()
    return dataclasses.replace(members, revoked=(*members.revoked, member.name)).save()


def hosts_of(certificate: Path) -> list[str]:
    """Names and addresses under which the owner of a certificate can be reached; SecurityError when it has none."""
    from cryptography import x509

    kind = x509.SubjectAlternativeName
    names = read_certificate(certificate, lambda read: read.extensions.get_extension_for_class(kind).value)
    return [str(entry.value) for entry in names]


def _put_certificate(member: Path, credentials: Credentials) -> None:
    replace_file(member / f"{member.name}.key", credentials.key, 0o600)
    replace_file(member / f"{member.name}.pem", credentials.certificate)

"""The life of certificates: who has one, how long it is valid, making it anew, adding and shutting out a member."""

from __future__ import annotations

import datetime
import json
import os
import shutil
from pathlib import Path
from typing import Any

from transport.access_rules import ROLES, access_control
from transport.authority import Credentials, make_certificate
from transport.configuration import sending
from transport.exceptions import SecurityError
from transport.keys import check_name
from transport.security import CONFIGURATION, configured_robot, load_configuration, read_configuration
from transport.terrain_message import Health

# [days] Before its end a certificate is warned of.
WARNING_DAYS = 30
# In `ca`: the role of each member that was added, and who was shut out.
MEMBERS = "members.json"


def days_left(certificate: str | Path) -> float:
    """[days] that a certificate is still valid; negative when it has expired.

    Raises:
        SecurityError: it cannot be read.
    """
    from cryptography import x509

    try:
        end = x509.load_pem_x509_certificate(Path(certificate).read_bytes()).not_valid_after_utc
    except (OSError, ValueError) as error:
        raise SecurityError(f"cannot read {certificate}: {error}") from error
    return (end - datetime.datetime.now(datetime.UTC)).total_seconds() / 86400.0


def expiries(folder: str | Path) -> dict[str, float]:
    """[days] left of each certificate below a security folder, or of the folder of one role, by its path."""
    root = Path(folder)
    found = sorted({*root.glob("*.pem"), *root.glob("*/*.pem")})
    return {str(path.relative_to(root)): days_left(path) for path in found}


def judge_security(folder: str | Path) -> tuple[Health, str]:
    """How a security folder stands, and in words what to do: keys that others can read, certificates that end, rules.

    Returns:
        ERROR for a key that others can read or a certificate that has expired, WARN for one that ends within
        `WARNING_DAYS` and for access rules of an earlier version, else OK.

    Raises:
        SecurityError: there is no certificate, or a file cannot be read.
    """
    root, left = Path(folder), expiries(folder)
    if not left:
        raise SecurityError(f"{folder} holds no certificate; give what `guara security init` made, or a role's folder")
    readable = [path for path in sorted({*root.glob("*.key"), *root.glob("*/*.key")}) if _is_open(path)]
    if readable:
        return Health.ERROR, f"{readable[0].relative_to(root)} can be read by others on this machine; chmod 600 it"
    name, days = min(left.items(), key=lambda item: item[1])
    if days <= 0:
        return Health.ERROR, f"{name} expired {-days:.0f} days ago; `guara security renew`, then copy the folder anew"
    if days <= WARNING_DAYS:
        return Health.WARN, f"{name} expires in {days:.0f} days; `guara security renew`, then copy the folder anew"
    for node in (root, root / "node"):
        if (node / "node.pem").is_file() and (node / CONFIGURATION).is_file() and not _has_present_rules(node):
            return Health.WARN, (
                "the access rules were made by another version: planners may have to judge ages by wall clocks; "
                "`guara security renew`, then copy the folder anew"
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
    """Give members new keys and certificates by the same CA; empty `names` renews all.

    What an earlier version wrote into their configurations is brought up to date: the access rules of the node, and
    how much waits for a link.

    Returns:
        Who was renewed.

    Raises:
        SecurityError: no such member, or the folder lacks its CA.
    """
    root = Path(folder)
    authority = _authority(root)
    members = _members(root)
    chosen = names or tuple(name for name in (*ROLES, *members["added"]) if name not in members["revoked"])
    for name in chosen:
        if name in members["revoked"]:
            raise SecurityError(f"{name} was shut out; add a member of another name instead")
        if not (root / name / CONFIGURATION).is_file():
            raise SecurityError(f"{root} has no member {name!r}; members: {', '.join((*ROLES, *members['added']))}")
    for name in chosen:
        _put_certificate(root / name, name, make_certificate(authority, name, _hosts(root / name / f"{name}.pem")))
        _bring_up_to_date(root / name / CONFIGURATION)
    if "node" in chosen:
        _save(root, members)
    return chosen


def _bring_up_to_date(path: Path) -> None:
    """Add what a member's configuration does not say yet; what its owner changed stays."""
    try:
        configuration = json.loads(path.read_text(encoding="utf-8"))
        link, made = configuration["transport"]["link"], sending()
        configured = link.get("tx", {})
        link["tx"] = {**made, **configured, "queue": {**made["queue"], **configured.get("queue", {})}}
        _replace(path, (json.dumps(configuration, indent=2) + "\n").encode())
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise SecurityError(f"cannot change {path}: {error}; it must be as `guara security init` made it") from error


def add(folder: str | Path, name: str, role: str) -> Path:
    """Make a member of its own name with the rights of a role, such as a second planner.

    Returns:
        Its folder. The node's folder changes too and must be copied to the robot; the node reads it when it starts.

    Raises:
        SecurityError: the name is taken or was shut out, the role cannot be shared, or the folder lacks its CA.
    """
    root, authority = Path(folder), _authority(Path(folder))
    members = _members(root)
    check_name(name, "member")
    if role not in ROLES or role == "node":
        raise SecurityError(f"role is {role!r}; allowed: {', '.join(r for r in ROLES if r != 'node')}")
    if name in members["revoked"] or (root / name).exists() or name == "ca":
        raise SecurityError(f"the name {name!r} is taken or was shut out; names are never used again")
    target = root / name
    target.mkdir()
    text = (root / role / CONFIGURATION).read_text(encoding="utf-8")
    for ending in ("key", "pem"):
        text = text.replace(f'"{role}.{ending}"', f'"{name}.{ending}"')
    (target / CONFIGURATION).write_text(text, encoding="utf-8")
    shutil.copyfile(root / "ca" / "ca.pem", target / "ca.pem")
    _put_certificate(target, name, make_certificate(authority, name, [name]))
    members["added"][name] = role
    _save(root, members)
    return target


def revoke(folder: str | Path, name: str) -> None:
    """Shut a member out: its certificate still opens a link, on which nothing is allowed any more.

    The node's folder changes and must be copied to the robot; the node reads it when it starts.

    Raises:
        SecurityError: no such member, or it is the node itself.
    """
    root = Path(folder)
    _authority(root)
    members = _members(root)
    if name == "node":
        raise SecurityError("the node cannot be shut out of itself; if its key is lost, make a new folder by init")
    if name not in (*ROLES, *members["added"]):
        raise SecurityError(f"{root} has no member {name!r}; members: {', '.join((*ROLES, *members['added']))}")
    if name not in members["revoked"]:
        members["revoked"].append(name)
    _save(root, members)


def _authority(root: Path) -> Credentials:
    try:
        return Credentials((root / "ca" / "ca.pem").read_bytes(), (root / "ca" / "ca.key").read_bytes())
    except OSError as error:
        raise SecurityError(
            f"cannot read the CA of {root}: {error.strerror}; it is where `guara security init` was run"
        ) from error


def _members(root: Path) -> dict[str, Any]:
    path = root / "ca" / MEMBERS
    try:
        found = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
        return {"added": dict(found.get("added", {})), "revoked": list(found.get("revoked", []))}
    except (OSError, ValueError, AttributeError, TypeError) as error:
        raise SecurityError(f"cannot read {path}: {error}") from error


def _save(root: Path, members: dict[str, Any]) -> None:
    """Write the node's rules first: a list that says more than the rules do would be a promise not kept."""
    path = root / "node" / CONFIGURATION
    try:
        configuration = json.loads(path.read_text(encoding="utf-8"))
        names = {role: [role] for role in ROLES}
        for name, role in members["added"].items():
            names[role].append(name)
        kept = {role: [name for name in who if name not in members["revoked"]] for role, who in names.items()}
        configuration["access_control"] = access_control(configured_robot(root / "node"), kept)
        _replace(path, (json.dumps(configuration, indent=2) + "\n").encode())
        _replace(root / "ca" / MEMBERS, (json.dumps(members, indent=2) + "\n").encode())
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise SecurityError(f"cannot change {path}: {error}; it must be as `guara security init` made it") from error
    load_configuration(root / "node")


def _hosts(certificate: Path) -> list[str]:
    from cryptography import x509

    try:
        names: Any = (
            x509.load_pem_x509_certificate(certificate.read_bytes())
            .extensions.get_extension_for_class(x509.SubjectAlternativeName)
            .value
        )
    except (OSError, ValueError, x509.ExtensionNotFound) as error:
        raise SecurityError(f"cannot read {certificate}: {error}") from error
    return [str(entry.value) for entry in names]


def _put_certificate(root: Path, name: str, credentials: Credentials) -> None:
    _replace(root / f"{name}.key", credentials.key, 0o600)
    _replace(root / f"{name}.pem", credentials.certificate)


def _replace(path: Path, data: bytes, mode: int = 0o644) -> None:
    temporary = path.with_name(f".{path.name}.part")
    temporary.unlink(missing_ok=True)
    descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    with os.fdopen(descriptor, "wb") as file:
        file.write(data)
        os.fsync(file.fileno())
    temporary.replace(path)

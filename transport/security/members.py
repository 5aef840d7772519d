"""Members of a security folder (those of each robot, routers, fleet members), and their access rules."""

from __future__ import annotations

import dataclasses
import json
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from transport.exceptions import SecurityError, errors_as
from transport.security.access_rules import FLEET, ROLES, ROUTER, Neighbours, access_control, router_access_control
from transport.security.authority import Credentials, read_certificate
from transport.security.folder import CONFIGURATION, configured_robot, json_text, read_configuration
from transport.security.whole_folder import create_folder, write_file

# File in `ca` that lists routers, fleet members, added members with their roles, and revoked members.
MEMBERS = "members.json"


@dataclass(frozen=True, slots=True)
class Robot:
    """Members of a robot.

    Attributes:
        folder: folder that contains the folders of the members.
        added: roles of additional members, by name. In addition, each role has one member with its name.
        revoked: names of the revoked members.
    """

    folder: Path
    added: Mapping[str, str] = field(default_factory=dict)
    revoked: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all members, including revoked ones."""
        return (*ROLES, *self.added)


@dataclass(frozen=True, slots=True)
class Router:
    """Site router: Zenoh router that serves several robots.

    Attributes:
        robots: instance names of the robots that the router serves.
        uplink: name of the router to which this router connects; empty = none.
        scans: True if nodes accept scan requests through this router, from its clients and, unless `summary_only`, from
            the router above. A node that is a client of this router accepts requests of its own planners in any case.
        summary_only: True if the router above receives only summaries, status and liveliness tokens.
    """

    robots: tuple[str, ...]
    uplink: str = ""
    scans: bool = False
    summary_only: bool = False


@dataclass(frozen=True, slots=True)
class Members:
    """Members of a security folder.

    Attributes:
        root: the security folder.
        robots: members of each robot, by instance name.
        routers: routers by name; the folder of a router has the same name.
        fleet: names of the members that may list the live robots and read their status.
        revoked: names of the revoked routers and fleet members.
    """

    root: Path
    robots: Mapping[str, Robot]
    routers: Mapping[str, Router] = field(default_factory=dict)
    fleet: tuple[str, ...] = ()
    revoked: tuple[str, ...] = ()

    @property
    def folders(self) -> dict[str, Path]:
        """Folder of each member by its name in commands. With a single robot, names have no prefix `<robot>.`."""
        found = {
            (name if len(self.robots) == 1 else f"{robot}.{name}"): own.folder / name
            for robot, own in self.robots.items()
            for name in own.names
        }
        found |= {f"{name}.{ROUTER}": self.root / name for name in self.routers}
        return found | {f"{name}.{FLEET}": self.root / name for name in self.fleet}

    @property
    def revoked_names(self) -> frozenset[str]:
        """Names of the revoked members, as in `folders`."""
        gone = {own.folder / name for own in self.robots.values() for name in own.revoked}
        gone |= {self.root / name for name in self.revoked}
        return frozenset(name for name, folder in self.folders.items() if folder in gone)

    def find(self, name: str) -> tuple[str, Path]:
        """Return full name and folder of a member.

        The endings `.router` and `.fleet` may be omitted. If there is a single robot, the prefix `<robot>.` may be
        added.

        Raises:
            SecurityError: there is no such member.
        """
        folders = self.folders
        robots = "" if len(self.robots) != 1 else next(iter(self.robots))
        for candidate in (name, name.removeprefix(f"{robots}."), f"{name}.{ROUTER}", f"{name}.{FLEET}"):
            if candidate in folders:
                return candidate, folders[candidate]
        raise SecurityError(f"{self.root} has no member {name!r}; members: {', '.join(folders)}")

    def names_of(self, robot: str) -> dict[str, list[str]]:
        """Return the common names of a robot's members by role, without revoked members."""
        own = self.robots[robot]
        roles = {**{role: role for role in ROLES}, **own.added}
        named: dict[str, list[str]] = {role: [] for role in ROLES}
        for name, role in roles.items():
            if name not in own.revoked:
                named[role].append(common_name(own.folder / name / f"{name}.pem"))
        return named

    def routers_of(self, robot: str, *, scanning: bool = False) -> list[str]:
        """Return the common names of the routers that serve a robot; `scanning`: only those that may request scans."""
        return [
            f"{name}.{ROUTER}"
            for name, router in self.routers.items()
            if robot in router.robots and name not in self.revoked and (router.scans or not scanning)
        ]

    def _rules_of_node(self, robot: str) -> dict[str, Any]:
        return access_control(
            robot,
            self.names_of(robot),
            routers=self.routers_of(robot),
            scanning_routers=self.routers_of(robot, scanning=True),
        )

    def rules_of_router(self, name: str) -> dict[str, Any]:
        """Return the access rules of a router."""
        router = self.routers[name]
        above = [f"{router.uplink}.{ROUTER}"] if router.uplink and router.uplink not in self.revoked else []
        below = {
            f"{other}.{ROUTER}": found.robots
            for other, found in self.routers.items()
            if found.uplink == name and other not in self.revoked
        }
        return router_access_control(
            {robot: self.names_of(robot) for robot in router.robots},
            neighbours=Neighbours(above, below, scans=router.scans, summary_only=router.summary_only),
            fleet=[f"{member}.{FLEET}" for member in self.fleet if member not in self.revoked],
        )

    def save(self) -> tuple[Path, ...]:
        """Write the rules of nodes and routers, then the list of members.

        The rules are written first, so that the list never contains a member that has no rules yet.

        Returns:
            The folders whose rules changed and which must be copied to their machines again.

        Raises:
            SecurityError: a certificate or configuration cannot be read, a configuration does not have the form that
                `guara security` writes, or a file cannot be written.
        """
        rules = {own.folder / "node": self._rules_of_node(robot) for robot, own in self.robots.items()}
        rules |= {self.root / name: self.rules_of_router(name) for name in self.routers}
        # Read all files before writing the first, so that an unreadable one leaves all of them unchanged.
        for folder in rules:
            edit_configuration(folder / CONFIGURATION, lambda _: False)
            read_configuration(folder, "mode")
        changed = [folder for folder, section in rules.items() if _put_rules(folder / CONFIGURATION, section)]
        data = {
            "robots": {
                robot: {"added": dict(own.added), "revoked": list(own.revoked)} for robot, own in self.robots.items()
            },
            "routers": {
                name: {**dataclasses.asdict(router), "robots": list(router.robots)}
                for name, router in self.routers.items()
            },
            "fleet": list(self.fleet),
            "revoked": list(self.revoked),
        }
        path = self.root / "ca" / MEMBERS
        with errors_as(SecurityError, f"cannot write {path}"):
            replace_file(path, json_text(data).encode())
        return tuple(changed)

    def with_robot(self, robot: str, own: Robot) -> Members:
        """Return a copy in which the members of a robot are replaced, or a robot is added."""
        return replace(self, robots={**self.robots, robot: own})


def open_members(folder: str | Path) -> Members:
    """Read the members of a folder made by `init_security`.

    Raises:
        SecurityError: the list of members or the configuration of a node cannot be read.
    """
    root = Path(folder)
    folders = sorted(path.parent.parent for path in root.glob(f"*/node/{CONFIGURATION}"))
    if (root / "node" / CONFIGURATION).is_file():
        folders.insert(0, root)
    robots = {configured_robot(folder / "node"): Robot(folder) for folder in folders}
    path = root / "ca" / MEMBERS
    with errors_as(SecurityError, f"cannot read {path}", OSError, ValueError, AttributeError, TypeError, KeyError):
        found = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
        lists = found.get("robots")
        if lists is None:
            # Lists of an earlier version contain the members of a single robot.
            lists, found = dict.fromkeys(robots, found), {}
        members = {}
        for robot, own in robots.items():
            saved = lists.get(robot, {})
            members[robot] = Robot(own.folder, dict(saved.get("added", {})), tuple(saved.get("revoked", ())))
        routers = {
            str(name): Router(**{**router, "robots": tuple(router["robots"])})
            for name, router in found.get("routers", {}).items()
        }
        return Members(root, members, routers, tuple(found.get("fleet", [])), tuple(found.get("revoked", [])))


def add_folder(folder: Path, write: Callable[[Path], None], larger: Callable[[], Members]) -> Path:
    """Create the folder of a new member or robot with `write`, then save the members returned by `larger`.

    If saving fails, the folder is removed.

    Raises:
        SecurityError: the folder cannot be written, or `Members.save` fails.
    """
    create_folder(folder, write)
    try:
        larger().save()
    except SecurityError:
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return folder


def open_authority(folder: str | Path) -> Credentials:
    """Read the CA of a security folder.

    Raises:
        SecurityError: certificate or key of the CA cannot be read.
    """
    root = Path(folder)
    with errors_as(SecurityError, f"cannot read the CA of {root}; it is kept only where `guara security init` was run"):
        return Credentials((root / "ca" / "ca.pem").read_bytes(), (root / "ca" / "ca.key").read_bytes())


def common_name(certificate: Path) -> str:
    """Return the common name in a certificate, which identifies its owner in the access rules.

    Raises:
        SecurityError: the certificate cannot be read, or contains no common name.
    """
    from cryptography.x509.oid import NameOID

    found = read_certificate(certificate, lambda read: read.subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0])
    return str(found.value)


def _put_rules(path: Path, rules: dict[str, Any]) -> bool:
    def change(configuration: dict[str, Any]) -> bool:
        is_news: bool = configuration.get("access_control") != rules
        configuration["access_control"] = rules
        return is_news

    return edit_configuration(path, change)


def edit_configuration(path: Path, change: Callable[[dict[str, Any]], bool]) -> bool:
    """Pass a member's configuration to `change`, which edits it in place; if `change` returns True, write it.

    Returns:
        The result of `change`.

    Raises:
        SecurityError: the configuration cannot be read or written, or does not have the form that `guara security`
            writes.
    """
    what = f"cannot change {path}, which must have the form that `guara security` writes"
    with errors_as(SecurityError, what, OSError, ValueError, KeyError, TypeError, AttributeError):
        configuration = json.loads(path.read_text(encoding="utf-8"))
        is_changed = change(configuration)
        if is_changed:
            replace_file(path, json_text(configuration).encode())
        return is_changed


def replace_file(path: Path, data: bytes, *, private: bool = False) -> None:
    """Write or replace a file atomically."""
    temporary = path.with_name(f".{path.name}.part")
    temporary.unlink(missing_ok=True)
    write_file(temporary, data, private=private)
    temporary.replace(path)

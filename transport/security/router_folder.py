"""Folder of a router that serves several robots: certificate, and complete configuration for a stock `zenohd`."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

from transport.configuration import check_tls, router_configuration, tls_endpoint
from transport.exceptions import SecurityError
from transport.keys import check_name
from transport.security.access_rules import ROUTER
from transport.security.certificates import add_robot, check_free, hosts_of
from transport.security.folder import (
    DEFAULT_LISTEN,
    LONGEST_NAME,
    check_robot,
    configured_endpoints,
    init_security,
    json_text,
    own_hosts,
    tls_links,
    write_member,
)
from transport.security.members import Members, Router, add_folder, open_authority, open_members


def make_router(
    folder: str | Path,
    robots: Sequence[str],
    *,
    name: str = ROUTER,
    hosts: Sequence[str] = (),
    listen: str = DEFAULT_LISTEN,
    uplink: str = "",
    uplink_host: str = "",
    scans: bool = False,
    summary_only: bool = False,
    place: str | None = None,
) -> Path:
    """Make the folder of a router, and grant the router access to its robots' nodes and to the router above.

    The router gets only the rights that it needs. At a node, it has those of a viewer (with `scans`, of a planner). To
    the router above, it sends what its robots' nodes publish. To both, all clients behind the router appear under its
    certificate.

    Args:
        folder: folder made by `init_security`; if it does not exist, it is made for all these robots.
        robots: instance names of the robots that the router serves; the folders of new robots are made too.
        name: name of the router. Its folder is `folder/name`, and the common name of its certificate is
            `<name>.router`.
        hosts: host names and addresses of the router for robots, clients and routers below.
        listen: endpoint of the router.
        uplink: name of a router in the same folder to which this router connects; empty = none.
        uplink_host: host name or address of that router; empty = the first host in its certificate.
        scans: True if scans may be requested through this router, by its clients and by the router above.
        summary_only: True if the router above receives only summaries, status and liveliness tokens. Meant for a slow
            link, or for a router above with very many robots, which then handles fewer keys.
        place: folder of the router's files on the machine where it runs; None = the folder made here.

    Returns:
        The new folder. The folders of the robots' nodes and of the router above change too; copy them to their machines
        again.

    Raises:
        SecurityError: a name is taken, too long, reserved, revoked or unknown, no robot is given, the router above does
            not serve all of the robots, `summary_only` is set without an uplink, or the folder lacks its CA or
            cannot be read or written.
        KeyNameError: a name cannot be part of a key.
        ConfigurationError: `listen` is not a TLS endpoint.
    """
    check_tls(listen)
    for robot in robots:
        check_robot(robot)
    if not Path(folder).exists() and robots:
        init_security(folder, robot=list(dict.fromkeys(robots)))
    authority, members = open_authority(folder), open_members(folder)
    target = members.root / check_name(name, ROUTER)
    check_free(members, name, target)
    _check(members, name, robots, uplink, summary_only=summary_only)
    for robot in dict.fromkeys(robots):
        if robot not in members.robots:
            add_robot(folder, robot)
    members = open_members(folder)
    above = _endpoint_of(members, uplink, uplink_host) if uplink else None
    configuration = router_configuration([listen], uplink=above)
    configuration["adminspace"] = {"enabled": False}
    path = str(target.resolve()) if place is None else place.rstrip("/")
    configuration["transport"]["link"] |= tls_links(name, listens=True, prefix=f"{path}/")
    router = Router(tuple(dict.fromkeys(robots)), uplink, scans=scans, summary_only=summary_only)
    larger = dataclasses.replace(members, routers={**members.routers, name: router})
    configuration["access_control"] = larger.rules_of_router(name)

    def write(made: Path) -> None:
        write_member(made, authority, f"{name}.{ROUTER}", own_hosts(hosts), json_text(configuration))

    return add_folder(target, write, lambda: larger)


def _check(members: Members, name: str, robots: Sequence[str], uplink: str, *, summary_only: bool) -> None:
    if len(name) > LONGEST_NAME:
        raise SecurityError(f"router name {name!r} is too long for a certificate; allowed: {LONGEST_NAME} characters")
    if not robots:
        raise SecurityError("no robot is given; give at least one robot that the router serves")
    if summary_only and not uplink:
        raise SecurityError(
            "summary_only restricts what the router above receives; give the name of that router (uplink)"
        )
    if not uplink:
        return
    if uplink not in members.routers or uplink in members.revoked:
        known = ", ".join(other for other in members.routers if other not in members.revoked) or "none"
        raise SecurityError(f"{members.root} has no router {uplink!r} for the uplink; routers: {known}")
    missing = [robot for robot in robots if robot not in members.routers[uplink].robots]
    if missing:
        raise SecurityError(
            f"router {uplink!r} does not serve {', '.join(missing)}; the uplink of a router must serve all its robots"
        )


def _endpoint_of(members: Members, router: str, host: str) -> str:
    port = configured_endpoints(members.root / router, "listen")[0].rpartition(":")[2]
    return tls_endpoint(host or hosts_of(members.root / router / f"{router}.pem")[0], port)

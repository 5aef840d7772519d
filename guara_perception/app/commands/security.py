"""`guara security`: manage certificates and access rules of nodes, clients and routers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from guara_perception.app.options import FILE


@click.group(name="security")
def command() -> None:
    """Create and check certificates and access rules.

    \b
    Example:
      guara security init keys --host robot.local
      guara security check keys
      guara security router site --robot rex --robot ada --host site.local
    """


@command.command(name="init")
@click.argument("folder", type=FILE)
@click.option("--robot", "robots", multiple=True, default=["guara"], help="instance name; repeatable")
@click.option(
    "--host",
    "hosts",
    multiple=True,
    help="name or address at which clients reach the node; repeatable; with several robots: one for each, in order",
)
def init(folder: Path, robots: tuple[str, ...], hosts: tuple[str, ...]) -> None:
    """Create a CA and one folder per role in the new FOLDER.

    The roles are node, gait, planner and viewer. With several robots, FOLDER has one folder per robot, with the folders
    of its roles.

    \b
    Example:
      guara security init keys --host robot.local
      guara security init site --robot rex --host rex.local --robot ada --host ada.local
    """
    from transport.security.folder import init_security

    made = init_security(folder, robot=robots, hosts=hosts)
    folders = "ca, node, gait, planner, viewer" if len(robots) == 1 else f"ca, {', '.join(robots)}"
    click.echo(f"{made}: {folders}; give each machine only its own folder, and keep ca secret")


@command.command(name="robot")
@click.argument("folder", type=FILE)
@click.argument("name")
@click.option("--host", "hosts", multiple=True, help="name or address at which clients reach its node; repeatable")
def add_robot(folder: Path, name: str, hosts: tuple[str, ...]) -> None:
    """Add the robot NAME to FOLDER, with a folder for each role.

    Its certificates are of the same CA.

    \b
    Example:
      guara security robot site bob --host bob.local
    """
    from transport.security.certificates import add_robot as add_to

    made = add_to(folder, name, hosts=hosts)
    click.echo(f"{made}: node, gait, planner, viewer; give each machine only its own folder")


@command.command(name="router")
@click.argument("folder", type=FILE)
@click.option("--robot", "robots", multiple=True, required=True, help="instance name of a served robot; repeatable")
@click.option("--name", default="router", help="name of the router and of its folder")
@click.option("--host", "hosts", multiple=True, help="name or address at which others reach the router; repeatable")
@click.option("--listen", default="tls/0.0.0.0:7447", help="endpoint on which the router listens")
@click.option("--uplink", default="", show_default="none", help="router in FOLDER to which this router connects")
@click.option("--uplink-host", default="", show_default="first of its hosts", help="name or address of that router")
@click.option("--scans", is_flag=True, help="let planners request scans through this router")
@click.option("--summary-only", is_flag=True, help="send only summaries, status and liveliness to the uplink")
@click.option(
    "--place", help="path of the router's folder on the machine where it runs; default: the folder created here"
)
def router(folder: Path, robots: tuple[str, ...], uplink: str, **given: Any) -> None:
    """Create the certificate and configuration of a Zenoh router.

    The router (`zenohd`) serves one or more robots. Robots that FOLDER does not have yet are added, and FOLDER is
    created if needed.

    \b
    Example:
      guara security router site --robot rex --robot ada --host site.local
      guara security router site --name room --robot rex --uplink router
    """
    from transport.security.members import open_members
    from transport.security.router_folder import make_router

    before = set(open_members(folder).robots) if folder.exists() else set()
    made = make_router(folder, robots, uplink=uplink, **given)
    click.echo(f"{made}: for {', '.join(robots)}; start it with: zenohd -c {made / 'zenoh.json5'}")
    fresh = [robot for robot in robots if robot not in before]
    if fresh:
        click.echo(f"added to {folder}, with a folder per role: {', '.join(fresh)}")
    others = f" and the folder of {uplink}" if uplink else ""
    click.echo(f"copy the node folder of each of these robots{others} to their machines and restart the programs there")


@command.command(name="check")
@click.argument("folder", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--robot", help="instance name of the robot; default: all robots of the folder")
@click.pass_context
def check(context: click.Context, folder: Path, robot: str | None) -> None:
    """Try every action in each role and print what is allowed.

    Copies of each node and router run on this machine for this; running nodes are not affected. Exit 1 if any result
    differs from the rules.

    \b
    Example:
      guara security check keys
      guara security check site --robot rex
    """
    from transport.security.members import open_members
    from transport.security_check import check_router, check_security, format_matrix

    members = open_members(folder)
    robots = [robot] if robot or not members.robots else list(members.robots)
    found = {f"node of {name}": check_security(folder, robot=name) for name in robots}
    for router, served in members.routers.items():
        for name in served.robots:
            if robot in (None, name):
                found[f"router {router}, robot {name}"] = check_router(folder, router, robot=name)
    for where, permissions in found.items():
        if len(found) > 1:
            click.echo(f"{where}:")
        click.echo(format_matrix(permissions))
    if any(permission.allowed != permission.expected for rows in found.values() for permission in rows):
        context.exit(1)


@command.command(name="renew")
@click.argument("folder", type=FILE)
@click.argument("names", nargs=-1)
def renew(folder: Path, names: tuple[str, ...]) -> None:
    """Renew keys and certificates of the members of FOLDER.

    All that are not revoked are renewed, or only NAMES, with the same CA.

    \b
    Example:
      guara security renew keys
    """
    from transport.security.certificates import renew as renew_certificates

    done = renew_certificates(folder, names)
    click.echo(f"renewed: {', '.join(done)}; copy each folder to its machine again and restart the programs there")


@command.command(name="add")
@click.argument("folder", type=FILE)
@click.argument("name")
@click.option(
    "--role",
    type=click.Choice(["planner", "viewer", "gait", "fleet"]),
    default="planner",
    help="role whose rights the member gets",
)
def add(folder: Path, name: str, role: str) -> None:
    """Add the member NAME with the rights of a role.

    If FOLDER has several robots, write ROBOT.NAME. Members with the role `fleet` belong to no robot: they connect to
    routers, list the running robots and read their status.

    \b
    Example:
      guara security add keys planner-2
      guara security add site rex.planner-2
      guara security add site desk --role fleet
    """
    from transport.security.certificates import add as add_member

    made = add_member(folder, name, role)
    if role == "fleet":
        click.echo(f"{made}: for the new fleet member; copy the folders of the routers again and restart the routers")
    else:
        click.echo(f"{made}: for the new {role}; copy {made.parent / 'node'} to the robot again and restart the node")
        _print_routers(folder, made.parent)


@command.command(name="revoke")
@click.argument("folder", type=FILE)
@click.argument("name")
def revoke(folder: Path, name: str) -> None:
    """Revoke the member NAME, for instance after theft of its machine.

    The name cannot be used again.

    \b
    Example:
      guara security revoke keys planner
      guara security revoke site rex.planner
    """
    from transport.security.certificates import revoke as revoke_member

    changed = ", ".join(map(str, revoke_member(folder, name)))
    if changed:
        click.echo(
            f"copy {changed} to the machines again and restart the programs there; until then {name} keeps its access"
        )
    else:
        click.echo(f"{name} was already revoked; it has no access where the rules in {folder} are in force")


def _print_routers(folder: Path, robot_folder: Path) -> None:
    from transport.security.members import open_members

    members = open_members(folder)
    routers = [
        name
        for name, router in members.routers.items()
        if name not in members.revoked and any(members.robots[robot].folder == robot_folder for robot in router.robots)
    ]
    if routers:
        click.echo(f"also copy the folders of these routers again and restart the routers: {', '.join(routers)}")

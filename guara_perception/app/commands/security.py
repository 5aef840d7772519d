"""`guara security`: certificates and access rules for planners on other machines."""

from __future__ import annotations

from pathlib import Path

import click


@click.group(name="security")
def command() -> None:
    """Make and check certificates and access rules.

    \b
    Example:
      guara security init keys --host robot.local
      guara security check keys
    """


@command.command(name="init")
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--robot", default="guara", show_default=True, help="instance name of the robot")
@click.option("--host", "hosts", multiple=True, help="name or address by which clients reach the node; repeatable")
def init(folder: Path, robot: str, hosts: tuple[str, ...]) -> None:
    """Make a CA and one folder per role (node, gait, planner, viewer) in the new FOLDER.

    \b
    Example:
      guara security init keys --host robot.local
    """
    from transport.security import init_security

    made = init_security(folder, robot=robot, hosts=hosts)
    click.echo(f"{made}: ca, node, gait, planner, viewer; give each machine only its own folder, keep ca safe")


@command.command(name="check")
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--robot", help="instance name of the robot; default: what the folder says")
@click.pass_context
def check(context: click.Context, folder: Path, robot: str | None) -> None:
    """Connect as each role and print what it may do; exit 1 when that is not as it should be.

    \b
    Example:
      guara security check keys
    """
    from transport.security_check import check_security, format_matrix

    permissions = check_security(folder, robot=robot)
    click.echo(format_matrix(permissions))
    if any(permission.allowed != permission.expected for permission in permissions):
        context.exit(1)


@command.command(name="renew")
@click.argument("folder", type=click.Path(path_type=Path))
@click.argument("names", nargs=-1)
def renew(folder: Path, names: tuple[str, ...]) -> None:
    """Give all members of FOLDER, or those of NAMES, new keys and certificates by the same CA.

    \b
    Example:
      guara security renew keys
    """
    from transport.certificates import renew as renew_certificates

    done = renew_certificates(folder, names)
    click.echo(f"renewed: {', '.join(done)}; copy each folder to its machine again and restart what runs there")


@command.command(name="add")
@click.argument("folder", type=click.Path(path_type=Path))
@click.argument("name")
@click.option("--role", type=click.Choice(["planner", "viewer", "gait"]), default="planner", show_default=True)
def add(folder: Path, name: str, role: str) -> None:
    """Make the member NAME with the rights of a role, such as a second planner.

    \b
    Example:
      guara security add keys planner-2
    """
    from transport.certificates import add as add_member

    made = add_member(folder, name, role)
    click.echo(f"{made}: for the new {role}; copy {folder / 'node'} to the robot again and restart the node")


@command.command(name="revoke")
@click.argument("folder", type=click.Path(path_type=Path))
@click.argument("name")
def revoke(folder: Path, name: str) -> None:
    """Shut the member NAME out, as when its machine was stolen; its name is never used again.

    \b
    Example:
      guara security revoke keys planner
    """
    from transport.certificates import revoke as revoke_member

    revoke_member(folder, name)
    click.echo(f"{name} is shut out as soon as {folder / 'node'} is copied to the robot and the node restarted")

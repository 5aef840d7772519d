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

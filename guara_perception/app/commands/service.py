"""`guara robot service`: print or install a systemd unit for the node."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from guara_perception.app.options import FILE, with_options
from guara_perception.exceptions import InvalidInput, MissingFile

UNITS = Path("/etc/systemd/system")
NODE = Path("/etc/guara/node.toml")


def unit_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options that describe a unit to a command."""
    options = (
        click.option("--node", type=FILE, default=NODE, help="node.toml with the options of `guara run`"),
        click.option("--name", default="guara", help="name of the service"),
        click.option("--user", default="guara", help="user account that runs the node"),
    )
    return with_options(command, options)


@click.group(name="service")
def command() -> None:
    """Run the node as a systemd service, restarted when it fails.

    \b
    Example:
      guara robot service print --node node.toml
      guara robot service install --node /etc/guara/node.toml
    """


@command.command(name="print")
@unit_options
def print_unit(node: Path, name: str, user: str) -> None:
    """Print the unit without installing it.

    \b
    Example:
      guara robot service print --node node.toml
    """
    from guara_perception.app.service import unit

    click.echo(unit(name, node, user), nl=False)


@command.command(name="install")
@unit_options
@click.option("--units", type=FILE, default=UNITS, help="folder of the systemd units")
@click.option("--force", is_flag=True, help="replace an existing unit")
def install(node: Path, name: str, user: str, units: Path, force: bool) -> None:
    """Write the unit, and print the commands to run next.

    \b
    Example:
      guara robot service install --node /etc/guara/node.toml
    """
    import pwd

    from guara_perception.app.service import unit
    from guara_perception.files import whole_file

    text, path = unit(name, node, user), units / f"{name}.service"
    if not node.is_file():
        raise MissingFile(f"{node}: no such file; the service reads its options from this file (docs/operations.md)")
    if path.exists() and path.read_text(encoding="utf-8") != text and not force:
        raise InvalidInput(f"{path} exists and differs; give --force to replace it, or another --name")
    with whole_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
        temporary.chmod(0o644)
    click.echo(f"{path}: written; next:")
    try:
        pwd.getpwnam(user)
    except KeyError:
        click.echo(f"  useradd --system --user-group --no-create-home {user}")
    click.echo(f"  guara run --check --node {node}")
    click.echo(f"  systemctl daemon-reload && systemctl enable --now {name}")
    click.echo(f"  journalctl -fu {name}")

"""`guara fleet`: which robots are alive on a router, and their state."""

from __future__ import annotations

import dataclasses
import json
import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from transport.fleet import RobotState

COLUMNS = ("robot", "step", "age", "health", "links")


@click.command(name="fleet")
@click.option("--connect", "endpoint", help="router of the site; default: tcp/127.0.0.1:7447")
@click.option("--robot", "--name", "robots", multiple=True, help="only this instance name; repeatable")
@click.option("--security", type=click.Path(path_type=Path), help="folder of a member with the role fleet")
@click.option("--timeout", type=click.FloatRange(min=0.1), default=2.0, show_default=True, help="seconds to wait")
@click.option("--json", "as_json", is_flag=True, help="print one JSON list instead")
def command(
    endpoint: str | None, robots: tuple[str, ...], security: Path | None, timeout: float, as_json: bool
) -> None:
    """List the robots that are alive: stance pause, age of the last grid, health and links.

    Signs of life and status are asked for, grids are not touched.

    \b
    Example:
      guara fleet --connect tcp/127.0.0.1:7447
      guara fleet --connect tls/site.local:7447 --security desk --json
    """
    from transport import open_client
    from transport.fleet import robot_states

    with open_client(endpoint, security=security) as session:
        states = robot_states(session, robots=robots, timeout=timeout)
    if as_json:
        click.echo(json.dumps([_plain(state) for state in states]))
        return
    rows = [COLUMNS, *(_row(state) for state in states)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(COLUMNS))]
    for row in rows:
        click.echo("  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip())
    for state in states:
        if state.message:
            click.echo(f"{state.robot}: {state.message}")


def _row(state: RobotState) -> tuple[str, ...]:
    step = "-" if state.step is None else str(state.step)
    if state.standing is False:
        step += " (moves)"
    age = "-" if math.isnan(state.age) else f"{state.age:.1f} s"
    return state.robot, step, age, state.health.name.lower(), str(state.links)


def _plain(state: RobotState) -> dict[str, object]:
    plain = dataclasses.asdict(state)
    return {**plain, "age": None if math.isnan(state.age) else state.age, "health": state.health.name.lower()}

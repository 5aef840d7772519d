"""`guara listen`: print the grids of a node as received by a planner, or list the running robots."""

from __future__ import annotations

import dataclasses
import json
import math
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from guara_perception.app.options import FILE
from guara_perception.exceptions import InvalidInput
from guara_perception.terrain.layers.layered_grid import EXTENTS
from transport.keys import DEFAULT_ROBOT

if TYPE_CHECKING:
    from guara_perception.app.client import TerrainClient
    from transport.fleet import RobotState

# [s] Longest wait for the connection.
CONNECTING_SECONDS = 5.0
# [s] Default of --timeout with --all: time to wait for the answers to each query.
ANSWER_SECONDS = 2.0
# [s] Time after which a missing node is reported; its liveliness token normally arrives much sooner.
SILENCE = 5.0
COLUMNS = ("robot", "step", "age", "health", "links")


@click.command(name="listen")
@click.option(
    "--connect", "endpoint", help="endpoint of node or router; default: that of --security, or tcp/127.0.0.1:7447"
)
@click.option("--name", "--robot", "names", multiple=True, help="instance name; default: guara, all with --all")
@click.option("--extent", type=click.Choice(EXTENTS), default="footprint", help="grid of each scan, or the fused map")
@click.option(
    "--encoding",
    type=click.Choice(["lossless", "compact"]),
    default="lossless",
    help="compact: about an eighth of the size, for slow links",
)
@click.option("--security", type=FILE, help="folder of a role made by `guara security init`")
@click.option("--count", type=click.IntRange(min=1), help="end after this many grids or withdrawals; default: Ctrl-C")
@click.option(
    "--timeout",
    type=click.FloatRange(min=0.1),
    help="fail if no grid arrives for this many seconds; with --all: time to wait for answers",
)
@click.option("--all", "lists_robots", is_flag=True, help="instead, list the running robots once")
@click.option("--json", "as_json", is_flag=True, help="print a JSON object per grid instead; with --all: a JSON list")
def command(
    endpoint: str | None,
    names: tuple[str, ...],
    extent: str,
    encoding: str,
    security: Path | None,
    count: int | None,
    timeout: float | None,
    lists_robots: bool,
    as_json: bool,
) -> None:
    """Print the newest usable grid of the node, then newer grids and withdrawals as they arrive, one line each.

    With --all, print the running robots, each with pause, age of the last grid, health and links, and exit. Only
    liveliness and status are queried; no grids are transferred.

    \b
    Example:
      guara listen --connect tcp/127.0.0.1:7447 --count 1
      guara listen --connect tcp/127.0.0.1:7447 --encoding compact --count 1
      guara listen --connect tcp/127.0.0.1:7447 --all
    """
    if lists_robots:
        list_robots(endpoint, names, security, timeout or ANSWER_SECONDS, as_json)
        return
    from guara_perception.app.client import TerrainClient
    from guara_perception.app.summary import facts, summary

    if len(names) > 1:
        raise InvalidInput(f"--name is {', '.join(names)}; allowed: one robot (--all lists several)")
    robot = names[0] if names else DEFAULT_ROBOT
    seen = 0
    connecting = CONNECTING_SECONDS if timeout is None else min(timeout, CONNECTING_SECONDS)
    with TerrainClient(endpoint, robot=robot, security=security, timeout=connecting, encoding=encoding) as client:
        try:
            if timeout is None:
                report_missing_node(client, robot)
            for terrain in client.stream(timeout, extent):
                seen += 1
                sequence = terrain.record.sequence
                if as_json:
                    click.echo(json.dumps({"name": robot, "sequence": sequence, **facts(terrain)}))
                else:
                    click.echo(f"{robot} {extent} #{sequence}: {summary(terrain)}")
                if seen == count:
                    break
        except KeyboardInterrupt:
            click.echo(f"stopped; grids received: {seen}", err=True)


def report_missing_node(client: TerrainClient, robot: str) -> None:
    """Print a line on standard error if the node is not seen within `SILENCE` seconds."""
    deadline = time.monotonic() + SILENCE
    while not client.is_alive:
        if time.monotonic() > deadline:
            click.echo(
                f"waiting for a node with instance name {robot!r}: no such node is visible here; `guara listen --all` "
                "lists the running robots, and --name selects one",
                err=True,
            )
            return
        time.sleep(0.05)


def list_robots(
    endpoint: str | None, names: tuple[str, ...], security: Path | None, timeout: float, as_json: bool
) -> None:
    """Print the running robots as a table followed by the messages of their status, or as a JSON list."""
    from transport import open_client
    from transport.fleet import robot_states

    with open_client(endpoint, security=security) as session:
        states = robot_states(session, robots=names, timeout=timeout)
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
        step += " (moving)"
    age = "-" if math.isnan(state.age) else f"{state.age:.1f} s"
    return state.robot, step, age, state.health.name.lower(), str(state.links)


def _plain(state: RobotState) -> dict[str, object]:
    plain = dataclasses.asdict(state)
    return {**plain, "age": None if math.isnan(state.age) else state.age, "health": state.health.name.lower()}

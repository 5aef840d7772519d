"""`guara listen`: what a planner sees, one line per grid."""

from __future__ import annotations

import json
from pathlib import Path

import click

from guara_perception.terrain.layers.layered_grid import EXTENTS

# [s] Longest time to wait for the connection.
CONNECTING_SECONDS = 5.0


@click.command(name="listen")
@click.option("--connect", "endpoint", help="where the node listens; default: tcp/127.0.0.1:7447")
@click.option("--robot", "--name", "robot", default="guara", show_default=True, help="instance name of the robot")
@click.option(
    "--extent",
    type=click.Choice(EXTENTS),
    default="footprint",
    show_default=True,
    help="the grid of each scan alone, or the fused map",
)
@click.option(
    "--encoding",
    type=click.Choice(["lossless", "compact"]),
    default="lossless",
    show_default=True,
    help="compact: an eighth of the bytes, for slow links",
)
@click.option("--security", type=click.Path(path_type=Path), help="folder of a role made by `guara security init`")
@click.option("--count", type=click.IntRange(min=1), help="end after this many grids; default: until Ctrl-C")
@click.option("--timeout", type=click.FloatRange(min=0.1), help="fail when no grid comes for this many seconds")
@click.option("--json", "as_json", is_flag=True, help="print one JSON object per grid instead")
def command(
    endpoint: str | None,
    robot: str,
    extent: str,
    encoding: str,
    security: Path | None,
    count: int | None,
    timeout: float | None,
    as_json: bool,
) -> None:
    """Print one line per grid that the node publishes; the last one comes at once.

    \b
    Example:
      guara listen --connect tcp/127.0.0.1:7447 --count 1
      guara listen --connect tcp/127.0.0.1:7447 --encoding compact --count 1
    """
    from guara_perception.app.client import TerrainClient
    from guara_perception.app.summary import facts, summary

    seen = 0
    connecting = CONNECTING_SECONDS if timeout is None else min(timeout, CONNECTING_SECONDS)
    with TerrainClient(endpoint, robot=robot, security=security, timeout=connecting, encoding=encoding) as client:
        try:
            for terrain in client.stream(timeout, extent):
                seen += 1
                sequence = terrain.metadata["sequence"]
                if as_json:
                    click.echo(json.dumps({"name": robot, "sequence": sequence, **facts(terrain)}))
                else:
                    click.echo(f"{robot} {extent} #{sequence}: {summary(terrain)}")
                if seen == count:
                    break
        except KeyboardInterrupt:
            click.echo(f"stopped after {seen} grids", err=True)

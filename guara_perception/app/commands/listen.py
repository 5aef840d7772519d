"""`guara listen`: what a planner sees, one line per grid."""

from __future__ import annotations

from pathlib import Path

import click


@click.command(name="listen")
@click.option("--connect", "endpoint", help="where the node listens; default: tcp/127.0.0.1:7447")
@click.option("--robot", "--name", "robot", default="guara", show_default=True, help="instance name of the robot")
@click.option("--extent", type=click.Choice(["footprint", "map"]), default="footprint", show_default=True)
@click.option("--security", type=click.Path(path_type=Path), help="folder of a role made by `guara security init`")
@click.option("--count", type=click.IntRange(min=1), help="end after so many grids; default: until Ctrl-C")
@click.option("--timeout", type=click.FloatRange(min=0.1), help="fail when no grid comes for so many seconds")
def command(
    endpoint: str | None, robot: str, extent: str, security: Path | None, count: int | None, timeout: float | None
) -> None:
    """Print one line per grid that the node publishes; the last one comes at once.

    \b
    Example:
      guara listen --connect tcp/127.0.0.1:7447 --count 1
    """
    from guara_perception.app.client import TerrainClient
    from guara_perception.app.summary import summary

    seen = 0
    with TerrainClient(endpoint, robot=robot, security=security) as client:
        try:
            for terrain in client.stream(extent, timeout):
                seen += 1
                click.echo(f"{robot} {extent} #{terrain.metadata['sequence']}: {summary(terrain)}")
                if seen == count:
                    break
        except KeyboardInterrupt:
            click.echo(f"stopped after {seen} grids", err=True)

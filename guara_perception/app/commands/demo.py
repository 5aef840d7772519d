"""`guara demo`: a walk from scans to footholds without hardware, which ends by itself and checks itself."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from guara_perception.app.options import FILE
from guara_perception.app.progress import progress
from guara_perception.files import check_folder
from guara_perception.terrain.layers.hazard import UNKNOWN_MASK

if TYPE_CHECKING:
    from guara_perception.app.demo.walk import DemoPause


@click.command(name="demo")
@click.option("--out", type=FILE, default=Path("out/demo"), help="folder for pictures and recording")
@click.option("--view", is_flag=True, help="show the recording in a browser afterwards (extra `view`)")
@click.option("--cycles", type=click.FloatRange(1, 12), default=10, help="gait cycles of 140 mm")
@click.option("--robot", default="guara", help="name or folder of the robot")
@click.option("--world", default="demo", help="terrain and light: demo, sunlit or a world file")
@click.pass_context
def command(context: click.Context, out: Path, view: bool, cycles: float, robot: str, world: str) -> None:
    """Walk a simulated robot over mixed terrain; scan, publish and choose footholds at every pause.

    The planner runs in a second process and gets its grids over Zenoh. Pictures and a recording of everything are left
    in the folder --out. Exit 1 when the demo's own check fails.

    \b
    Example:
      guara demo --out out/demo
      guara demo --world sunlit --cycles 2 --out out/sunlit
    """
    from guara_perception.app.demo.check import DemoCheck
    from guara_perception.app.demo.pictures import draw_demo
    from guara_perception.app.demo.walk import PAUSES_PER_CYCLE, demo_walk, first_recorded

    check_folder(out)
    out.mkdir(parents=True, exist_ok=True)
    recording = out / "walk.mcap"
    recording.unlink(missing_ok=True)
    check = DemoCheck()
    pauses = round(cycles * PAUSES_PER_CYCLE) + 1
    seen: list[DemoPause] = []
    with progress("Walking") as show:
        for item in demo_walk(check, recording=recording, cycles=cycles, robot_name=robot, world=world):
            click.echo(line(item))
            seen.append(item)
            show(len(seen), pauses)
    for picture in draw_demo(out, seen):
        click.echo(f"picture: {picture}")
    size, first = recording.stat().st_size / 1e6, first_recorded(cycles)
    part = f"the last {pauses - first} of {pauses} pauses" if first else "every pause"
    click.echo(f"recording: {recording}, {size:.0f} MB, {part}")
    for text in check.lines():
        click.echo(text)
    failures = check.failures(pauses)
    if failures:
        click.echo("the demo's check failed: " + "; ".join(failures), err=True)
        context.exit(1)
    click.echo("the demo's check passed")
    if view:
        from guara_perception.app.commands.view import command as view_command

        context.invoke(view_command, file=recording)


def line(item: DemoPause) -> str:
    """One line of text about a pause."""
    record = item.terrain.scan_record
    counts = record.hazard_cells or {}
    duration = ((record.scan_end or 0) - (record.scan_start or 0)) * 1e-9
    unknown = int(((item.terrain.hazard & UNKNOWN_MASK) != 0).sum())
    most = sorted((name for name, n in counts.items() if n), key=lambda name: -counts[name])[:3]
    where = "the walk ends here"
    if item.foothold is not None:
        x, y, z = item.answer["foothold"]
        ground = "scanned" if item.foothold.is_scanned else "declared"
        where = f"{item.pause.next_leg} to x {x:+.3f} y {y:+.3f} z {z:+.3f} on {ground} ground"
    return (
        f"step {item.pause.step:>2}  {record.mode} {record.stripes_used} stripes "
        f"{duration:.1f} s  coverage {record.coverage or 0.0:4.0%}  "
        f"unknown {unknown:>4}  {' '.join(most):<28}  error {1e3 * item.error:.2f} mm  {where}"
    )

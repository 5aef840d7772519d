"""`guara robot acceptance`: measure blocks of known height in several scans, and report the errors."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from guara_perception.app.options import FILE, DeviceOptions, device_options, stance_of
from guara_perception.app.progress import progress
from guara_perception.exceptions import InvalidInput

if TYPE_CHECKING:
    from guara_perception.app.node.devices import Rig
    from guara_perception.progress import Progress
    from guara_perception.simulation.world import World


@click.command(name="acceptance")
@click.argument("folder", type=FILE)
@device_options
@click.option("--simulated", is_flag=True, help="simulate robot, blocks and devices")
@click.option("--blocks", default="0.01,0.02,0.05", help="comma-separated heights of all blocks on the floor [m]")
@click.option("--scans", type=click.IntRange(2, 100), default=10, help="number of scans, each after a power cycle")
@click.option("--note", default="", help="note for the report on light, floor and blocks")
@click.pass_context
def command(
    context: click.Context,
    folder: Path,
    simulated: bool,
    blocks: str,
    scans: int,
    note: str,
    chosen: DeviceOptions,
) -> None:
    """Measure blocks of known height in several scans.

    Writes FOLDER/report.html; exit 1 if an error is too large. Place all blocks on a flat floor at once: gauge blocks,
    or objects measured with a caliper. Switch the device off and on before each scan. An error is too large if it
    exceeds three times the standard deviation stated by the grid. The grids are kept in FOLDER. Run the same command
    again to resume an interrupted test.

    \b
    Example:
      guara robot acceptance trial --simulated
      guara robot acceptance mine -c calibration.json --devices devices.toml --blocks 0.01,0.05 --note "oak, lamps"
    """
    from guara_perception.app import acceptance
    from guara_perception.app.node.devices import choose_rig, robot_of
    from guara_perception.terrain.file import load_terrain

    heights = acceptance.parse_blocks(blocks)
    if (folder / acceptance.REPORT_FILE).exists():
        raise InvalidInput(f"{folder} already contains a finished acceptance test; give another folder")
    world = world_with(heights, robot_of(chosen)) if simulated else "demo"
    rig = choose_rig(chosen, simulated=simulated, world=world)
    folder.mkdir(parents=True, exist_ok=True)
    turns, device = [], dict[str, str]()
    for number in range(1, scans + 1):
        kept = folder / f"scan_{number:02d}.npz"
        if number == scans or not kept.is_file():
            if not simulated:
                click.pause(f"scan {number} of {scans}: switch laser board and camera off and on; then press any key ")
            with progress(f"Scan {number} of {scans}") as show:
                device = scan(rig, kept, show)
        try:
            turns.append(acceptance.measure(load_terrain(kept), heights))
        except acceptance.AcceptanceFailed:
            kept.unlink()
            raise
    done = acceptance.Acceptance(heights, tuple(turns), device, note, simulated)
    click.echo(f"{done.save(folder)}: {done.verdict}")
    if not done.is_held:
        context.exit(1)


def scan(rig: Rig, kept: Path, show: Progress) -> dict[str, str]:
    """Scan once, save the grid, and return facts about the device."""
    import numpy as np

    from guara_perception.app.acceptance import device_facts
    from guara_perception.app.node.live_scan import live_scan
    from guara_perception.app.node.published_scans import with_problems
    from guara_perception.app.node.rangefinder import firing_order
    from guara_perception.scanning.scan_processor import ScanProcessor

    calibration, standing = rig.calibration, stance_of(None, rig.robot)
    processor = ScanProcessor(calibration, rig.robot, standing, "standard", stamp=time.time_ns())
    order = firing_order(calibration, processor.settings.pattern("standard"))
    with rig.rangefinder as rangefinder:
        picture = np.asarray(rangefinder.camera.grab(2.0).image)
        taken = live_scan(
            rangefinder,
            processor,
            order,
            should_stop=lambda: False,
            on_stripe=lambda *_: show(len(processor.profiles), len(order)),
        )
        facts = device_facts(rangefinder, calibration, picture)
    with_problems(processor.finish(), taken).save(kept)
    return facts


def world_with(heights: tuple[float, ...], robot: str) -> World:
    """Make a flat floor with a row of blocks across the area that a robot scans."""
    from guara_perception.settings import Settings
    from guara_perception.simulation.features import Box
    from guara_perception.simulation.world import World
    from kinematics import load_robot

    settings = Settings.of(load_robot(robot))
    (x0, x1), (y0, y1) = settings.footprint_x, settings.footprint_y
    pitch = (y1 - y0) / len(heights)
    size = (0.6 * pitch, 0.6 * pitch)
    boxes = (
        Box(x=(x0 + x1) / 2, y=y0 + (number + 0.5) * pitch, size=size, height=height)
        for number, height in enumerate(heights)
    )
    return World(features=tuple(boxes))

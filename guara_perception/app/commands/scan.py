"""`guara scan`: take one scan, record it and draw it."""

from __future__ import annotations

import itertools
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from guara_perception.app.options import FILE, DeviceOptions, device_options, method_options, stance_of
from guara_perception.app.progress import progress
from guara_perception.exceptions import InvalidInput

if TYPE_CHECKING:
    from drivers import StripeCapture


@click.command(name="scan")
@click.argument("folder", required=False, type=FILE)
@device_options
@click.option("-o", "--out", type=FILE, hidden=True, help="same as FOLDER")
@click.option("--simulated", is_flag=True, help="use a simulated robot, world and devices")
@click.option(
    "--mode",
    type=click.Choice(["standard", "coarse"]),
    default="standard",
    help="standard: every stripe; coarse: every n-th stripe (robot.toml)",
)
@method_options
@click.option("--stance", type=FILE, help="JSON file with the stance; default: the scan posture")
@click.option(
    "--no-calibration",
    is_flag=True,
    help="only record, with the pattern of robot.toml; for instance for a calibration plate",
)
def command(
    folder: Path | None,
    out: Path | None,
    simulated: bool,
    mode: str,
    method: str,
    threshold: float | None,
    stance: Path | None,
    no_calibration: bool,
    chosen: DeviceOptions,
) -> None:
    """Scan once with the robot standing still, record to FOLDER (default: scan), and draw figures to FOLDER-figures.

    FOLDER also contains the calibration, so `guara process FOLDER -o terrain.npz` needs no other file; a robot
    outside the stock folder still needs --robot. With --no-calibration, neither calibration nor figures are written.
    Without --stance, the robot is assumed to stand on all feet in its scan posture, with unknown gravity.

    \b
    Example:
      guara scan scans/today -c calibration.json --devices devices.toml
      guara scan plates/40 --no-calibration --robot guara
    """
    from guara_perception.app.figures.figures import draw_figures
    from guara_perception.app.files.open_scan import open_scan
    from guara_perception.app.files.scan_folder import ScanFolderWriter
    from guara_perception.app.node.devices import choose_rig
    from guara_perception.app.node.live_scan import live_scan
    from guara_perception.app.node.published_scans import with_problems
    from guara_perception.app.node.rangefinder import firing_order
    from guara_perception.app.record.plate_scan import scan_uncalibrated
    from guara_perception.app.summary import summary
    from guara_perception.scanning.pictures import with_pictures
    from guara_perception.scanning.scan_processor import ScanProcessor
    from guara_perception.scanning.stripe_finder import check_method

    if folder is not None and out is not None:
        raise InvalidInput(f"FOLDER is {folder} and --out is {out}: give one of them")
    if no_calibration and chosen.calibration is not None:
        raise InvalidInput("--no-calibration and --calibration are mutually exclusive: give one of them")
    check_method(method, threshold)
    target = folder or out or Path("scan")
    rig = choose_rig(chosen, simulated=simulated, needs_calibration=not no_calibration)
    model = rig.robot
    standing = stance_of(stance, model)
    if no_calibration:
        with rig.rangefinder, progress("Scanning") as show:
            problems = scan_uncalibrated(
                *(rig.rangefinder, model, standing, target),
                mode=mode,
                on_stripe=lambda picture, done, total: show(done, total),
            )
        for problem in problems:
            click.echo(problem, err=True)
        click.echo(f"{target}: recorded without a calibration")
        return
    calibrated = rig.calibration
    stamp = time.time_ns()
    processor = ScanProcessor(calibrated, model, standing, mode, method=method, threshold=threshold, stamp=stamp)
    order = firing_order(calibrated, processor.settings.pattern(mode))
    with ScanFolderWriter(target) as writer:
        with rig.rangefinder, progress("Scanning") as show:
            done, dark_after = itertools.count(1), list[int]()

            def keep(capture: StripeCapture, _: float) -> None:
                show(next(done), len(order))
                if capture.is_dark_due:
                    dark_after.append(capture.index)
                if capture.on is not None:
                    writer.add(capture.index, capture.mirror_angle, capture.on, capture.off, dark=capture.dark)

            scan = live_scan(rig.rangefinder, processor, order, should_stop=lambda: False, on_stripe=keep)
        for problem in scan.problems:
            click.echo(problem, err=True)
        writer.finish(
            robot=model.name,
            mode=mode,
            stamp=stamp,
            step=0,
            stance=standing,
            calibration_hash=calibrated.hash,
            calibration=calibrated,
            dark_after=dark_after,
            camera_identity=rig.rangefinder.camera.identity,
        )
    terrain = with_pictures(with_problems(processor.finish(), scan), processor)
    click.echo(f"{target}: {summary(terrain)}")
    figures = target.with_name(f"{target.name}-figures")
    pictures = draw_figures(figures, open_scan(target), calibrated, processor, terrain)
    click.echo(f"{figures}: {len(pictures)} pictures")

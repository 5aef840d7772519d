"""`guara scan`: one scan now, recorded and shown."""

from __future__ import annotations

import itertools
import time
from pathlib import Path
from typing import TYPE_CHECKING

import click

from guara_perception.app.progress import progress

if TYPE_CHECKING:
    from drivers import StripeCapture


@click.command(name="scan")
@click.option("-c", "--calibration", type=click.Path(path_type=Path), help="calibration.json of this rangefinder")
@click.option("-o", "--out", type=click.Path(path_type=Path), default=Path("scan"), show_default=True)
@click.option("--simulated", is_flag=True, help="simulated robot, world and devices")
@click.option("--mode", type=click.Choice(["standard", "coarse"]), default="standard", show_default=True)
@click.option("--stance", type=click.Path(path_type=Path), help="JSON with the stance; default: the scan posture")
@click.option("--robot", help="name or folder of the robot; default: the calibration's")
@click.option("--devices", type=click.Path(path_type=Path), help="devices.toml as `guara record` writes it")
@click.option("--camera", help="number, device path or GStreamer pipeline; default: that of --devices, or 0")
@click.option("--fps", type=click.FloatRange(min=0.1), help="frames per second to ask of the camera")
@click.option("--off-frames", type=click.Choice(["one", "per stripe", "none"]), default="one", show_default=True)
def command(
    calibration: Path | None,
    out: Path,
    simulated: bool,
    mode: str,
    stance: Path | None,
    robot: str | None,
    devices: Path | None,
    camera: str | None,
    fps: float | None,
    off_frames: str,
) -> None:
    """Scan once, with the robot standing still; write the scan folder OUT and pictures into OUT-figures.

    Without --stance the robot is taken to stand in its scan posture on all feet, gravity unknown.

    \b
    Example:
      guara scan -c calibration.json -o scans/today
    """
    from guara_perception.app.figures.figures import draw_figures
    from guara_perception.app.files.open_scan import open_scan
    from guara_perception.app.files.scan_folder_writer import ScanFolderWriter
    from guara_perception.app.node.devices import choose_rig
    from guara_perception.app.node.live_scan import live_scan
    from guara_perception.app.summary import summary
    from guara_perception.fields import read_json
    from guara_perception.process import with_pictures
    from guara_perception.scan_processor import ScanProcessor
    from kinematics import Stance

    rig = choose_rig(
        simulated=simulated,
        calibration=calibration,
        robot=robot,
        camera=camera,
        fps=fps,
        off_frames=off_frames,
        devices=devices,
    )
    model, calibrated = rig.robot, rig.calibration
    if stance is not None:
        standing = Stance.from_dict(read_json(stance).data)
    else:
        standing = Stance(model.posture(model.config.scan_posture), model.legs, None)
    stamp = time.time_ns()
    processor = ScanProcessor(calibrated, model, standing, mode, stamp=stamp)
    wanted = processor.settings.pattern(mode)
    firing_order = [(s.index, s.mirror_angle) for s in calibrated.stripes if s.index in wanted]
    with ScanFolderWriter(out) as writer:
        with rig.rangefinder, progress("Scanning") as show:
            done = itertools.count(1)

            def keep(capture: StripeCapture) -> None:
                show(next(done), len(firing_order))
                if capture.on is not None:
                    writer.add(capture.index, capture.mirror_angle, capture.on, capture.off, off_key=id(capture.off))

            scan = live_scan(rig.rangefinder, processor, firing_order, should_stop=lambda: False, on_stripe=keep)
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
        )
    terrain = with_pictures(processor.finish(), processor)
    click.echo(f"{out}: {summary(terrain)}")
    folder = out.with_name(f"{out.name}-figures")
    pictures = draw_figures(folder, open_scan(out), calibrated, processor, terrain)
    click.echo(f"{folder}: {len(pictures)} pictures")

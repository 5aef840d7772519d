"""`guara replay`: process and fuse the recorded scans of a walk in order, and save or publish the grids."""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import click

from guara_perception.app.options import FILE, method_options
from guara_perception.app.progress import progress
from guara_perception.exceptions import InvalidInput
from guara_perception.scan import Scan


@click.command(name="replay")
@click.argument("scans", nargs=-1, required=True, metavar="SCAN...", type=FILE)
@click.option("-c", "--calibration", type=FILE, help="calibration.json; default: that of the first scan")
@click.option("--extent", default="footprint,map", help="grids to save or publish: footprint, map or footprint,map")
@click.option("-o", "--out", type=FILE, help="folder for a grid file of each pause and extent")
@click.option("--publish", is_flag=True, help="publish over Zenoh like a node, with the current time as stamp")
@click.option("--interval", type=click.FloatRange(0, 3600), default=1.0, help="wait between published scans [s]")
@click.option("--listen", help="endpoint for clients; default: that of the security folder, or tcp/127.0.0.1:7447")
@click.option("--connect", help="use an external Zenoh router instead of being one")
@click.option("--security", type=FILE, help="folder made by `guara security init`")
@method_options
@click.option("--robot", help="name or folder of the robot; default: that of the first scan")
def command(
    scans: tuple[Path, ...],
    calibration: Path | None,
    extent: str,
    out: Path | None,
    publish: bool,
    interval: float,
    listen: str | None,
    connect: str | None,
    security: Path | None,
    method: str,
    threshold: float | None,
    robot: str | None,
) -> None:
    """Replay recorded SCANs (folders or .mcap) in the order given, with fusion over pauses.

    A new map begins if a scan belongs to a different walk from the previous one, or if its step is not higher. Scans
    whose grids were withdrawn by the node are skipped.

    \b
    Example:
      guara replay walk.mcap -c calibration.json -o grids
      guara replay scans/a scans/b -c calibration.json --extent map --publish
    """
    from guara_perception.app.files.open_scan import calibration_for, last_of_each_pause, open_scans
    from guara_perception.app.node.walk_map import WalkMap
    from guara_perception.app.publisher import publish_terrain
    from guara_perception.app.summary import summary
    from guara_perception.files import check_folder
    from guara_perception.scanning.process import run_scan
    from guara_perception.terrain.layers.layered_grid import EXTENTS
    from guara_perception.terrain.questions.save import save_terrain
    from kinematics import load_robot
    from transport import open_node

    extents = tuple(dict.fromkeys(name.strip() for name in extent.split(",")))
    for name in extents:
        if name not in EXTENTS:
            raise InvalidInput(f"--extent has {name!r}; allowed: {', '.join(EXTENTS)}, or both, separated by a comma")
    if out is not None:
        check_folder(out)
    if not publish and (listen or connect or security):
        raise InvalidInput("--listen, --connect and --security require --publish")
    calibrated = calibration_for(scans[0], calibration)
    found = [scan for path in scans for scan in last_of_each_pause(open_scans(path))]
    for scan in found:
        if scan.withdrawn:
            click.echo(f"step {scan.step}: withdrawn on the robot, skipped ({scan.withdrawn})")
    walk = [scan for scan in found if not scan.withdrawn]
    if not walk:
        raise InvalidInput(
            f"{', '.join(map(str, scans))}: {'all scans were withdrawn' if found else 'no scans'}; there is nothing to "
            "replay"
        )
    model = load_robot(robot or walk[0].robot)
    walk_map = WalkMap(model, calibrated)
    last: Scan | None = None
    with ExitStack() as stack:
        session = stack.enter_context(open_node(listen=listen, connect=connect, security=security)) if publish else None
        if session is not None:
            click.echo(f"{model.name}: publishing on {', '.join(session.endpoints)}")
        for number, scan in enumerate(walk):
            if last is not None and (scan.epoch != last.epoch or scan.step <= last.step):
                click.echo(f"step {scan.step} after step {last.step}: another walk; the map restarts")
                walk_map = WalkMap(model, calibrated)
            last = scan
            with progress(f"Step {scan.step}") as show:
                processor = run_scan(
                    scan,
                    calibrated,
                    model,
                    method,
                    threshold=threshold,
                    progress=show,
                    gravity=walk_map.gravity(scan.step, scan.stance),
                )
            fused = walk_map.update(scan.step, scan.stance, processor.finish("wide"), picture=processor.ground_picture)
            grids = {"footprint": processor.finish(), "map": fused}
            if session is not None and number:
                time.sleep(interval)
            for name in extents:
                click.echo(f"{name}: {summary(grids[name])}")
                if out is not None:
                    out.mkdir(parents=True, exist_ok=True)
                    save_terrain(grids[name], out / f"{number:04d}-step{scan.step}-{name}.npz")
                if session is not None:
                    publish_terrain(session, replace(grids[name], stamp=time.time_ns()), model.name)
        if session is not None:
            # The last grids must be sent before the session closes, even to clients that have just connected.
            time.sleep(max(interval, 0.5))

"""`guara process`: compute a grid file and pictures from a recorded scan."""

from __future__ import annotations

import json
from pathlib import Path

import click

from guara_perception.app.options import FILE, method_options
from guara_perception.app.progress import progress
from guara_perception.exceptions import InvalidInput


@click.command(name="process")
@click.argument("scan", type=FILE)
@click.option("-c", "--calibration", type=FILE, help="calibration.json; default: that of the scan")
@click.option("-o", "--out", required=True, type=FILE, help="grid file to write, .npz")
@method_options
@click.option(
    "--resolution", type=float, help="cell size [m]; must divide both sides of the area; default: that of the robot"
)
@click.option("--figures", type=FILE, help="folder for pictures of every stage")
@click.option("--robot", help="name or folder of the robot; default: that of the scan")
@click.option("--step", type=int, help="step of the pause to process, if the recording has several")
@click.option("--keep-going", is_flag=True, help="leave the ground of bad or missing frames unknown instead of failing")
@click.option("--json", "as_json", is_flag=True, help="print one JSON object per grid instead of text")
def command(
    scan: Path,
    calibration: Path | None,
    out: Path,
    method: str,
    threshold: float | None,
    resolution: float | None,
    figures: Path | None,
    robot: str | None,
    step: int | None,
    keep_going: bool,
    as_json: bool,
) -> None:
    """Compute the terrain grid of a recorded SCAN (folder or .mcap).

    Several methods can be given, separated by commas. With -o grid.npz, the grid of the first method is written to
    grid.npz and the others to grid-METHOD.npz; the pictures of each method are written to a subfolder named after it.

    \b
    Example:
      guara process scans/paper -c calibration.json -o paper.npz --figures pictures
    """
    from guara_perception.app.files.open_scan import calibration_for, open_scan
    from guara_perception.app.summary import facts, summary
    from guara_perception.files import check_folder, check_target
    from guara_perception.scanning.pictures import with_pictures
    from guara_perception.scanning.process import run_scan
    from guara_perception.scanning.stripe_finder import METHODS, check_method
    from guara_perception.terrain.questions.save import save_terrain
    from kinematics import RobotNotFound, load_robot

    check_target(out, ".npz")
    if figures is not None:
        check_folder(figures)
    methods = list(dict.fromkeys(name.strip() for name in method.split(",")))
    for name in methods:
        if name not in METHODS:
            allowed = f"allowed: {', '.join(METHODS)}, or several of them, separated by commas"
            raise InvalidInput(f"--method is {name!r}; {allowed}")
        # If there are several methods, the threshold is passed only to the paper's methods.
        check_method(name, threshold if METHODS[name] is not None or len(methods) == 1 else None)
    recorded = open_scan(scan, step, missing_ok=keep_going)
    calibrated = calibration_for(scan, calibration)
    try:
        model = load_robot(robot if robot is not None else recorded.robot)
    except RobotNotFound as error:
        raise InvalidInput(str(error) if robot is not None else f"{recorded.source}: robot: {error}") from None
    for number, name in enumerate(methods):
        with progress(f"Processing ({name})") as show:
            processor = run_scan(
                recorded,
                calibrated,
                model,
                name,
                resolution,
                threshold=threshold if METHODS[name] is not None else None,
                strict=not keep_going,
                progress=show,
            )
        terrain = with_pictures(processor.finish(), processor)
        target = out if number == 0 else out.with_name(f"{out.stem}-{name}{out.suffix}")
        save_terrain(terrain, target)
        click.echo(json.dumps({"file": str(target), **facts(terrain)}) if as_json else f"{target}: {summary(terrain)}")
        if figures is not None:
            from guara_perception.app.figures.figures import draw_figures

            folder = figures if len(methods) == 1 else figures / name
            pictures = draw_figures(folder, recorded, calibrated, processor, terrain)
            if not as_json:
                click.echo(f"{folder}: {len(pictures)} pictures")

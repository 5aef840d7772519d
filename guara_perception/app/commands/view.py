"""`guara view`: show robot and terrain in a browser, live or from a file."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from guara_perception.app.options import FILE, earlier_option
from guara_perception.exceptions import InvalidInput

if TYPE_CHECKING:
    from guara_perception.view.moment import Moment
    from kinematics import RobotModel

# [s] Time after the start at which a live view explains why nothing has been shown yet.
SILENCE = 5.0
# [s] Interval between updates of the status line of the newest grid.
STATUS_SECONDS = 1.0


@click.command(name="view")
@click.argument("file", type=FILE, required=False)
@click.option(
    "-c",
    "--calibration",
    type=FILE,
    help="calibration for processing scans; default: that of the recording or scan folder",
)
@click.option("--robot", help="name or folder of the robot; default: that of FILE, or guara")
@click.option(
    "--connect", "endpoint", help="live: endpoint of node or router; default: that of --security, or tcp/127.0.0.1:7447"
)
@click.option("--name", default="guara", help="live: instance name of the robot")
@earlier_option("--instance", "name", "--name")
@click.option("--security", type=FILE, help="live: folder of a role made by `guara security init`")
@click.option("--port", type=click.IntRange(1, 65535), default=8080, help="port of the page")
@click.option("--rerun", is_flag=True, help="show a recording in the Rerun viewer instead (extra `rerun`)")
@click.option("--save", type=FILE, help="with --rerun: write this .rrd file instead of opening the viewer")
def command(
    file: Path | None,
    calibration: Path | None = None,
    robot: str | None = None,
    endpoint: str | None = None,
    name: str = "guara",
    security: Path | None = None,
    port: int = 8080,
    rerun: bool = False,
    save: Path | None = None,
) -> None:
    """Show a walk in a browser: robot, terrain, stripes, obstacles, planned footholds, camera.

    FILE is a grid (.npz), a recording (.mcap) or a scan folder. Without FILE, the data of a running node are shown.
    Click a cell to see what is known about it. The page is served to this machine only, until Ctrl-C. With --rerun,
    the recording opens as one scene in the Rerun viewer.

    \b
    Example:
      guara view out/demo/walk.mcap
      guara view --rerun out/demo/walk.mcap
    """
    if rerun or save is not None:
        if calibration is not None:
            raise InvalidInput(
                "-c is for the view in a browser; --rerun shows recorded data only: leave one of them out"
            )
        show_in_rerun(file, rerun, save)
        return
    from guara_perception.app.until_stopped import stop_event
    from guara_perception.app.view_moments import load_moments
    from guara_perception.calibration.file import load_calibration
    from guara_perception.view.browser import BrowserView
    from kinematics import load_robot

    known = None if calibration is None else load_calibration(calibration)
    model, moments = (
        (load_robot("guara" if robot is None else robot), []) if file is None else load_moments(file, robot, known)
    )
    with stop_event() as stop, BrowserView(model, port=port) as view:
        if file is not None:
            view.show_recording(moments)
            click.echo(f"{file}: open {view.address} (pauses: {len(moments)}; press Ctrl-C to stop)")
            stop.wait()
        else:
            show_live(view.add, model, endpoint, name, security, stop, view.address, view.report)


def show_in_rerun(file: Path | None, rerun: bool, save: Path | None) -> None:
    """Open a recording in Rerun, or write a file for Rerun.

    Raises:
        InvalidInput: `save` is given without `rerun`, `file` is None or cannot be shown, or `save` is not an .rrd file.
        MissingFile, FileFormatError: the recording does not exist or cannot be read.
        MissingExtra: rerun-sdk is not installed.
        PerceptionError: the viewer failed, for instance without a display.
    """
    from guara_perception.app.scene.rerun_scene import open_in_rerun, save_rerun_scene

    if not rerun:
        raise InvalidInput("--save requires --rerun: guara view --rerun FILE --save OUT.rrd")
    if file is None:
        raise InvalidInput("--rerun shows a recording: give its FILE (.mcap)")
    if save is not None:
        click.echo(f"{save_rerun_scene(file, save)}: open it with `rerun {save}`")
    else:
        open_in_rerun(file)


def show_live(
    show: Callable[[Moment], None],
    model: RobotModel,
    endpoint: str | None,
    instance: str,
    security: Path | None,
    stop: threading.Event,
    address: str,
    report: Callable[[str, bool], None] = lambda text, is_stale: None,
) -> None:
    """Show every new pause until stopped; if nothing has been shown after `SILENCE` seconds, print why.

    From then on, `report` is called every `STATUS_SECONDS` seconds with the result of `LiveMoments.state`.
    """
    from guara_perception.app.live_moments import LiveMoments

    with LiveMoments(show, model, endpoint, robot=instance, security=security) as moments:
        click.echo(f"live view of {instance}: open {address} (press Ctrl-C to stop)")
        if not stop.wait(SILENCE) and (missing := moments.missing()):
            click.echo(missing, err=True)
        while not stop.wait(STATUS_SECONDS):
            report(*moments.state())

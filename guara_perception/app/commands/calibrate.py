"""`guara calibrate`: compute a calibration from a session folder, with a verdict and a report."""

from __future__ import annotations

from pathlib import Path

import click

from guara_perception.app.options import FILE, NOT_MIRRORED
from guara_perception.app.progress import progress
from guara_perception.exceptions import MissingFile


@click.command(name="calibrate")
@click.argument("session", type=FILE)
@click.option("-o", "--out", required=True, type=FILE, help="calibration file to write, .json")
@click.option("--report", type=FILE, help="folder for the report, report.html")
@click.option("--force", is_flag=True, help="write the calibration even if its verdict is `refused`")
@NOT_MIRRORED
@click.option("--robot", help="name or folder of the robot; default: that of the session")
@click.option("--distortion", default="k1k2", help="lens coefficients: k1k2, k1k2p1p2 or k1k2p1p2k3")
@click.option(
    "--pattern",
    type=click.Choice(["measured", "coarse", "standard"]),
    default="measured",
    help="stripes to write; those without pictures are computed from the mirror model",
)
@click.option(
    "--camera-info",
    type=FILE,
    help="known intrinsics (OpenCV, ROS or Kalibr file); board pictures then only verify them",
)
@click.option("--square", type=float, help="edge of the board's squares [m]; default: that of the session")
@click.option("--save-camera-info", type=FILE, help="also write the intrinsics as a ROS camera_info file, .yaml")
def command(
    session: Path,
    out: Path,
    report: Path | None,
    force: bool,
    not_mirrored: bool,
    robot: str | None,
    distortion: str,
    pattern: str,
    camera_info: Path | None,
    square: float | None,
    save_camera_info: Path | None,
) -> None:
    """Calibrate camera, mount and laser from the pictures of a SESSION folder.

    If the verdict is `refused`, no calibration is written and the exit code is 1, unless --force is given. A requested
    report is written whatever the verdict. If no calibration can be computed, neither is written, even with --force.

    \b
    Example:
      guara calibrate sessions/monday -o calibration.json --report calibration-report
      guara calibrate sessions/monday -o calibration.json --camera-info lens.yaml
    """
    from guara_perception.app.calibrate_folder import calibrate_folder, refuse
    from guara_perception.app.calibration_report.html import summary, write_report
    from guara_perception.app.files.camera_info import write_camera_info
    from guara_perception.app.record.advice import with_advice
    from guara_perception.calibration.file import save_calibration
    from guara_perception.calibration.pattern import interpolate_pattern
    from guara_perception.files import check_folder, check_target
    from guara_perception.settings import Settings, robot_model

    check_target(out, ".json")
    if camera_info is not None and not camera_info.is_file():
        raise MissingFile(
            f"--camera-info: {camera_info} does not exist; `guara calibrate --save-camera-info` writes such a file"
        )
    if save_camera_info is not None:
        check_target(save_camera_info, ".yaml", ".yml")
    if report is not None:
        check_folder(report)
    with with_advice(session), progress("Calibrating") as show:
        result = calibrate_folder(session, robot, camera_info, square, distortion, not_mirrored, show)
    click.echo(summary(result))
    if report is not None:
        click.echo(f"report: {write_report(result, report)}")
    if not force:
        with with_advice(session):
            refuse(result)
    calibration = result.calibration
    if pattern != "measured":
        settings = Settings.of(robot_model(robot or calibration.robot))
        calibration = interpolate_pattern(calibration, settings.pattern(pattern))
    written = save_calibration(calibration, out)
    click.echo(f"{out}: {len(written.stripes)} stripes, verdict {written.quality['verdict']}, hash {written.hash}")
    if save_camera_info is not None:
        write_camera_info(written.camera, save_camera_info)
        click.echo(str(save_camera_info))

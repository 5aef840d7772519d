"""`guara record`: guide the user through a calibration session, and calibrate from it."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import click
from click.core import ParameterSource

from guara_perception.app.options import FILE, NOT_MIRRORED, DeviceOptions, board_options, stance_of
from guara_perception.exceptions import InvalidInput

# Length of the ruler of `guara targets` if it is printed to scale [mm].
RULER_MM = 150.0
# Options of each part of the plan. With --redo, a part keeps its earlier values unless one of its options is given. The
# other options of that part then have their defaults.
OPTIONS_OF = {
    "board": {"board", "pattern", "square", "printed_150"},
    "crosses": {"crosses", "printed_150"},
    "plates": {"plates"},
    "stance": {"stance"},
}


@click.command(name="record")
@click.argument("session", type=FILE)
@click.option("--simulated", is_flag=True, help="use a simulated robot, devices and operator")
@click.option("--devices", type=FILE, help="devices.toml: camera and board to use")
@click.option("--robot", default="guara", help="name or folder of the robot")
@click.option("--camera", help="camera as listed by `guara doctor --cameras`; default: that of --devices, or 0")
@click.option("--trigger", metavar="LINE", help="camera line wired to the board's TRIGGER, stored in devices.toml")
@board_options
@NOT_MIRRORED
@click.option("--crosses", type=FILE, help="JSON file with points_in_footprint: measured [x, y] of each cross [m]")
@click.option("--printed-150", type=float, default=RULER_MM, help="measured length of the printed 150 mm ruler [mm]")
@click.option("--stance", type=FILE, help="JSON file with the stance; default: the scan posture")
@click.option(
    "--redo",
    type=click.Choice(["plates", "board", "crosses"]),
    multiple=True,
    help="record this part of a session again and keep the others; may be repeated",
)
@click.option("--port", type=click.IntRange(0, 65535), default=0, show_default="any free one", help="port of the page")
@click.pass_context
def command(
    context: click.Context,
    session: Path,
    simulated: bool,
    devices: Path | None,
    robot: str,
    camera: str | None,
    trigger: str | None,
    board: str,
    pattern: str,
    square: float,
    plates: str,
    not_mirrored: bool,
    crosses: Path | None,
    printed_150: float,
    stance: Path | None,
    redo: tuple[str, ...],
    port: int,
) -> None:
    """Record a calibration SESSION (exposure, board, floor, crosses, plates, in this order), and calibrate from it.

    A page in the browser shows the camera image and what to do. Run the same command again to continue an interrupted
    session. With --redo, board, crosses, plates and stance stay as in the session. Options can change only the parts
    that are recorded again; if one option of such a part is given, its others have their defaults.

    The results are SESSION/calibration.json and SESSION/devices.toml, for -c and --devices of other commands.

    \b
    Example:
      guara record sessions/monday --camera 0
      guara record sessions/trial --simulated
      guara record sessions/monday --redo plates
    """
    from guara_perception.app.commands.calibrate import command as calibrate
    from guara_perception.app.devices_file import Devices, devices_of
    from guara_perception.app.node.devices import rangefinder_of
    from guara_perception.app.record.live_page import LivePage
    from guara_perception.app.record.operator import Operator, TextOperator
    from guara_perception.app.record.record import DEVICES_FILE, planned_crosses, record_session
    from guara_perception.app.record.session_writer import SessionPlan, SessionWriter, read_plan
    from guara_perception.app.record.simulated import SimulatedWorkshop
    from guara_perception.app.targets.drawings import parse_board, parse_heights
    from guara_perception.settings import Settings
    from kinematics import load_robot

    if simulated and (devices is not None or camera is not None):
        raise InvalidInput("--simulated has its own devices: leave --devices and --camera out")
    if not 0.9 * RULER_MM <= printed_150 <= 1.1 * RULER_MM:
        raise InvalidInput(f"--printed-150 is {printed_150:g} mm; allowed: 135 ... 165 mm. Print at 100 %")
    scale = printed_150 / RULER_MM
    spec = parse_board(board, square * scale, pattern)
    spec = replace(spec, first_square=None) if not_mirrored else spec
    given = {name for name in context.params if context.get_parameter_source(name) is ParameterSource.COMMANDLINE}
    before = read_plan(session) if redo else None
    robot = robot if before is None or "robot" in given else before.robot
    model = load_robot(robot)
    standing = stance_of(stance, model)
    points = planned_crosses(crosses, model, scale)
    own = session / DEVICES_FILE
    devices = own if redo and not given & {"devices", "camera"} else devices
    known = devices_of(DeviceOptions(devices=devices, camera=camera, trigger=trigger))
    plan = SessionPlan(model.name, spec, points, parse_heights(plates), standing)
    if before is not None:
        kept = {name: getattr(before, name) for name, options in OPTIONS_OF.items() if not given & options}
        plan = replace(plan, **kept)
    with ExitStack() as stack:
        page = stack.enter_context(LivePage(port))
        operator: Operator
        if simulated:
            workshop = SimulatedWorkshop(robot)
            workshop.use_board(plan.board)
            rangefinder, known, operator = workshop.rangefinder, Devices(source="simulated"), workshop
        else:
            rangefinder = rangefinder_of(known, free=True)
            operator = TextOperator(page.ask, Settings.of(model))
        writer = SessionWriter(session, plan, redo)
        click.echo(f"live page: {page.address}")

        def report(text: str) -> None:
            page.show_task(text)
            click.echo(text)

        stack.enter_context(rangefinder)
        if redo:
            writer.clear()
        record_session(writer, model, rangefinder, known, operator, report=report, watch=page.watch)
    out, report_folder = session / "calibration.json", session / "report"
    context.invoke(calibrate, session=session, out=out, report=report_folder, robot=robot, not_mirrored=not_mirrored)

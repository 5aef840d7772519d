"""`guara import`: create a scan folder or a calibration session from images taken by another program."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from guara_perception.app.options import FILE, stance_of
from guara_perception.exceptions import InvalidInput

if TYPE_CHECKING:
    from kinematics import RobotModel, Stance

SCAN, SESSION = "scan", "session"


@dataclass(frozen=True, slots=True)
class Given:
    """Options of the command, described in its help."""

    posture: str | None
    joints: Path | None
    stance: Path | None
    off: str
    number: int | None
    mode: str | None
    indices: bool
    calibration: Path | None
    board: str
    pattern: str
    square: float
    ground: str | None
    crosses_picture: str | None
    crosses: Path | None
    plate: tuple[str, ...]


@click.command(name="import")
@click.argument("pictures", nargs=-1, required=True, type=FILE)
@click.option("-o", "--out", required=True, type=FILE, help="folder to create")
@click.option(
    "--kind",
    type=click.Choice([SCAN, SESSION]),
    help="what to create; default: session if an option needs it, else scan",
)
@click.option("--robot", default="guara", help="name or folder of the robot")
@click.option("--posture", help="posture of the robot, by its name in the robot folder; default: the scan posture")
@click.option("--joints", type=FILE, help="CSV file with `joint, angle [rad]`, instead of a posture")
@click.option("--stance", type=FILE, help="JSON file with joints, support feet and gravity, instead of a posture")
@click.option(
    "--off",
    default="",
    metavar="PATTERN",
    help="names of laser-off pictures, as a shell pattern; default: names with a word such as off or dark",
)
@click.option("--number", type=int, help="which number in the names gives the order: 1 = first, -1 = last")
@click.option(
    "--mode",
    type=click.Choice(["standard", "coarse"]),
    help="scan pattern; default: by number of pictures, standard with --indices",
)
@click.option("--indices", is_flag=True, help="the numbers are the indices of the stripes; some may be missing")
@click.option("-c", "--calibration", type=FILE, help="calibration with the mirror angles; default: those of robot.toml")
@click.option("--board", default="9x7", help="session: inner corners of the board, COLUMNSxROWS")
@click.option(
    "--pattern", type=click.Choice(["checkerboard", "charuco"]), default="checkerboard", help="session: kind of board"
)
@click.option("--square", type=float, default=0.030, help="session: edge of the board's squares [m]")
@click.option("--ground", help="session: name of the picture of the board on the floor")
@click.option("--crosses-picture", help="session: name of the picture of the crosses")
@click.option("--crosses", type=FILE, help="session: JSON file with points_in_footprint [m]; default: those of the mat")
@click.option("--plate", multiple=True, metavar="HEIGHT=FOLDER", help="session: height [m] and scan folder of a plate")
@click.option("--preview", is_flag=True, help="only show the purpose of each picture")
def command(pictures: tuple[Path, ...], out: Path, kind: str | None, robot: str, preview: bool, **values: Any) -> None:
    """Create a scan folder or a calibration session from PICTURES: PNG, JPEG, BMP, TIFF or PGM, in any order.

    Pictures of a scan are ordered by a number in their names, and paired by that number and a word such as off.
    Before anything is written, the command shows the purpose of each picture. On a terminal, it asks for missing
    options and for confirmation.

    \b
    Example:
      guara import photos/*.bmp -o scans/monday --posture scan
      guara import boards/*.tif -o session --ground b07.tif --crosses-picture mat.tif --plate 0=p0 --plate 0.04=p40
    """
    from guara_perception.app.files.pair_pictures import picture_files
    from guara_perception.app.import_pictures import check_sizes
    from kinematics import load_robot

    if out.exists() or not out.parent.is_dir():
        raise InvalidInput(f"{out}: {'exists' if out.exists() else 'its folder does not exist'}; give another name")
    given, files = Given(**values), picture_files(pictures)
    is_session = bool(given.ground or given.crosses_picture or given.plate or given.crosses)
    if kind is None:
        kind = SESSION if is_session else (_ask("what to create, scan or session", SCAN) or SCAN)
    model = load_robot(robot)
    standing = _standing(model, given)
    width, height = check_sizes(files)
    if kind == SCAN:
        if is_session:
            raise InvalidInput("--ground, --crosses-picture, --crosses and --plate are for a session: leave --kind out")
        write = _scan(files, out, model, standing, given)
    elif kind == SESSION:
        write = _session(files, out, model, standing, given)
    else:
        raise InvalidInput(f"kind is {kind!r}, allowed: {SCAN}, {SESSION}")
    if preview:
        return
    if sys.stdin.isatty() and not click.confirm(f"write {out}", default=True, err=True):
        raise click.Abort
    write()
    click.echo(f"{out}: {kind} of {model.name}, {len(files)} pictures of {width}x{height} px")


def _ask(question: str, default: str) -> str | None:
    """Ask the user at a terminal and return the answer; return None without a terminal."""
    return str(click.prompt(question, default=default, err=True)) if sys.stdin.isatty() else None


def _standing(robot: RobotModel, given: Given) -> Stance:
    from guara_perception.app.import_pictures import read_joints
    from kinematics import Stance

    chosen = [f"--{name}" for name in ("posture", "joints", "stance") if getattr(given, name)]
    if len(chosen) > 1:
        raise InvalidInput(f"{' and '.join(chosen)} are given: give one of them")
    if given.joints is not None:
        return read_joints(given.joints, robot)
    if given.stance is not None:
        return stance_of(given.stance, robot)
    name = given.posture or _ask("posture in which the robot stood", robot.config.scan_posture)
    return Stance(robot.posture(name or robot.config.scan_posture), robot.legs, None)


def _scan(files: list[Path], out: Path, robot: RobotModel, stance: Stance, given: Given) -> Callable[[], None]:
    """Print the pictures of each stripe; return the function that writes the scan."""
    from guara_perception.app.files.pair_pictures import pair_pictures
    from guara_perception.app.import_pictures import mirror_angles, stripe_indices, write_scan
    from guara_perception.calibration.file import load_calibration

    known = None if given.calibration is None else load_calibration(given.calibration)
    pairs = pair_pictures(files, given.off, given.number)
    order = stripe_indices(pairs, robot, given.mode, given.indices)
    angles = mirror_angles(order, robot, known)
    for index, pair in zip(order, pairs, strict=True):
        degrees = np.rad2deg(angles[index])
        dark = pair.off.name if pair.off else "none"
        click.echo(f"stripe {index:3d} {degrees:+8.3f} degrees: {pair.on.name}, without the laser: {dark}")
    return lambda: write_scan(out, dict(zip(order, pairs, strict=True)), angles, robot, stance)


def _session(files: list[Path], out: Path, robot: RobotModel, stance: Stance, given: Given) -> Callable[[], None]:
    """Print the purpose of each picture; return the function that writes the session."""
    from guara_perception.app.import_pictures import write_session
    from guara_perception.app.record.record import planned_crosses
    from guara_perception.app.record.session_writer import SessionPlan
    from guara_perception.app.targets.drawings import parse_board, parse_heights

    by_name = {path.name: path for path in files}
    chosen = {
        "--ground": given.ground or _ask("picture of the board on the floor", files[0].name),
        "--crosses-picture": given.crosses_picture or _ask("picture of the crosses", files[-1].name),
    }
    for option, name in chosen.items():
        if name not in by_name:
            found = "is missing" if name is None else f"is {name!r}, which is none of the pictures"
            raise InvalidInput(f"{option} {found}; allowed: the name of one of the {len(files)} pictures")
    floor, mat = (by_name[str(name)] for name in chosen.values())
    boards = [path for path in files if path not in (floor, mat)]
    if floor == mat or not boards:
        raise InvalidInput(
            "a session needs pictures of the board, another one of the board on the floor, and one of the crosses"
        )
    pieces = given.plate or tuple((_ask("plates, HEIGHT=FOLDER, separated by spaces", "") or "").split())
    tops = parse_heights(",".join(piece.partition("=")[0] for piece in pieces), "list of --plate heights")
    scans = [Path(piece.partition("=")[2]) for piece in pieces]
    points = planned_crosses(given.crosses, robot)
    board = parse_board(given.board, given.square, given.pattern)
    plan = SessionPlan(robot.name, board, points, tops, stance)
    for path in boards:
        click.echo(f"board: {path.name}")
    click.echo(f"board on the floor: {floor.name}\ncrosses: {mat.name}")
    for top, scan in zip(tops, scans, strict=True):
        click.echo(f"plate of {1e3 * top:g} mm: {scan}")
    return lambda: write_session(out, plan, boards, floor, mat, scans)

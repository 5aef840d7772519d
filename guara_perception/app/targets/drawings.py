"""Calibration targets (board, crosses, floor mat, labels, ruler): drawings, PDF file, and parsers of their options."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from guara_perception.app.targets.sheet import Page, Sheet, figure_of, pages_of
from guara_perception.arrays import Float, Mask
from guara_perception.calibration.board import BLACK, CHARUCO, CHECKERBOARD, BoardSpec
from guara_perception.calibration.crosses import ARM_M, BAR_M
from guara_perception.calibration.faults import MIN_HEIGHT_DIFFERENCE_M
from guara_perception.calibration.find_board import board_ink
from guara_perception.exceptions import InvalidInput
from guara_perception.files import check_target, whole_file
from guara_perception.settings import Settings

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from kinematics import RobotModel

DEFAULT_BOARD = BoardSpec(columns=9, rows=7, square=0.030)
DEFAULT_PLATES = (0.0, 0.040, 0.080)
# The detectors need a white border around the board. A third of a square is enough, and 300 mm boards still fit on A3.
QUIET_OF_SQUARE = 0.33
# Distance of the four outer crosses from the borders of the scanned area.
CROSS_INSET_M = 0.020
MAT_BORDER_M = 0.030
# Distance of the rulers from the borders of their drawing.
RULER_MM = 6.0
INK = "black"
GUIDE = "#888888"


def write_targets(
    path: str | Path,
    robot: RobotModel,
    *,
    board: BoardSpec = DEFAULT_BOARD,
    paper: str = "a4",
    plates: tuple[float, ...] = DEFAULT_PLATES,
) -> list[Page]:
    """Write board, crosses, mat, labels and ruler to one PDF file, atomically.

    Args:
        path: file to write, which must end in .pdf.
        robot: robot whose soles and area the mat shows.
        board: the board.
        paper: "a4", "letter" or "a3".
        plates: nominal heights for the labels [m].

    Returns:
        The pages, in order.

    Raises:
        InvalidInput: `path` does not end in .pdf or is a folder, the paper size is unknown, or a ChArUco board needs
            more markers than the largest dictionary has.
        MissingFile: the folder of `path` does not exist.
    """
    from matplotlib.backends.backend_pdf import PdfPages

    check_target(path, ".pdf")
    sheets = [ruler(), calibration_board(board), crosses(), mat(robot), labels(plates)]
    pages = [page for sheet in sheets for page in pages_of(sheet, paper)]
    # No date is written, so that the same options give the same bytes.
    metadata = {"Title": f"Calibration targets of {robot.name}", "CreationDate": None}
    # Made in memory, because on a full disk PdfPages fails a second time when it is closed.
    content = io.BytesIO()
    with PdfPages(content, metadata=metadata) as document:
        for page in pages:
            document.savefig(figure_of(page))
    with whole_file(path) as temporary:
        temporary.write_bytes(content.getvalue())
    return pages


def cross_points(robot: RobotModel) -> Float:
    """Nominal positions (5, 2) of the crosses in base_footprint [m].

    Four are near the corners of the scanned area. The fifth makes the pattern differ from its mirror image.
    """
    settings = Settings.of(robot)
    (x0, x1), (y0, y1) = settings.footprint_x, settings.footprint_y
    inset = CROSS_INSET_M
    return np.array(
        [
            [x0 + inset, y1 - inset],
            [x0 + inset, y0 + inset],
            [x1 - inset, y0 + inset],
            [x1 - inset, y1 - inset],
            [0.75 * x0 + 0.25 * x1, 0.25 * y0 + 0.75 * y1],
        ]
    )


def calibration_board(board: BoardSpec) -> Sheet:
    """Board in black and white with a white border, its first corner at the top left.

    Raises:
        InvalidInput: a ChArUco board needs more markers than the largest dictionary has.
    """
    square = 1e3 * board.square
    quiet = QUIET_OF_SQUARE * square
    columns, rows = board.columns + 1, board.rows + 1
    # On paper the corners are counted from the top left, and the markers are upright.
    ink = board_ink(board)[::-1]
    cell = square * columns / ink.shape[1]

    def draw(axes: Axes) -> None:
        from matplotlib.collections import PolyCollection

        # One artist for all: a board of small squares has tens of thousands of runs.
        runs = np.array(list(_runs(ink)), np.float64)
        left, bottom = quiet + cell * runs[:, 0], quiet + cell * runs[:, 1]
        right, top = left + cell * runs[:, 2], bottom + cell * runs[:, 3]
        outlines = np.stack((left, bottom, right, bottom, right, top, left, top), axis=1).reshape(-1, 4, 2)
        axes.add_collection(PolyCollection(list(outlines), facecolor=INK, edgecolor="none", antialiased=False))

    name = "ChArUco board" if board.pattern == CHARUCO else "Checkerboard"
    size = f"{board.columns} x {board.rows} inner corners, {square:g} mm squares"
    return Sheet(f"{name}, {size}", columns * square + 2 * quiet, rows * square + 2 * quiet, draw)


def _runs(ink: Mask) -> Iterator[tuple[int, int, int, int]]:
    """Yield column, row, width and height of runs of inked cells, along the rows and along the columns.

    Touching cells are in one run, so that no white hairline shows between them.
    """
    for cells, across in ((ink, True), (ink.T, False)):
        for line, row in enumerate(cells):
            ends = np.flatnonzero(np.diff(row, prepend=False, append=False)).reshape(-1, 2)
            for start, end in ends.tolist():
                yield (start, line, end - start, 1) if across else (line, start, 1, end - start)


def crosses() -> Sheet:
    """Six crosses to cut out, one of them spare, each with an outline and centre lines for placing it on a point."""
    cell = 60.0

    def draw(axes: Axes) -> None:
        for column in range(2):
            for row in range(3):
                x, y = (column + 0.5) * cell, (row + 0.5) * cell
                _cross(axes, x, y)
                for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
                    inner, outer = 1e3 * ARM_M + 6, cell / 2
                    _line(axes, x + dx * inner, y + dy * inner, x + dx * outer, y + dy * outer)
                _outline(axes, column * cell, row * cell, cell, cell)

    arm, bar = 2e3 * ARM_M, 2e3 * BAR_M
    return Sheet(f"Crosses, {arm:g} mm from tip to tip, bars {bar:g} mm wide", 2 * cell, 3 * cell, draw)


def mat(robot: RobotModel) -> Sheet:
    """Floor mat for a robot in its scan posture, with crosses and the outlines of the soles; x up, y to the left.

    When the robot stands on the outlines, the crosses are at `cross_points`.
    """
    from kinematics import Stance

    posture = robot.posture(robot.config.scan_posture)
    pose = robot.stance_pose(Stance(posture, robot.legs, None))
    soles = pose.soles_in_footprint[:, :2]
    points = cross_points(robot)
    length, width = robot.sole
    low = np.minimum(points.min(axis=0), soles.min(axis=0) - np.array([length, width]) / 2) - MAT_BORDER_M
    high = np.maximum(points.max(axis=0), soles.max(axis=0) + np.array([length, width]) / 2) + MAT_BORDER_M

    def on_paper(point: Float) -> tuple[float, float]:
        return float(1e3 * (high[1] - point[1])), float(1e3 * (point[0] - low[0]))

    def draw(axes: Axes) -> None:
        for leg, sole in zip(robot.legs, soles, strict=True):
            x, y = on_paper(sole + np.array([-length, width]) / 2)
            _outline(axes, x, y, 1e3 * width, 1e3 * length)
            _centre_lines(axes, *on_paper(sole), 1e3 * width, 1e3 * length)
            axes.text(*on_paper(sole + np.array([length / 2 + 0.004, 0])), f"{leg}, toe end", ha="center", fontsize=7)
        for point in points:
            _cross(axes, *on_paper(point))
            label = f"({point[0]:.3f}, {point[1]:.3f}) m"
            axes.text(*on_paper(point - np.array([ARM_M + 0.010, 0])), label, ha="center", va="top", fontsize=6)
        origin = on_paper(np.zeros(2))
        _centre_lines(axes, *origin, 40, 40)
        axes.text(origin[0] + 3, origin[1] + 3, "base_footprint", fontsize=6, color=GUIDE)

    size = 1e3 * (high - low)
    return Sheet(f"Floor mat for {robot.name}, scan posture; x up, y to the left", float(size[1]), float(size[0]), draw)


def labels(heights: tuple[float, ...]) -> Sheet:
    """One label for each height, with space for the measured value."""
    width, height = 90.0, 30.0

    def draw(axes: Axes) -> None:
        for row, nominal in enumerate(heights):
            y = (len(heights) - 1 - row) * height
            _outline(axes, 0, y, width, height)
            axes.text(4, y + 20, f"plate, nominal {1e3 * nominal:g} mm", fontsize=11)
            axes.text(4, y + 8, "measured above the floor: ............ mm", fontsize=9)

    return Sheet("Plate labels: measure each plate with a caliper", width, height * len(heights), draw)


def ruler() -> Sheet:
    """Two rulers of 150 mm, along and across, for measuring the printer's scale with a caliper."""
    length = 150.0

    def draw(axes: Axes) -> None:
        for across in (False, True):
            _ruler_line(axes, across, (0, 0), (length, 0))
            ha, va = ("center", "bottom") if across else ("left", "center")
            for mark in range(int(length) + 1):
                size = 8.0 if mark % 10 == 0 else 5.0 if mark % 5 == 0 else 3.0
                _ruler_line(axes, across, (mark, 0), (mark, size))
                if mark % 10 == 0:
                    axes.text(*_on_ruler(across, mark, size + 1), f"{mark}", fontsize=5, ha=ha, va=va)
        axes.text(60, 90, "Measure 0 to 150 mm on both rulers.", fontsize=9)
        axes.text(60, 80, "If a ruler is not 150.0 mm long, pass its length to", fontsize=9)
        axes.text(60, 73, "`guara record --printed-150 LENGTH`.", fontsize=9)

    return Sheet("Ruler", length + 12, length + 12, draw)


def _on_ruler(across: bool, along: float, beside: float) -> tuple[float, float]:
    """Convert ruler coordinates, along the edge and away from it, to a position on the paper [mm]."""
    return (RULER_MM + along, RULER_MM + beside) if across else (RULER_MM + beside, RULER_MM + along)


def _ruler_line(axes: Axes, across: bool, *ends: tuple[float, float]) -> None:
    axes.plot(*zip(*(_on_ruler(across, *end) for end in ends), strict=True), color=INK, linewidth=0.3)


def _cross(axes: Axes, x: float, y: float) -> None:
    arm, bar = 1e3 * ARM_M, 1e3 * BAR_M
    _rectangle(axes, x - arm, y - bar, 2 * arm, 2 * bar)
    _rectangle(axes, x - bar, y - arm, 2 * bar, 2 * arm)


def _rectangle(axes: Axes, x: float, y: float, width: float, height: float) -> None:
    from matplotlib.patches import Rectangle

    axes.add_patch(Rectangle((x, y), width, height, facecolor=INK, edgecolor="none", linewidth=0, antialiased=False))


def _outline(axes: Axes, x: float, y: float, width: float, height: float) -> None:
    from matplotlib.patches import Rectangle

    axes.add_patch(Rectangle((x, y), width, height, fill=False, edgecolor=GUIDE, linewidth=0.4))


def _line(axes: Axes, x0: float, y0: float, x1: float, y1: float) -> None:
    axes.plot([x0, x1], [y0, y1], color=GUIDE, linewidth=0.3)


def _centre_lines(axes: Axes, x: float, y: float, width: float, height: float) -> None:
    _line(axes, x - width / 2, y, x + width / 2, y)
    _line(axes, x, y - height / 2, x, y + height / 2)


def parse_board(size: str, square: float, pattern: str = CHECKERBOARD) -> BoardSpec:
    """Convert "COLUMNSxROWS" inner corners, the edge of a square [m] and a pattern to a board.

    Raises:
        InvalidInput: the text does not have this form, or a size is out of range.
    """
    columns, between, rows = size.partition("x")
    if not (between and columns.isdigit() and rows.isdigit()):
        raise InvalidInput(f"--board is {size!r}; it must be COLUMNSxROWS of inner corners, such as 9x7")
    board = BoardSpec(int(columns), int(rows), square, pattern, BLACK if pattern == CHECKERBOARD else None)
    if not (3 <= board.columns <= 40 and 3 <= board.rows <= 40 and 0.005 <= square <= 0.1):
        raise InvalidInput(
            f"board has {board.columns}x{board.rows} inner corners and squares of {square:g} m; allowed: 3 ... 40 "
            f"corners each way, squares of 0.005 ... 0.1 m"
        )
    return board


def parse_heights(text: str, name: str = "--plates") -> tuple[float, ...]:
    """Convert a text of plate heights [m], separated by commas, to numbers; `name` is the name of the text in messages.

    Raises:
        InvalidInput: a height is not a number, there are more than 20, some are more than 0.5 m from the floor, or no
            two successive heights are MIN_HEIGHT_DIFFERENCE_M or more apart.
    """
    try:
        heights = tuple(float(height) for height in text.split(","))
    except ValueError:
        raise InvalidInput(f"{name} is {text!r}; it must be heights in metres, separated by commas") from None
    are_apart = np.diff(sorted(heights)).max(initial=0.0) >= MIN_HEIGHT_DIFFERENCE_M
    if not (are_apart and len(heights) <= 20 and all(-0.5 <= h <= 0.5 for h in heights)):
        raise InvalidInput(
            f"{name} is {text!r}, allowed: 2 ... 20 heights of -0.5 ... 0.5 m, two successive ones "
            f"{MIN_HEIGHT_DIFFERENCE_M:g} m or more apart; 0 is the bare floor"
        )
    return heights

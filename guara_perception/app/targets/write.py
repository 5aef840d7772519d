"""PDF output of the calibration targets, to scale."""

from __future__ import annotations

import io
from pathlib import Path

from guara_perception.app.targets.drawings import calibration_board, crosses, labels, mat, ruler
from guara_perception.app.targets.sheet import Page, figure_of, pages_of
from guara_perception.calibration.board import BoardSpec
from guara_perception.files import check_target, whole_file
from kinematics import RobotModel

DEFAULT_BOARD = BoardSpec(columns=9, rows=7, square=0.030)
DEFAULT_PLATES = (0.0, 0.040, 0.080)


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

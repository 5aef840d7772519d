"""`guara targets`: draw the calibration targets to a PDF file."""

from __future__ import annotations

from pathlib import Path

import click

from guara_perception.app.options import FILE, board_options


@click.command(name="targets")
@click.option("-o", "--out", required=True, type=FILE, help="PDF file to write")
@click.option("--robot", default="guara", help="name or folder of the robot to calibrate")
@click.option("--paper", type=click.Choice(["a4", "letter", "a3"]), default="a4", help="paper size")
@board_options
def command(out: Path, robot: str, paper: str, board: str, pattern: str, square: float, plates: str) -> None:
    """Draw the calibration targets to scale: ruler, board, crosses, floor mat, plate labels.

    Drawings larger than a page are split, with marks for joining the pages. Print at 100 % and check the ruler.

    \b
    Example:
      guara targets -o targets.pdf --paper a3
      guara targets -o targets.pdf --paper a3 --pattern charuco
    """
    from guara_perception.app.targets.drawings import cross_points, parse_board, parse_heights, write_targets
    from kinematics import load_robot

    model = load_robot(robot)
    spec, heights = parse_board(board, square, pattern), parse_heights(plates)
    pages = write_targets(out, model, board=spec, paper=paper, plates=heights)
    for title in dict.fromkeys(page.sheet.title for page in pages):
        count = sum(page.sheet.title == title for page in pages)
        click.echo(f"{title}: {count} page{'s' if count > 1 else ''}")
    crosses = ", ".join(f"({x:.3f}, {y:.3f})" for x, y in cross_points(model))
    click.echo(f"{out}: {len(pages)} pages; place the crosses at {crosses} m in base_footprint")

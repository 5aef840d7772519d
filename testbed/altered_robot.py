"""Copies of the Guará's folder with other settings."""

from __future__ import annotations

import shutil
from pathlib import Path

from kinematics import load_robot


def altered_guara(folder: Path, *settings: tuple[str, str]) -> Path:
    """Copy the robot's folder to `folder`/guara and change its robot.toml; return the copy.

    Args:
        folder: where the copy is made.
        settings: texts of robot.toml that are replaced at their first place, each with what replaces it.
    """
    robot = Path(shutil.copytree(load_robot("guara").folder, folder / "guara"))
    text = (robot / "robot.toml").read_text()
    for setting, instead in settings:
        assert setting in text, setting
        text = text.replace(setting, instead, 1)
    (robot / "robot.toml").write_text(text)
    return robot

"""Copies of the Guará's folder with other settings."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

from kinematics import load_robot


def altered_guara(folder: Path, *settings: tuple[str, str]) -> Path:
    """Copy the Guará's folder to `folder`/guara, edit its robot.toml, and return the path of the copy.

    Args:
        folder: folder that will contain the copy.
        settings: pairs of a text in robot.toml and its replacement; the first occurrence is replaced.
    """
    robot = Path(shutil.copytree(load_robot("guara").folder, folder / "guara"))
    text = (robot / "robot.toml").read_text()
    for setting, instead in settings:
        assert setting in text, setting
        text = text.replace(setting, instead, 1)
    (robot / "robot.toml").write_text(text)
    return robot


def telescopic_guara(folder: Path) -> Path:
    """Make a copy with prismatic knees: shanks slide into thighs by up to 0.1 m; heights of postures are unchanged."""
    robot = altered_guara(folder)
    urdf, srdf = robot / "urdf" / "guara.urdf", robot / "srdf" / "guara.srdf"
    knee = re.compile(r'(\w\w_kfe_joint" type=)"revolute"(.*?)<axis xyz="0 1 0"/>\s*<limit [^>]*>', re.DOTALL)
    slide = r'\1"prismatic"\2<axis xyz="0 0 1"/><limit lower="0" upper="0.1" effort="40" velocity="1"/>'
    urdf.write_text(knee.sub(slide, urdf.read_text()))
    text = re.sub(r'(_(?:hfe|afe)_joint" value)="[^"]*"', r'\1="0"', srdf.read_text())
    bent, length = re.compile(r'(0 0 )([\d.]+)( 0 0 0 1"/>)(.*?)(?=</group_state>)', re.DOTALL), 0.4

    def straight(posture: re.Match[str]) -> str:
        slid = f'_kfe_joint" value="{length - float(posture[2]):.9f}"'
        return posture[1] + posture[2] + posture[3] + re.sub('_kfe_joint" value="[^"]*"', slid, posture[4])

    srdf.write_text(bent.sub(straight, text))
    return robot

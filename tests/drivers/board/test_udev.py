"""The udev rule."""

import os
import subprocess
from pathlib import Path

from drivers.board.usb_link import UDEV_RULE_FILE, udev_instructions, udev_rule


def test_rule_names_the_ids_in_lower_case_hexadecimal() -> None:
    """udev compares the ids as text of four lower-case digits."""
    rule = udev_rule(0x1ABC, 0x0002)
    assert 'ATTR{idVendor}=="1abc"' in rule and 'ATTR{idProduct}=="0002"' in rule
    assert "uaccess" in rule


def test_instructions_install_the_rule_and_load_it() -> None:
    """The name of the file sorts before 73, in which uaccess is evaluated."""
    text = udev_instructions()
    assert udev_rule() in text and UDEV_RULE_FILE in text and "udevadm control --reload-rules" in text
    assert int(UDEV_RULE_FILE.rsplit("/", 1)[1].split("-")[0]) < 73


def test_instructions_can_be_pasted_into_a_shell(tmp_path: Path) -> None:
    """The printed line, from the command to its end, writes the rule and nothing else."""
    sudo, log = tmp_path / "sudo", tmp_path / "log"
    sudo.write_text(f'#!/bin/sh\necho "$@" >> {log}\nif [ "$1" = tee ]; then cat >> {log}; fi\n')
    sudo.chmod(0o755)
    printed = " ".join(f"Install the udev rule:\n{udev_instructions()}".split())
    line = printed[printed.index("echo ") :]
    environment = {**os.environ, "PATH": f"{tmp_path}:{os.environ['PATH']}"}
    done = subprocess.run(["bash", "-c", line], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout + done.stderr == ""
    assert log.read_text().splitlines() == [
        f"tee {UDEV_RULE_FILE}",
        udev_rule(),
        "udevadm control --reload-rules",
        "udevadm trigger",
    ]

"""The udev rule that lets an ordinary user open the board, and the commands that install it."""

from __future__ import annotations

from drivers.board.protocol import PRODUCT_ID, VENDOR_ID

UDEV_RULE_FILE = "/etc/udev/rules.d/70-guara-laser-board.rules"


def udev_rule(vendor_id: int = VENDOR_ID, product_id: int = PRODUCT_ID) -> str:
    """The rule: the user who sits at the machine, and the group `plugdev`, may open the board."""
    return (
        f'SUBSYSTEM=="usb", ATTR{{idVendor}}=="{vendor_id:04x}", ATTR{{idProduct}}=="{product_id:04x}", '
        'MODE="0660", GROUP="plugdev", TAG+="uaccess"'
    )


def udev_instructions(vendor_id: int = VENDOR_ID, product_id: int = PRODUCT_ID) -> str:
    """The commands to type, one per line, that install the rule."""
    return (
        f"echo '{udev_rule(vendor_id, product_id)}' | sudo tee {UDEV_RULE_FILE}\n"
        "sudo udevadm control --reload-rules && sudo udevadm trigger\n"
        "then unplug the board and plug it in again"
    )

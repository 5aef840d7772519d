"""The udev rule."""

from drivers.board.usb_link import UDEV_RULE_FILE, udev_instructions, udev_rule


def test_rule_names_the_ids_in_lower_case_hexadecimal() -> None:
    """udev compares the ids as text, four lower-case digits."""
    rule = udev_rule(0x1ABC, 0x0002)
    assert 'ATTR{idVendor}=="1abc"' in rule and 'ATTR{idProduct}=="0002"' in rule
    assert "uaccess" in rule


def test_instructions_install_the_rule_and_load_it() -> None:
    """A user can paste the lines; the file sorts before 73, where uaccess is acted upon."""
    text = udev_instructions()
    assert udev_rule() in text and UDEV_RULE_FILE in text and "udevadm control --reload-rules" in text
    assert int(UDEV_RULE_FILE.rsplit("/", 1)[1].split("-")[0]) < 73

"""Product, USB ids and serial number of the USB camera behind a Linux video device."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

VIDEO_DEVICES = Path("/sys/class/video4linux")


def usb_identity(path: str) -> str:
    """Return the identity of a USB camera, such as "OV9281 (1bcf:0b09), serial 0042"; empty for any other device.

    It consists of product, USB ids and serial number. Some manufacturers give their cameras no serial number, or the
    same one to all of them.

    Args:
        path: path of the video device, or a link to it.
    """
    folder = (VIDEO_DEVICES / Path(path).resolve().name / "device").resolve().parent
    if not (folder / "idProduct").is_file():
        return ""
    found = {name: _text(folder / name) for name in ("product", "idVendor", "idProduct", "serial")}
    serial = f", serial {found['serial']}" if found["serial"] else ""
    return f"{found['product']} ({found['idVendor']}:{found['idProduct']}){serial}".strip()


def _text(path: Path) -> str:
    with suppress(OSError):
        return "".join(filter(str.isprintable, path.read_text(encoding="utf-8", errors="replace").strip()))
    return ""

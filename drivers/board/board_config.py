"""Configuration of the connection to a laser board."""

from __future__ import annotations

import math
from dataclasses import dataclass

from drivers.board.protocol import PRODUCT_ID, VENDOR_ID


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardConfig:
    """Configuration of a `LaserBoard`.

    Attributes:
        vendor_id: USB vendor id, 0 ... 0xFFFF.
        product_id: USB product id, 0 ... 0xFFFF.
        serial: serial number of the board; needed only if several boards are plugged in. None = the only one.
        timeout: timeout of a control transfer [s]. It must be short, because the watchdog allows at most 0.4 s of
            silence. A failed command is not repeated once half of the watchdog's time has passed.
        attempts: largest number of attempts for a command whose transfer times out, stalls or fails, or whose reply is
            invalid, 1 ... 10.
        motion_timeout: longest wait for the end of a motion [s].
        home_timeout: longest wait for the end of homing [s].
        handle_signals: True = while the board is open, SIGTERM and SIGHUP raise SystemExit, so that `with` blocks clean
            up. Signals that the program handles or ignores are not changed; if the board is opened outside the main
            thread, none is.

    Raises:
        ValueError: a value is not allowed.
    """

    vendor_id: int = VENDOR_ID
    product_id: int = PRODUCT_ID
    serial: str | None = None
    timeout: float = 0.1
    attempts: int = 3
    motion_timeout: float = 2.0
    home_timeout: float = 5.0
    handle_signals: bool = True

    def __post_init__(self) -> None:
        """Check every value."""
        for name in ("vendor_id", "product_id"):
            value = getattr(self, name)
            if not 0 <= value <= 0xFFFF:
                raise ValueError(f"{name} is {value}, allowed: 0 ... 65535 (0xFFFF)")
        for name in ("timeout", "motion_timeout", "home_timeout"):
            seconds = getattr(self, name)
            if not (math.isfinite(seconds) and seconds > 0):
                raise ValueError(f"{name} is {seconds} s; it must be finite and above 0")
        if not 1 <= self.attempts <= 10:
            raise ValueError(f"attempts is {self.attempts}, allowed: 1 ... 10")

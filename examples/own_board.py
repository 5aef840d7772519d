"""Driver for a laser board of your own, with eight members: here a PIC that obeys lines of text, and its simulation.

    python examples/own_board.py

Put this file beside devices.toml and name it there below [board], `source = "own_board:PicBoard"`; every command
accepts `--devices devices.toml`. `drivers.Board` documents what a board must guarantee; test yours with:

    GUARA_BOARD=own_board:PicBoard PYTHONPATH=examples python -m pytest tests/drivers/board/test_any_board.py
"""

import time

from drivers import Board, BoardError, BoardFlag, BoardIdentity, BoardStatus
from drivers.errors import BoardNotOpen, BoardTimeout, LaserDead, LaserStuckOn, MirrorNotHomed, MirrorOutOfRange

IDENTITY = BoardIdentity(
    protocol=(0, 0),
    firmware=(1, 0),
    step_angle=7e-5,
    min_step=0,
    max_step=9000,
    zero_step=3000,
    watchdog=0.3,
    laser_limit=1.0,
    laser_rest=0.05,
)


class SimulatedPic:
    """Firmware: commands `S` status, `L1`, `L0`, `H` home, `G 1200` go to step; answers `light moving homed step`."""

    def __init__(self) -> None:
        self.step, self.homed, self.moved_until = 0, False, 0.0
        self.heard, self.lit_since = 0.0, 0.0

    def ask(self, line: str) -> str:
        """Execute a command. For eye safety, 0.3 s without a command or 1 s of light turn the laser off."""
        now = time.monotonic()
        is_over = now - self.heard > IDENTITY.watchdog or now - self.lit_since > IDENTITY.laser_limit
        self.heard = now
        if line == "L0" or is_over:
            self.lit_since = 0.0
        if line == "L1":
            self.lit_since = self.lit_since or now
        elif line == "H":
            self.step, self.homed, self.moved_until = 0, True, now + 0.05
        elif line.startswith("G "):
            self.step, self.moved_until = int(line[2:]), now + 0.01
        return f"{int(self.lit_since > 0)} {int(now < self.moved_until)} {int(self.homed)} {self.step}"


class PicBoard(Board):
    """Board that answers each line with a line; for a real one, `_ask` writes to and reads from a serial port."""

    def __init__(self) -> None:
        self._pic = SimulatedPic()
        self._is_open = False

    @property
    def identity(self) -> BoardIdentity:
        """Travel of the mirror and limits of the laser."""
        if not self._is_open:
            raise BoardNotOpen("the board is not open: use `with PicBoard() as board:`")
        return IDENTITY

    def open(self) -> None:
        """Connect, with the laser off."""
        self._is_open = True
        self.laser_off()

    def close(self) -> None:
        """Turn the laser off, and disconnect even if that fails."""
        if self._is_open:
            try:
                self.laser_off()
            finally:
                self._is_open = False

    def status(self) -> BoardStatus:
        """Query the status, which also resets the watchdog."""
        return self._ask("S")

    def laser_on(self) -> BoardStatus:
        """Turn the laser on, and check it with the photodiode."""
        status = self._ask("L1")
        if not status.laser_sensed:
            self._ask("L0")
            raise LaserDead("the laser was switched on but the board senses no light: check the diode")
        return status

    def laser_off(self) -> BoardStatus:
        """Turn the laser off, and check it with the photodiode."""
        status = self._ask("L0")
        if status.laser_sensed:
            raise LaserStuckOn("the laser still shines after it was switched off: cut its power by hand")
        return status

    def home(self) -> int:
        """Home the mirror; a firmware that counts steps would return the number lost."""
        self._ask("H")
        self.wait_until_still()
        return 0

    def go_to_step(self, step: int, *, wait: bool = True) -> float:
        """Turn the mirror to a step; with `wait`, until it stands still."""
        if not self.status().homed:
            raise MirrorNotHomed("the mirror's home is unknown: call home() or ensure_ready() first")
        if not IDENTITY.min_step <= step <= IDENTITY.max_step:
            raise MirrorOutOfRange(f"step {step} is outside the travel of {IDENTITY.min_step} ... {IDENTITY.max_step}")
        self._ask(f"G {step}")
        if wait:
            self.wait_until_still()
        return IDENTITY.angle_of(step)

    def _ask(self, line: str) -> BoardStatus:
        """Send a line and parse the answer."""
        if not self._is_open:
            raise BoardNotOpen("the board is not open: use `with PicBoard() as board:`")
        try:
            light, moving, homed, step = map(int, self._pic.ask(line).split())
        except ValueError:
            raise BoardTimeout(f"no readable answer to {line!r}: check the cable") from None
        flags = BoardFlag.HAS_SENSOR | (BoardFlag.LASER_SENSED | BoardFlag.LASER_COMMANDED) * light
        return BoardStatus(flags=flags | BoardFlag.MOVING * moving | BoardFlag.HOMED * homed, step=step)


def main() -> None:
    """Use the board in a `with` block, which turns the laser off at its end, even after an exception."""
    with PicBoard() as board:
        print(f"ready: {board.ensure_ready()}")
        board.go_to_angle(0.10)
        print(f"lit: {board.laser_on()}")
        try:
            board.go_to_angle(1.0)
        except BoardError as error:
            print(f"refused: {error}")
    print("laser off")


if __name__ == "__main__":
    main()

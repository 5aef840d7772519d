"""Sweeps that the board executes: options, step table, start, and trigger times."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from drivers.board.board_records import BoardStatus
from drivers.board.laser_board import LaserBoard
from drivers.board.protocol import SWEEP_PLACES, SWEEP_STRIPES, WAIT_UNITS, BoardFlag, Request, SweepOffFrames, signed
from drivers.board.sweep_records import StripeRecord
from drivers.errors import BoardTooOld
from drivers.sweep.options import OffFrames

# Modulus of the sweep numbers.
NUMBERS = 128
# The board's clock counts microseconds in 32 bits.
CLOCK_WRAP = (1 << 32) * 1e-6


class BoardSweep:
    """Sweeps of an open board.

    Attributes:
        counts_exposures: True if the board counts the exposures of the camera.
    """

    def __init__(self, board: LaserBoard) -> None:
        """Check that an open board can execute sweeps.

        Raises:
            BoardTooOld: the firmware cannot execute sweeps (protocol 1.0).
        """
        status = board.status()
        if BoardFlag.HAS_SWEEP not in status.flags:
            major, minor = board.identity.protocol
            raise BoardTooOld(
                f"the laser board speaks protocol {major}.{minor} and cannot sweep by itself (1.1 can): flash "
                "firmware/guara_board.uf2, or scan without AcquireOptions.sweep"
            )
        self.counts_exposures = BoardFlag.COUNTS_EXPOSURES in status.flags
        self._board = board
        self._number = status.motion % NUMBERS
        self._first_clock: float | None = None

    def prepare(self, flash: float, period: float, off: OffFrames) -> None:
        """Set the options of all sweeps of a scan.

        Args:
            flash: longest duration of a stripe's flash [s].
            period: shortest time between two triggers [s].
            off: off frames to take.
        """
        self._board.command(Request.SWEEP_FLASH, round(flash * 1e6))
        self._board.command(Request.SWEEP_PERIOD, round(period * 1e6))
        self.set_off_frames(off)

    def set_off_frames(self, off: OffFrames) -> None:
        """Set which off frames the following sweeps take."""
        self._board.command(Request.SWEEP_OFF_FRAMES, SweepOffFrames[off.name])

    def begin(
        self, steps: Sequence[int], waits: Sequence[int], first: int = 0, dark_after: Collection[int] = ()
    ) -> BoardStatus:
        """Write the step table and start a sweep; return a status whose `motion` identifies the records of the sweep.

        Args:
            steps: motor steps of the stripes, in order; at most 256.
            waits: wait before the trigger of each stripe, in units of 0.5 ms.
            first: index of the first stripe in the step table. Entries that the board already has are not sent again.
            dark_after: indices, in the step table, of the stripes that are followed by a dark flash.

        Raises:
            ValueError: there are too many stripes or none, the number of waits differs, or a wait is out of range.
            BoardError: the board rejects a command, does not respond, or its mirror does not come to rest.
        """
        if not 1 <= len(steps) <= SWEEP_STRIPES or len(waits) != len(steps):
            raise ValueError(
                f"{len(steps)} stripes with {len(waits)} waits; allowed: 1 ... {SWEEP_STRIPES}, one wait each"
            )
        if not all(0 <= wait <= WAIT_UNITS for wait in waits):
            raise ValueError(f"waits {min(waits)} ... {max(waits)}; allowed: 0 ... {WAIT_UNITS}")
        table, darks = self._board.sweep_table, self._board.sweep_darks
        for place, (step, wait) in enumerate(zip(steps, waits, strict=True), first):
            argument = signed(wait << 25 | place % SWEEP_PLACES << 16 | step & 0xFFFF)
            if table.get(place) != argument:
                self._board.command(Request.SWEEP_STEP, argument)
                table[place] = argument
            is_dark = place in dark_after
            if is_dark is not (place in darks):
                self._board.command(Request.SWEEP_DARK, int(is_dark) << 16 | place)
                (darks.add if is_dark else darks.discard)(place)
        self._board.wait_until_still()
        while self._board.read_record(0.001) is not None:
            pass
        self._number = (self._number + 1) % NUMBERS
        return self._board.begin_sweep(signed(self._number << 25 | first << 16 | len(steps)))

    def clock_of(self, record: StripeRecord) -> float:
        """Return the time of a record's trigger relative to the first record [s]; wraps of the clock are removed."""
        if self._first_clock is None:
            self._first_clock = record.clock
        return (record.clock - self._first_clock + 0.5 * CLOCK_WRAP) % CLOCK_WRAP - 0.5 * CLOCK_WRAP

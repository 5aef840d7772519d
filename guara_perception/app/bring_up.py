"""First power-up of a laser board built as in docs/build.md, step by step, with measurements by the board itself."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

from drivers import BoardError, DriverError, LaserBoard, timing
from drivers.board.protocol import BoardFault, describe_faults
from drivers.errors import HomeNotFound, LaserDead, LaserRefused, LaserStuckOn
from guara_perception.exceptions import InvalidInput, PerceptionError

# Steps that must have passed with an LED before a laser may be connected.
DARK = ("5", "6")
RECORD = "bring_up.json"
TRIES = 3
# [s] Time after the board's watchdog has expired within which the light must go out; period of commands; time before
# the board's limit at which a light that is still on is turned off.
LATE, PERIOD, BEFORE_LIMIT = 0.06, 0.1, 2.0
HOMINGS = 10


class StepFailed(PerceptionError):
    """Failure of a step of the first power-up; the message names the remedy."""


class BringUp:
    """First power-up of a board by an operator, who follows instructions and answers questions on the terminal."""

    def __init__(self, board: LaserBoard, folder: Path, ask: Callable[[str], str], show: Callable[[str], None]) -> None:
        """Store the arguments without opening the board.

        Args:
            board: the board, closed.
            folder: folder of bring_up.json, the record of passed steps.
            ask: function that shows a question and returns the answer.
            show: function that shows a line.
        """
        self._board, self._path, self._ask, self._show = board, folder / RECORD, ask, show
        self._laser = False

    def run(self) -> None:
        """Guide the operator through the steps that apply to the light at J1, which is an LED or a laser.

        A run with an LED starts with an empty record.

        Raises:
            StepFailed: a step did not pass; it is removed from the record.
            InvalidInput: no valid answer was given, a laser is connected before steps 5 and 6 have passed with an
                LED, or bring_up.json is not a record.
            DriverError: the board cannot be reached, or fails unexpectedly.
        """
        self._laser = self._choose("What is wired to J1?", ("led", "laser")) == "laser"
        with self._board:
            serial = self._board.serial
        passed = self._passed(serial)
        missing = [step for step in DARK if step not in passed]
        if self._laser and missing:
            raise InvalidInput(
                f"a laser is wired to J1, but board {serial} has not passed step{'s' * (len(missing) > 1)} "
                f"{' and '.join(missing)} with an LED. Open SW1, wire the LED of docs/build.md to J1 and start again"
            )
        if not self._laser:
            passed = set()
            self._write(serial, passed)
        steps = {"2": self._identify, "3": self._dark, "4": self._blind, "5": self._silence, "6": self._cut}
        steps["7"] = self._motor
        for step, check in steps.items():
            if self._laser and step in ("4", "7"):
                continue
            try:
                found = check()
            except BaseException:
                self._write(serial, passed - {step})
                raise
            self._show(f"ok    step {step}: {found}")
            passed |= {step}
            if not self._laser:
                self._write(serial, passed)
        if self._laser:
            self._show("The laser goes dark as it should. Measure its power: it must be below 1 mW (docs/build.md)")
        else:
            self._show("Open SW1, glue the mirror on, replace the LED with the laser, and run this again")

    def _identify(self) -> str:
        with self._board as board:
            status, identity = board.status(), board.identity
        if status.laser_sensed:
            raise StepFailed(
                "LIGHT is high though the laser is off: check R11, D3 and U3, or leave LIGHT unconnected for now"
            )
        return f"board {board.serial} speaks protocol {identity.protocol[0]}.{identity.protocol[1]}"

    def _dark(self) -> str:
        self._do(
            "Wire everything except the photodiode and the motor (with a laser: everything), close SW1, and send no "
            "commands"
        )
        self._confirm(
            "Is it dark, and does a voltmeter at CHAIN show 0 V?",
            "Open SW1. Q1 conducts without heartbeats: check R1, R2 and R3, and check that ALIVE is low",
        )
        return "dark without heartbeats"

    def _blind(self) -> str:
        self._do("Leave D3 unconnected")
        with self._board as board:
            board.clear_faults()
            try:
                board.laser_on()
            except LaserDead:
                return "the missing photodiode was detected"
        raise StepFailed("the board senses light without a photodiode: LIGHT must be low; check U3 and R10")

    def _silence(self) -> str:
        self._do("Connect D3, place the light of J1 in front of it, and trim RV2 (docs/build.md)")
        with self._board as board:
            self._light(board)
            began = board.status().device_time
            silent = board.identity.watchdog + LATE
            timing.sleep(silent)
            status = board.status()
            taken = status.device_time - began
            if status.laser_sensed or BoardFault.WATCHDOG not in status.faults:
                raise StepFailed(
                    f"Open SW1. The watchdog did not turn the light off within {taken:.2f} s of the last command: "
                    "flash the firmware again"
                )
        self._confirm(
            "Did it light up and go out by itself within half a second?",
            "Open SW1. The photodiode senses light that you do not see: only the light of J1 may reach D3",
        )
        self._do("Bridge Q4 from CHAIN to LASER_PLUS, so that the light is stuck on")
        with self._board as board:
            board.clear_faults()
            try:
                board.laser_on()
                board.laser_off()
            except (LaserStuckOn, LaserRefused):
                pass
            # The board evaluates the photodiode for a few milliseconds before and after it cuts the supply.
            timing.sleep(LATE)
            status = board.status()
            if BoardFault.LASER_STUCK_ON not in status.faults or status.laser_sensed:
                raise StepFailed("Open SW1. The board did not detect the stuck light: check the bridge of Q4, and D3")
            self._confirm("Is it dark now?", "Open SW1. SUPPLY is low, but Q1 still conducts: check Q1, Q2 and R1")
            self._do("Remove the bridge")
            faults = board.clear_faults().faults
            if faults:
                raise StepFailed(f"Open SW1. Without the bridge, the board still reports: {describe_faults(faults)}")
        return f"dark at most {taken:.2f} s after the last command; the supply is cut if the light is stuck on"

    def _cut(self) -> str:
        for action, back, reset, cause in (
            ("hold RUN (SW2)", "Release RUN", True, "LASER and SUPPLY do not go low during a reset: check R2 and R5"),
            (
                "pull the wire of HEARTBEAT off",
                "Put the wire of HEARTBEAT back on",
                False,
                "the monostable does not time out: check C4, RV1 and that R8 is present",
            ),
            ("open SW1", "Close SW1", False, "SW1 is not in the laser's circuit: check the wire from F1 to Q1"),
        ):
            self._do(f"Get ready to {action}: do it during the few seconds in which the light is on")
            self._wait_for_dark(action, reset, cause)
            self._confirm(
                "Did it go dark within half a second?", f"Unplug the board. The light does not go out in time: {cause}"
            )
            self._do(back)
        return "dark after a reset, without heartbeats, and with SW1 open"

    def _wait_for_dark(self, action: str, reset: bool, cause: str) -> None:
        """Turn the light on, and wait until it goes out in the expected way.

        Args:
            action: what the operator has to do, for the message.
            reset: True if the board must stop answering, False if it must report the missing light.
            cause: cause if the light stays on, and its remedy, for the message.

        Raises:
            StepFailed: the light cannot be turned on, stays on, or goes out in another way.
            BoardError: the board failed before the light was on.
        """
        lit = False
        try:
            with self._board as board:
                self._light(board)
                lit = True
                end = timing.monotonic() + board.identity.laser_limit - BEFORE_LIMIT
                while timing.monotonic() < end:
                    timing.sleep(PERIOD)
                    board.laser_on()
                board.laser_off()
        except LaserDead as dark:
            if reset:
                raise StepFailed(f"the light went out, but the board still answers: {action} as asked") from dark
            return
        except BoardError as gone:
            if not lit:
                raise
            if not reset or isinstance(gone, LaserRefused | LaserStuckOn):
                raise StepFailed(f"expected the light to go out while the board answers, but: {gone}") from gone
            return
        raise StepFailed(f"Unplug the board. The light stayed on: either you did not {action} in time, or {cause}")

    def _light(self, board: LaserBoard) -> None:
        """Clear faults, then turn the light on.

        Raises:
            StepFailed: the board senses light or has faults before, or senses no light afterwards.
        """
        status = board.clear_faults()
        if status.laser_sensed or status.faults:
            found = describe_faults(status.faults)
            raise StepFailed(
                f"light is sensed or a fault is set before the light is turned on ({found}): "
                "trim RV2, shade D3, check Q4"
            )
        try:
            board.laser_on()
        except LaserDead as dark:
            raise StepFailed("no light: close SW1, point the light at D3, trim RV2, check ALIVE (RV1)") from dark

    def _motor(self) -> str:
        self._do("Connect the motor and the home switch, with no mirror on the motor")
        with self._board as board:
            try:
                board.home()
                lost = [error for _ in range(HOMINGS) if (error := self._away_and_home(board))]
            except HomeNotFound as missed:
                raise StepFailed(f"{missed}. If the motor turns the wrong way, swap one coil's wires") from missed
        if lost:
            raise StepFailed(
                f"{len(lost)} of {HOMINGS} homings lost steps ({', '.join(map(str, lost))}): raise the motor's "
                "current, or lower TOP_SPEED and ACCELERATION in firmware/config.h"
            )
        return f"found home {HOMINGS} times without a lost step"

    def _away_and_home(self, board: LaserBoard) -> int:
        board.go_to_step(board.identity.max_step)
        return board.home()

    def _do(self, text: str) -> None:
        self._choose(f"{text}; then enter", ("done",))

    def _confirm(self, question: str, remedy: str) -> None:
        if self._choose(question, ("yes", "no")) == "no":
            raise StepFailed(remedy)

    def _choose(self, question: str, allowed: tuple[str, ...]) -> str:
        for _ in range(TRIES):
            answer = self._ask(f"{question} [{'/'.join(allowed)}]").strip().lower()
            if answer in allowed:
                return answer
            self._show(f"the answer is {answer!r}, allowed: {', '.join(allowed)}")
        raise InvalidInput(f"no valid answer to {question!r} in {TRIES} tries, allowed: {', '.join(allowed)}")

    def _passed(self, serial: str) -> set[str]:
        """Steps that this board has passed with an LED; empty without a record, or if it belongs to another board.

        Raises:
            InvalidInput: the file is not a record.
        """
        try:
            record = json.loads(self._path.read_text(encoding="utf-8"))
            return set(record["passed"]) if record["serial"] == serial else set()
        except FileNotFoundError:
            return set()
        except (ValueError, KeyError, TypeError) as error:
            raise InvalidInput(f"{self._path} is not a record of a first power-up: remove it") from error

    def _write(self, serial: str, passed: set[str]) -> None:
        record = {"serial": serial, "passed": sorted(passed)}
        self._path.write_text(json.dumps(record) + "\n", encoding="utf-8")


def bring_up(board: object, folder: Path, ask: Callable[[str], str], show: Callable[[str], None]) -> bool:
    """Guide the operator through the first power-up; return False if a step or a device fails, otherwise True.

    Raises:
        InvalidInput: the board is not a `LaserBoard`; see also `BringUp.run`.
    """
    if not isinstance(board, LaserBoard):
        raise InvalidInput(f"the first power-up is for the board of docs/build.md, not for {type(board).__name__}")
    try:
        BringUp(board, folder, ask, show).run()
    except (StepFailed, DriverError) as failure:
        show(f"FAIL  {failure}")
        return False
    return True

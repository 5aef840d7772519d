"""What only the whole firmware on its emulated chip can show: USB, power, a hung processor, and the driver with it."""

from __future__ import annotations

import errno
import math
from collections.abc import Callable, Iterator

import pytest

from drivers import BoardConfig, BoardFault, LaserBoard
from drivers.board.protocol import MICROSOFT_REQUEST, REPORT_ENDPOINT, REPORT_SIZE, REQUEST_IN, Request
from drivers.emulator.backend import EmulatedBackend
from drivers.emulator.bus import BusError
from drivers.errors import BoardInUse, BoardStalled, HomeNotFound, LaserDead, LaserRefused, LaserStuckOn
from testbed.chip import Chip, ChipBus, ChipClock

pytestmark = pytest.mark.chip

# What a command's answer may take beyond a limit [s].
SLACK = 0.002


@pytest.fixture
def chip(new_chip: Callable[[], Chip]) -> Chip:
    return new_chip()


@pytest.fixture
def bus(chip: Chip) -> ChipBus:
    return ChipBus(chip)


@pytest.fixture
def board(bus: ChipBus, chip: Chip) -> Iterator[LaserBoard]:
    """The driver and pyusb on the chip, in the chip's time; at the end no USB data toggle may have been wrong."""
    with ChipClock(bus), LaserBoard(BoardConfig(handle_signals=False), backend=EmulatedBackend(bus)) as device:
        yield device
    assert chip.host.wrong_toggles == 0


def until_dark(chip: Chip, patience: float) -> float:
    """Seconds until the laser is dark."""
    took = chip.run(patience, lambda: not chip.world.lit)
    assert not chip.world.lit
    return took


def test_the_serial_number_is_that_of_the_flash(board: LaserBoard) -> None:
    assert board.serial == "E66138528361BA31"


def test_descriptors_come_from_the_device(bus: ChipBus) -> None:
    """USB 2.01, bus powered at 500 mA, one vendor interface, one interrupt endpoint of 32 bytes."""
    device = bus.control(0x80, 6, 0x0100, 0, 255, 1.0)
    assert device[:4] == bytes([18, 1, 0x01, 0x02]) and device[8:12] == bytes([0x09, 0x12, 0x01, 0x00])
    configuration = bus.control(0x80, 6, 0x0200, 0, 255, 1.0)
    assert len(configuration) == 25 and configuration[2] == 25 and configuration[7:9] == bytes([0x80, 250])
    assert configuration[9:18] == bytes([9, 4, 0, 0, 1, 0xFF, 0, 1, 0])
    assert configuration[18:] == bytes([7, 5, REPORT_ENDPOINT, 3, REPORT_SIZE, 0, 1])


def test_windows_binds_winusb(bus: ChipBus) -> None:
    """BOS names the request; its answer, longer than a packet, names WINUSB and an interface GUID."""
    bos = bus.control(0x80, 6, 0x0F00, 0, 255, 1.0)
    assert bos[:2] == b"\x05\x0f" and int.from_bytes(bos[2:4], "little") == len(bos)
    length, request = int.from_bytes(bos[29:31], "little"), bos[31]
    assert request == MICROSOFT_REQUEST
    found = bus.control(REQUEST_IN, request, 0, 7, 4096, 1.0)
    assert len(found) == length and found[10 + 4 : 10 + 10] == b"WINUSB"
    at, seen = 10, []
    while at < length:
        size = int.from_bytes(found[at : at + 2], "little")
        seen.append(int.from_bytes(found[at + 2 : at + 4], "little"))
        at += size
    assert at == length and seen == [3, 4]
    assert "DeviceInterfaceGUIDs" in found.decode("utf-16-le", "replace")


@pytest.mark.parametrize("length", [1, 63, 64, 65, 128, 162, 300])
def test_a_long_answer_of_any_length_comes_whole(bus: ChipBus, length: int) -> None:
    """Packets of 64 bytes with alternating toggles, ended by a short one or by what was asked for."""
    whole = bus.control(REQUEST_IN, MICROSOFT_REQUEST, 0, 7, 4096, 1.0)
    assert bus.control(REQUEST_IN, MICROSOFT_REQUEST, 0, 7, length, 1.0) == whole[:length]
    assert bus.chip.host.wrong_toggles == 0


def test_many_motions_keep_the_toggle(board: LaserBoard) -> None:
    board.home()
    for number in range(12):
        board.go_to_step(300 + 17 * (number % 5))


def test_clearing_the_halt_resets_the_toggle(board: LaserBoard, bus: ChipBus, chip: Chip) -> None:
    """To DATA0, also while a report waits in the USB controller: that one arrives, and the next one as well."""
    board.home()
    for _ in range(3):
        board.go_to_step(400)
        bus.command(0x02, 1, 0, REPORT_ENDPOINT, 1.0)
        board.go_to_step(300, wait=False)
        chip.run(0.3)
        bus.command(0x02, 1, 0, REPORT_ENDPOINT, 1.0)
        assert board.wait_until_still().step == 300
    assert chip.host.wrong_toggles == 0


def test_a_halted_endpoint_stalls_until_it_is_cleared(board: LaserBoard, bus: ChipBus) -> None:
    """SET_FEATURE halts it; the driver clears the halt and goes on."""
    bus.command(0x02, 3, 0, REPORT_ENDPOINT, 1.0)
    assert bus.control(0x82, 0, 0, REPORT_ENDPOINT, 2, 1.0) == b"\x01\x00"
    with pytest.raises(BoardStalled):
        board._link.read_report(0.1)
    assert bus.control(0x82, 0, 0, REPORT_ENDPOINT, 2, 1.0) == b"\x00\x00"
    board.home()


@pytest.mark.parametrize("patience", [0.0002, 0.001, 0.003])
def test_a_setup_interrupts_a_transfer(board: LaserBoard, bus: ChipBus, chip: Chip, patience: float) -> None:
    """After a host gave up while the board waited for its photodiode, its next request is answered."""
    chip.wiring.dead = True
    with pytest.raises(BusError) as silence:
        bus.control(REQUEST_IN, Request.LASER, 1, 0, 26, patience)
    assert silence.value.errno == errno.ETIMEDOUT
    assert board.status().request == Request.STATUS
    assert bus.control(0x80, 6, 0x0100, 0, 18, 1.0)[0] == 18


@pytest.mark.parametrize("what", ["reset", "suspend"])
def test_a_lost_bus_puts_the_laser_out(board: LaserBoard, bus: ChipBus, chip: Chip, what: str) -> None:
    """At once, and a new session is needed before it can be on again."""
    board.ensure_ready()
    board.laser_on()
    begun = chip.nanos
    if what == "reset":
        chip.host.reset_bus()
        chip.run(0.05)
    else:
        chip.host.suspend(True)
        chip.run(0.001)
        chip.host.suspend(False)
    assert not chip.world.lit and chip.world.switchings[-1][0] - begun < 0.012e9
    bus.await_device()
    answer = bus.control(REQUEST_IN, Request.LASER, 1, 0, 26, 1.0)
    assert answer[0] == 1 and not chip.world.lit
    board.ensure_ready()


def test_a_silent_host_goes_dark_before_the_monostable(board: LaserBoard, chip: Chip) -> None:
    """The firmware first, so the fault is latched: at 0.40 s."""
    board.laser_on()
    assert 0.38 < until_dark(chip, 1.0) <= 0.4
    assert BoardFault.WATCHDOG in board.status().faults
    with pytest.raises(LaserRefused):
        board.laser_on()


@pytest.mark.parametrize("instant", [0.0, 0.0173, 0.05, 0.0999])
def test_a_hung_processor_is_reset(board: LaserBoard, chip: Chip, instant: float) -> None:
    """By the chip's own watchdog within 0.1 s; the board comes back dark, without home or session."""
    board.laser_on()
    chip.run(instant)
    chip.frozen = True
    assert until_dark(chip, 0.5) <= 0.1 + SLACK
    assert chip.resets == 1
    board.ensure_ready()
    assert board.status().homed and not chip.world.lit


def test_without_its_watchdog_the_monostable_puts_the_laser_out(board: LaserBoard, chip: Chip) -> None:
    """0.45 s after the last edge of HEARTBEAT, whatever pins a hung processor holds."""
    board.laser_on()
    chip.has_watchdog = False
    chip.frozen = True
    assert until_dark(chip, 1.0) == pytest.approx(0.45, abs=SLACK)
    assert chip.resets == 0
    chip.replug()


def test_a_dead_laser_is_reported(board: LaserBoard, chip: Chip) -> None:
    chip.wiring.dead = True
    with pytest.raises(LaserDead):
        board.laser_on()


def test_a_stuck_laser_is_cut_from_its_supply(board: LaserBoard, chip: Chip) -> None:
    board.laser_on()
    chip.wiring.stuck_on = True
    with pytest.raises(LaserStuckOn):
        board.laser_off()
    assert not chip.world.lit
    with pytest.raises(LaserRefused):
        board.ensure_ready()
    chip.wiring.stuck_on = False
    board.ensure_ready()
    assert board.laser_on().laser_sensed


def test_lost_steps_and_a_missing_switch_are_reported(board: LaserBoard, chip: Chip) -> None:
    board.home()
    chip.world.position -= 40
    board.go_to_angle(0.2)
    assert board.home() == 40
    chip.wiring.no_home = True
    with pytest.raises(HomeNotFound):
        board.home()


def test_a_replugged_board_is_found_again(board: LaserBoard, bus: ChipBus, chip: Chip) -> None:
    board.ensure_ready()
    board.laser_on()
    chip.unplug()
    assert not chip.world.lit
    chip.run(0.2)
    chip.replug()
    bus.await_device()
    assert not board.ensure_ready().faults
    assert board.laser_on().laser_sensed


def test_a_second_host_is_refused(board: LaserBoard, bus: ChipBus) -> None:
    with pytest.raises(BoardInUse), LaserBoard(BoardConfig(handle_signals=False), backend=EmulatedBackend(bus)):
        pass


def test_the_motor_never_outruns_its_ramp(board: LaserBoard, chip: Chip) -> None:
    """No step comes sooner than constant acceleration from either end allows; the whole takes at most 10 % longer."""
    board.home()
    begun_at = len(chip.world.steps)
    board.go_to_step(1400)
    times = [time / 1e9 for time, _ in chip.world.steps[begun_at:]]
    intervals = [after - before for before, after in zip(times, times[1:], strict=False)]
    start, top, acceleration = 4074, 14260, 4_074_000
    from_start = [min(top, math.sqrt(start**2 + 2 * acceleration * (step + 1))) for step in range(len(intervals))]
    allowed = [1 / min(pair) for pair in zip(from_start, reversed(from_start), strict=True)]
    # The timer counts microseconds.
    assert all(took >= due - 2e-6 for took, due in zip(intervals, allowed, strict=True))
    assert sum(intervals) <= 1.1 * sum(allowed)

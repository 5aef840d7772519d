"""First power-up of the emulated board: every step, every fault, every wrong answer."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from drivers import LaserBoard, timing
from drivers.board.protocol import Request
from drivers.emulator import EmulatedClock
from guara_perception.app.bring_up import RECORD, bring_up
from guara_perception.app.main import run
from guara_perception.exceptions import InvalidInput
from testbed.bench_board import BenchBoard, Fault, FaultKind, bench_backend

Deed = Callable[[BenchBoard], object]


def inject(kind: FaultKind, **more: object) -> Deed:
    return lambda board: board.inject(Fault(kind, **more))  # type: ignore[arg-type]


def cut_while_lit(board: BenchBoard) -> None:
    """Make the light fail at the third command that follows."""
    serve, count = board.serve, iter(range(100))

    def watched(request: int, argument: int) -> bytes | None:
        if request == Request.LASER and next(count) == 3:
            board.inject(Fault(FaultKind.LASER_STUCK_OFF))
        return serve(request, argument)

    board.serve = watched  # type: ignore[method-assign]


# Answers of a careful operator.
DEEDS: dict[str, Deed] = {
    "Leave D3": inject(FaultKind.LASER_STUCK_OFF),
    "Connect D3": lambda board: board.mend(),
    "Bridge Q4": inject(FaultKind.LASER_STUCK_ON),
    "Remove the bridge": lambda board: board.mend(),
    "Get ready to hold RUN": inject(FaultKind.UNPLUG, request=Request.LASER, skip=3),
    "Release RUN": lambda board: board.replug(),
    "Get ready to pull": cut_while_lit,
    "Put the wire": lambda board: board.mend(),
    "Get ready to open": cut_while_lit,
    "Close SW1": lambda board: board.mend(),
}


HOT = Fault(FaultKind.HOT, amount=70)


class Bench:
    """Emulated board, and an operator who follows the instructions except where a test differs."""

    def __init__(self, folder: Path) -> None:
        self.board, self.folder = BenchBoard(), folder
        self.said: list[str] = []

    def run(self, deeds: dict[str, Deed] | None = None, **answers: str) -> bool:
        """Run the procedure; `answers` has replies by the first word of the question."""
        todo = DEEDS | (deeds or {})

        def ask(question: str) -> str:
            for beginning, deed in todo.items():
                if question.startswith(beginning):
                    deed(self.board)
            for word, answer in answers.items():
                if question.startswith(word):
                    return answer
            return "led" if question.startswith("What") else "done" if question.endswith("[done]") else "yes"

        device = LaserBoard(backend=bench_backend(self.board))
        return bring_up(device, self.folder, ask, self.said.append)

    @property
    def passed(self) -> list[str]:
        return list(json.loads((self.folder / RECORD).read_text())["passed"])


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    with timing.on_clock(EmulatedClock()):
        yield Bench(tmp_path)


def test_a_sound_board_passes_all_steps_and_then_a_laser(bench: Bench) -> None:
    """The LED first; with the laser, the steps that turn the light off are repeated."""
    assert bench.run(), bench.said
    assert bench.passed == ["2", "3", "4", "5", "6", "7"]
    assert any("dark at most 0.46 s after the last command" in line for line in bench.said)
    bench.said.clear()
    assert bench.run(What="laser"), bench.said
    assert [line.split(":")[0] for line in bench.said[:-1]] == [f"ok    step {step}" for step in "2356"]
    assert "below 1 mW" in bench.said[-1]
    assert not bench.board.view().laser_on


def test_a_laser_is_refused_before_an_led_went_dark(bench: Bench) -> None:
    """No step passed; one of two; and another board: the laser is never lit."""
    with pytest.raises(InvalidInput, match="has not passed steps 5 and 6"):
        bench.run(What="laser")
    (bench.folder / RECORD).write_text(json.dumps({"serial": "EMU0001", "passed": ["2", "5"]}))
    with pytest.raises(InvalidInput, match="has not passed step 6"):
        bench.run(What="laser")
    (bench.folder / RECORD).write_text(json.dumps({"serial": "OTHER", "passed": ["5", "6"]}))
    with pytest.raises(InvalidInput, match="5 and 6"):
        bench.run(What="laser")
    (bench.folder / RECORD).write_text("{")
    with pytest.raises(InvalidInput, match="is not a record of a first power-up: remove it"):
        bench.run(What="laser")
    assert not bench.board.view().laser_on


@pytest.mark.parametrize(
    ("deeds", "said", "passed"),
    [
        ({"Leave D3": lambda board: None}, "senses light without a photodiode", "23"),
        ({"Connect D3": lambda board: None}, "no light: close SW1", "234"),
        ({"Bridge Q4": lambda board: None}, "did not detect the stuck light", "234"),
        ({"Remove the bridge": lambda board: None}, "Without the bridge, the board still reports", "234"),
        (
            {"Get ready to hold RUN": lambda board: None},
            "Unplug the board. The light stayed on: either you did not hold",
            "2345",
        ),
        ({"Get ready to hold RUN": cut_while_lit}, "the board still answers: hold RUN", "2345"),
        ({"Release RUN": lambda board: None}, "laser board", "2345"),
        ({"Get ready to pull": lambda board: None}, "check C4, RV1", "2345"),
        ({"Get ready to pull": DEEDS["Get ready to hold RUN"]}, "expected the light to go", "2345"),
        ({"Get ready to open": lambda board: None}, "SW1 is not in the laser's circuit", "2345"),
        ({"Connect the motor": inject(FaultKind.NO_HOME_SWITCH)}, "swap one coil's wires", "23456"),
        (
            {"Connect the motor": inject(FaultKind.LOST_STEP, request=Request.GO_TO, skip=2, amount=7)},
            "lost steps (",
            "23456",
        ),
        ({"Connect D3": lambda board: (board.mend(), board.inject(HOT))}, "the board is too hot", "234"),
    ],
)
def test_faults_end_the_first_power_with_a_remedy(bench: Bench, deeds: dict[str, Deed], said: str, passed: str) -> None:
    """The board is dark afterwards, and steps before the fault stay passed."""
    assert not bench.run(deeds)
    assert bench.said[-1].startswith("FAIL") and said in bench.said[-1], bench.said[-1]
    assert "".join(bench.passed) == passed
    timing.sleep(0.01)  # the photodiode is waited for
    assert not bench.board.view().laser_on


@pytest.mark.parametrize(
    ("question", "said"),
    [
        ("Is it dark, and", "Q1 conducts without heartbeats"),
        ("Did it light", "light that you do not see"),
        ("Is it dark now", "Open SW1. SUPPLY is low, but Q1 still conducts"),
        ("Did it go dark", "LASER and SUPPLY do not go low during a reset"),
    ],
)
def test_what_only_eyes_see_ends_it_too(bench: Bench, question: str, said: str) -> None:
    """The operator's "no" overrides the board's report."""
    assert not bench.run(**{question: "no"})
    assert said in bench.said[-1]


def test_a_step_that_fails_later_takes_the_laser_away(bench: Bench) -> None:
    """A step that passed once and then fails excludes the laser again."""
    assert bench.run()
    assert not bench.run({"Bridge Q4": lambda board: None}, What="laser")
    assert bench.passed == ["2", "3", "4", "6", "7"]
    bench.board.mend()
    with pytest.raises(InvalidInput, match="has not passed step 5 "):
        bench.run(What="laser")


def test_wrong_answers_are_told_and_end_it(bench: Bench) -> None:
    with pytest.raises(InvalidInput, match="allowed: led, laser"):
        bench.run(What="lamp")
    assert bench.said == ["the answer is 'lamp', allowed: led, laser"] * 3


def test_the_board_of_another_maker_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="not for str"):
        bring_up("no board", tmp_path, str, print)


def test_without_a_board_the_command_fails_with_the_remedy(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("click.prompt", lambda question: "led")
    assert run(["doctor", "--bring-up"]) == 1
    assert "cable" in capsys.readouterr().out

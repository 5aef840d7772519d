"""Detection of motion during a pause with noisy joints: still pauses withdrawn and motions missed.

`python -m benchmarks.stillness [--pauses 1000]`. Joints have a bias of 0.2 degrees, white noise and an encoder's step.
Go2 is made from its stock URDF (extra `robots-test`). Some three minutes on two free cores; motions with HOLD have a
third of the pauses.
"""

from __future__ import annotations

import itertools
import math
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.command import Table, options
from guara_perception.app.robot_folder.new_robot import new_robot
from guara_perception.simulation.specimen import rotation
from guara_perception.simulation.sway import joints_of
from kinematics import Stance, Stillness, load_robot
from testbed.moved_mount import moved_about
from testbed.stock_robots import StockRobotsMissing, stock_urdf

Float = npt.NDArray[np.float64]

PAUSE_S, RATE_HZ, PULSE_S = 2.0, 50.0, (0.2, 0.5)
BIAS, WHITE = math.radians(0.2), math.radians(0.05)
# Name of an encoder -> white noise and step [rad].
ENCODERS = {
    "no step, 0.05": (WHITE, 0.0),
    "12 bits, 0.05": (WHITE, math.tau / 2**12),
    "14 bits, 0.05": (WHITE, math.tau / 2**14),
    "12 bits, 0": (0.0, math.tau / 2**12),
    "14 bits, 0": (0.0, math.tau / 2**14),
}
# With or without HOLD, kind of motion, and its size [m, rad].
HOLD_SIZES, END_SIZES = (1.0e-3, math.radians(0.1)), (1.5e-3, math.radians(0.15))
CASES = [
    (True, "none", (0.0, 0.0)),
    *((True, shape, HOLD_SIZES) for shape in ("step", "ramp", "pulse")),
    (False, "none", (0.0, 0.0)),
    *((False, shape, END_SIZES) for shape in ("step", "ramp")),
]


def shape_over_time(shape: str, times: Float, rng: np.random.Generator) -> Float:
    """Share of a motion at each reading, begun at a random instant; a step or ramp is still there at the end."""
    end = float(times[-1])
    if shape == "pulse":
        length = rng.uniform(*PULSE_S)
        start = rng.uniform(0.0, end - length)
        return np.asarray((times > start) & (times <= start + length), dtype=np.float64)
    start = rng.uniform(0.0, end)
    if shape == "ramp":
        return np.clip((times - start) / (end - start), 0.0, 1.0)
    return np.asarray(times > start, dtype=np.float64)


def row(source: Path | str, encoder: str, case: int, pauses: int) -> tuple[str, int, float, float, str]:
    """Simulate the pauses of one case.

    Returns:
        Description of the case; number of pauses; share of them that `Stillness` reports as moved; processor time of
        one reading, median [us]; motions that `Stillness` cannot detect, by its own account at the last pause.
    """
    robot = load_robot(source)
    rng, camera = np.random.default_rng([case, list(ENCODERS).index(encoder)]), robot.transform_camera_to_base[:3, 3]
    still = joints_of(robot, np.eye(4))
    with_hold, shape, sizes = CASES[case]
    white, step = ENCODERS[encoder]
    if with_hold and shape != "none":
        pauses = max(pauses // 3, 1)
    times = np.arange(0.0, PAUSE_S + 0.5 / RATE_HZ, 1.0 / RATE_HZ) if with_hold else np.array([0.0, PAUSE_S])
    moved, spent, stillness = 0, [], None
    for _ in range(pauses):
        readings = np.tile(still + rng.normal(0.0, BIAS, len(still)), (len(times), 1))
        if shape != "none":
            direction, (shift, turn) = rng.normal(size=3), sizes * np.eye(2)[rng.integers(2)]
            direction /= np.linalg.norm(direction)
            moved_body = moved_about(rotation(turn * direction), camera, shift * direction)
            # A motion is a thousandth of a leg: joints change in proportion.
            readings += np.outer(shape_over_time(shape, times, rng), joints_of(robot, moved_body) - still)
        readings = readings + white * rng.standard_normal(readings.shape)
        if step:
            readings = step * np.round(readings / step)
        stances = [Stance(dict(zip(robot.tree.joint_names, at.tolist(), strict=True)), robot.legs) for at in readings]
        stillness = Stillness(robot, stances[0], 0.0)
        start, taken = time.thread_time(), 0
        while taken + 1 < len(times) and not stillness.motion:
            taken += 1
            stillness.add(float(times[taken]), stances[taken])
        spent.append((time.thread_time() - start) / taken)
        moved += bool(stillness.motion)
    assert stillness is not None
    said = "" if stillness.motion else stillness.undetectable
    kind = "HOLD 50 Hz" if with_hold else "no HOLD"
    size = "" if shape == "none" else f" {1e3 * sizes[0]:g} mm or {math.degrees(sizes[1]):.2f} deg"
    text = f"{robot.name:<6} {encoder:<14} {kind:<11} {shape + size}"
    return text, pauses, moved / pauses, 1e6 * float(np.median(spent)), said


def main() -> None:
    """Print the table; exit 1 when a figure falls short."""
    asked = options(__doc__, pauses=(1000, "pauses of a row"))
    short, said = 0, set()
    with tempfile.TemporaryDirectory() as folder, ProcessPoolExecutor() as pool:
        sources: list[Path | str] = ["guara"]
        try:
            new_robot(stock_urdf("go2"), Path(folder) / "go2")
            sources.append(Path(folder) / "go2")
        except StockRobotsMissing as error:
            print(f"without Go2: {error}")
        kinds = itertools.product(sources, ENCODERS, range(len(CASES)))
        waiting = [(case, pool.submit(row, source, encoder, case, asked.pauses)) for source, encoder, case in kinds]
        table = Table("robot, encoder (noise [deg]), readings, motion:<69 | pauses:6d | moved:8.1%| us a reading:6.0f")
        for case, future in waiting:
            text, pauses, moved, microseconds, undetectable = future.result()
            short += moved > 0.01 if CASES[case][1] == "none" else moved < 0.95
            said |= {undetectable} - {""}
            table.row(text, pauses, moved, microseconds)
    print(
        f"share reported as moved; allowed: at most 1 % of still pauses, at least 95 % of motions; {short} fall SHORT"
    )
    print("said without HOLD:", min(said, default="nothing"))
    raise SystemExit(1 if short else 0)


if __name__ == "__main__":
    main()

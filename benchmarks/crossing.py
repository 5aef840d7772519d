"""Crossings of a Go2 or a Guará in MuJoCo: success by what the robot sees, and distance of its soles from edges.

Courses are fixed by kind and seed. A kind that the blind robot crosses in more than 30 % is reported but needs no
sight. With --json the last line is the list of all walks. Needs the extras `sim` and `robots-test`.
"""

from __future__ import annotations

import json
from collections.abc import Sequence

import cv2
import numpy as np

from benchmarks.command import Table, options
from testbed.crossing.courses import KINDS
from testbed.crossing.walk import ARMS, Crossing, cross
from testbed.physics.guara import ROBOTS

# Above this share of walks that the blind robot crosses, a kind of ground needs no sight.
NEEDS_NO_SIGHT = 0.30


def main() -> None:
    """Command line."""
    asked = options(
        __doc__,
        courses=(2, "courses of each kind, seeds 0 ... N - 1"),
        first=(0, "first seed"),
        kinds=([*KINDS], "kinds of ground"),
        arms=([*ARMS], "what is known of the ground"),
        robot=("go2", "robot that walks", {"choices": ROBOTS}),
        stiff=(False, "the worse robot, moved by position servos"),
        json=(False, "all walks as JSON in the last line"),
    )
    cv2.setNumThreads(1)
    done = []
    for seed in range(asked.first, asked.first + asked.courses):
        for kind in asked.kinds:
            for arm in asked.arms:
                done.append(cross(kind, seed, arm, robot=asked.robot, is_stiff=asked.stiff))
                print(_line(done[-1]), flush=True)
    table(done)
    if asked.json:
        print(json.dumps([each.to_json() for each in done]))


def table(done: Sequence[Crossing]) -> None:
    """Walks by arm and kind of ground, then the crossings by laser where sight is needed."""
    rows = Table(
        "ground:<10 | arm:<12 | crossed:7d | stopped:7d | fell:4d | by the ground:13d | targets over a gap:18d | "
        "nearest edge mm:15.0f | badly supported:15d | standing s:10.1f | cpu s:5.0f",
        markdown=True,
    )
    for kind in dict.fromkeys(each.course for each in done):
        for arm in dict.fromkeys(each.arm for each in done):
            walks = [each for each in done if (each.course, each.arm) == (kind, arm)]
            ends = [sum(each.result == end for each in walks) for end in ("crossed", "stopped", "fell")]
            sums = [sum(each.fell_by_ground for each in walks), sum(each.targets_over_gap for each in walks)]
            worst, bad = min(each.worst_edge_m for each in walks), sum(each.soles_badly_supported for each in walks)
            means = np.mean([(each.standing_s, each.cpu_s) for each in walks], axis=0)
            rows.row(kind, arm, *ends, *sums, 1e3 * worst, bad, *means)
    blind = {kind: crossed(done, kind, "blind") for kind in KINDS}
    needy = [kind for kind, (share, walks) in blind.items() if walks and share <= NEEDS_NO_SIGHT * walks]
    laser, knowing = (sum(crossed(done, kind, arm)[0] for kind in needy) for arm in ("laser", "all_knowing"))
    print(f"where sight is needed ({', '.join(needy) or 'nowhere'}): laser crossed {laser}, all-knowing {knowing}")


def crossed(done: Sequence[Crossing], kind: str, arm: str) -> tuple[int, int]:
    """Walks that crossed, and all walks, of an arm over a kind of ground."""
    walks = [each.result == "crossed" for each in done if (each.course, each.arm) == (kind, arm)]
    return sum(walks), len(walks)


def _line(walk: Crossing) -> str:
    """One walk; for a fall also its last swings: leg, target x and y, distance from an edge, support."""
    text = f"{walk.course} {walk.seed} {walk.arm}: {walk.result} after {walk.steps} steps {walk.why}".rstrip()
    return f"{text}; {walk.trace}" if walk.result == "fell" else text


if __name__ == "__main__":
    main()

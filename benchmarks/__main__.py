"""`python -m benchmarks` lists the programs; `python -m benchmarks NAME ...` runs one, as `benchmarks.NAME` does."""

from __future__ import annotations

import importlib
import sys

# Name of each program and what it prints; parts of a program are named first.
PROGRAMS = {
    "all": "speed and accuracy beside what a user would pick instead (make bench)",
    "accuracy": "errors of recorded scans against their truth, also in the paper's own terms",
    "calibration": "errors, drift, crosses, mount, truth: calibrations against the truth, and what harms them",
    "crossing": "a Go2 in MuJoCo crosses trenches, stones, stairs by what it sees (extras sim, robots-test)",
    "endurance": "hours of a recording node, planners and a viewer with faults at random: memory, handles, threads",
    "journal": "killed, carried: walks that go on after a restart, and robots that were carried meanwhile",
    "joints": "joints that read wrong: jumps and zeros that are told, alarms on clean walks (extra robots-test)",
    "light": "effects, cost, scans, twins, mosaics: real light and Bayer mosaics through the chain, beside the truth",
    "node": "a running node: sweep, latency, processor time",
    "passive": "stereo and optical flow by OpenCV beside the laser, on the same simulated scene",
    "pauses": "scans confirmed of 20 pauses by announced time, HOLD and lateness of END; a robot that moves",
    "photographs": "stripes on photographs of real laser lines beside peers",
    "record_restarts": "nodes that record, killed again and again: how many come up, which files open",
    "restarts": "grids handed out against the truth, over restarts of node, router and links",
    "scan_cost": "processor time of a scan on this checkout beside another, and by path of its stripes",
    "size": "code lines, modules, words, commands, options and names of the project; the way of a frame to bytes",
    "soak": "nodes and planners killed for minutes, and what was lost",
    "stillness": "still pauses withdrawn and motions missed by noisy joints (extra robots-test)",
    "strange_light": "light that is not ours, frames of another instant, two robots: free cells that are wrong",
    "sway": "heights of a body that sways while it is scanned, with a stream of its joints and without",
    "sweeps": "triggered and free-running sweeps against the bound of the motion, and faults of the trigger",
    "transport": "viewers, announcements, fleet, compact: slow links, floods, many robots, encodings",
    "usable_ground": "ground that a planner may use and bounds of unknown ground, beside the truth",
    "walks": "drift, cost, modes: maps of walks beside the true ground, what they cost, coarse scans refined",
}


def main() -> None:
    """Command line."""
    name = sys.argv[1] if len(sys.argv) > 1 else "--help"
    if name in ("-h", "--help"):
        print("\n".join(f"{program:<14} {prints}" for program, prints in PROGRAMS.items()))
        return
    if name not in PROGRAMS:
        sys.exit(f"benchmarks: no program {name!r}; allowed: {', '.join(PROGRAMS)}")
    del sys.argv[1]
    sys.argv[0] = f"benchmarks {name}"
    importlib.import_module(f"benchmarks.{name}").main()


if __name__ == "__main__":
    main()

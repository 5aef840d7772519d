"""Why a foot should not go there: the hazard flags of a cell, values that never change."""

from __future__ import annotations

from enum import IntFlag

import numpy as np

from guara_perception.arrays import Flags


class Hazard(IntFlag):
    """Flags of one cell. The lower byte says why a cell is unknown, the upper why a known cell is bad.

    Unknown: DROPOUT, the laser should have returned here and did not; OCCLUDED, hidden by something nearer; UNSCANNED,
    not looked at; OUT_OF_RANGE, below or above the heights that count as terrain; AMBIGUOUS, a return that may not be
    trusted; SELF, hidden by the robot itself.
    Known but bad: STEEP, STEP, DROP and ROUGH ground; EDGE, a sole centred here would reach something unknown, bad
    or off the grid; UNCERTAIN, height known too poorly; CONFLICT, looks disagree; STALE, seen too long ago.
    """

    NONE = 0
    DROPOUT = 1
    OCCLUDED = 2
    UNSCANNED = 4
    OUT_OF_RANGE = 8
    AMBIGUOUS = 16
    SELF = 32
    STEEP = 256
    STEP = 512
    DROP = 1024
    ROUGH = 2048
    EDGE = 4096
    UNCERTAIN = 8192
    CONFLICT = 16384
    STALE = 32768

    def __str__(self) -> str:
        """Names, for people: "EDGE|STEP"; a number says nothing."""
        return self.name or str(int(self))


UNKNOWN_MASK = np.uint16(0x00FF)
ALL_BUT_EDGE = np.uint16(0xFFFF & ~Hazard.EDGE)

MEANING = {
    Hazard.DROPOUT: "the laser should have returned here and did not: dark, absorbing or a hole",
    Hazard.OCCLUDED: "hidden from camera or laser by something nearer",
    Hazard.UNSCANNED: "not looked at: out of view, stripe not fired or frame missing",
    Hazard.OUT_OF_RANGE: "below or above the heights that count as terrain",
    Hazard.AMBIGUOUS: "a return that may not be trusted: two stripes, saturation or a mixed edge",
    Hazard.SELF: "hidden by the robot's own leg or body",
    Hazard.STEEP: "too steep",
    Hazard.STEP: "rises too much nearby",
    Hazard.DROP: "falls too much nearby",
    Hazard.ROUGH: "too rough",
    Hazard.EDGE: "a sole here would reach something unknown, hazardous or off the grid",
    Hazard.UNCERTAIN: "height known too poorly",
    Hazard.CONFLICT: "looks disagree",
    Hazard.STALE: "seen too long ago",
}


def names(flags: int | Hazard) -> list[str]:
    """Names of the flags that are set, lowest first."""
    return [flag.name for flag in Hazard if flag and flag & Hazard(int(flags)) and flag.name]


def cells_by_flag(hazard: Flags) -> dict[str, int]:
    """Name of each flag -> number of cells of a grid that carry it."""
    # Few of all combinations occur in one grid.
    cells = np.bincount(hazard.ravel())
    combinations = np.flatnonzero(cells)
    return {
        flag.name: int(cells[combinations[(combinations & int(flag)) != 0]].sum())
        for flag in Hazard
        if flag and flag.name
    }

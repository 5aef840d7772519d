"""Writes the README of a proposed robot: where its values come from, and what is to be measured."""

from __future__ import annotations

from guara_perception.app.robot_folder.propose import Proposal, kind_of
from guara_perception.app.robot_folder.toml_text import assumed, camera_height


def readme_text(proposal: Proposal, source: str, notes: tuple[str, ...]) -> str:
    """The text of README.md.

    Args:
        proposal: proposal of the robot.
        source: name of the URDF that it was made from.
        notes: what of that URDF is not used.
    """
    p, m = proposal, proposal.mounts
    legs = "\n".join(
        f"| `{leg.name}` | {', '.join(leg.joints)} | `{leg.hip}` | {kind_of(found.leg, found.foot)} |"
        for leg, found in zip(p.leg_configs, p.legs, strict=True)
    )
    measure = "\n".join(f"| `{key}` | {what} |" for key, what in assumed(p).items())
    unused = "\n".join(f"- {note}" for note in notes) or "- nothing"
    return f"""# {p.name}

Proposed by `guara robot new` from `{source}`. `guara robot check` says what is wrong or doubtful, and draws it.

| file | what |
|---|---|
| `urdf/{p.name}.urdf` | links, masses, joints, collision shapes of the source; frames for soles, camera, laser |
| `srdf/{p.name}.srdf` | postures `scan` and `standing`, links that touch by construction |
| `robot.toml` | everything else, each value with its reason |

Not used of the source:

{unused}

## What was found

| leg | joints | hip | kind |
|---|---|---|---|
{legs}

When it scans the hips are {p.scan.hip_height:.3f} m over the soles,
the camera {camera_height(p, p.scan):.3f} m over the floor and pitched {m.camera_pitch:.3f} rad from straight down.
It scans x {m.area_x[0]:.2f} ... {m.area_x[1]:.2f}, y {m.area_y[0]:.2f} ... {m.area_y[1]:.2f} m.

## What you must measure

These values stand in the table `[assumed]` of robot.toml. `guara run` with a real robot refuses to go on those that
concern safety until their lines are deleted there; simulation runs.

| value | how |
|---|---|
{measure}

The licence of the URDF is that of its source.
"""

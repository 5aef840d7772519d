"""Writes robot.toml of a proposed robot: every value with its reason, and which of them nobody has measured."""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil

from guara_perception.app.robot_folder.postures import FoundPosture
from guara_perception.app.robot_folder.propose import Proposal

# The wave gait's: advance of a cycle, four pauses, and the time that they take at the slowest pace with scans of 7 s.
CYCLE_M, PAUSES, CYCLE_S, SCAN_S = 0.140, 4, 18.7, 7.0
SWING_HEIGHT_M = 0.060


def assumed(proposal: Proposal) -> dict[str, str]:
    """What the robot's owner must measure before it walks on it, by the field of robot.toml."""
    legs = {
        f"legs.{leg.leg.name}.sole": "in the scan posture the frame must lie where this foot touches the floor"
        for leg in proposal.legs
    }
    return {
        "sole": "measure what of a foot rests on the ground, along and across",
        **legs,
        "frames.camera": "mount the camera, measure where it sits, and calibrate: the calibration overrides it",
        "frames.laser": "mount the mirror, measure where it sits, and calibrate: the calibration overrides it",
        "traversability.slope_limit": "find the steepest ground on which a foot holds",
        "traversability.step_limit": "half the height to which a swing lifts a foot",
        "traversability.drop_limit": "how far a foot may slip off an edge before the body tips too far",
        "traversability.roughness_limit": "the unevenness under one sole that the robot stands on",
        "heights.minimum": "how deep a foot reaches below the plane it stands on, twice",
        "heights.maximum": "twice the height to which a swing lifts a foot",
        "stance.encoder_sigma": "set each joint to a known angle, and compare with what it reads",
        "stance.encoder_noise": "read the joints of the standing robot for a minute: standard deviation of one joint",
        "stance.centre_of_mass_sigma": "weigh the robot on its feet and compare with the masses of the URDF",
    }


def toml_text(proposal: Proposal, source: str) -> str:
    """The text of robot.toml.

    Args:
        proposal: proposal of the robot.
        source: name of the URDF that it was made from.
    """
    return "\n".join(_lines(proposal, source)) + "\n"


def _lines(p: Proposal, source: str) -> Iterator[str]:
    m, scan = p.mounts, p.scan
    yield f"# {p.name}: what its URDF cannot say, made by `guara robot new` from {source}. SI units."
    yield "# The table [assumed] at the end names what nobody has measured yet; delete a line once it is measured."
    yield f'name = "{p.name}"'
    yield 'scan_posture = "scan"'
    yield f"sole = [{p.sole[0]:.3f}, {p.sole[1]:.3f}]    # length x, width y: {_sole_reason(p)}"
    yield ""
    yield "[frames]"
    yield f'base = "{p.base}"'
    yield f'camera = "{p.camera_frame}"    # OpenCV axes, image v forward; {_mount_reason(p)}'
    yield f'laser = "{p.laser_frame}"    # on the mirror\'s axis, which is parallel to y'
    for leg in p.leg_configs:
        yield ""
        yield f"[legs.{leg.name}]"
        yield f'hip = "{leg.hip}"    # of the first joint that swings the foot fore and aft'
        yield f'sole = "{leg.sole}"    # under the foot where it touches the ground in the scan posture'
        yield "joints = [" + ", ".join(f'"{joint}"' for joint in leg.joints) + "]"
    yield ""
    yield "# Heights over the plane of the soles; joint angles stand in the SRDF."
    for name, posture, why in (
        ("scan", scan, _height_reason(p)),
        ("standing", p.standing, "a little higher than the scan posture"),
    ):
        yield f"[postures.{name}]"
        yield f"hip_height = {posture.hip_height:.3f}    # {why}"
        yield f"camera_height = {camera_height(p, posture):.4f}    # follows from the camera's position on the body"
        yield ""
    yield from _noise()
    yield "[self_filter]"
    yield "margin = 0.010                 # around every collision shape: cables, joint noise"
    yield "ignore = []                    # camera and mirror stand outside all shapes"
    yield ""
    yield "[grid]"
    yield "resolution = 0.005             # below the finest stripe pitch"
    yield ""
    yield "[grid.footprint]               # from 0.20 m ahead of the front feet, 60 mm beside their tracks"
    yield f"x = [{m.area_x[0]:.2f}, {m.area_x[1]:.2f}]"
    yield f"y = [{m.area_y[0]:.2f}, {m.area_y[1]:.2f}]"
    yield ""
    hind = min(float(sole[0]) for sole in scan.soles.values())
    yield "[grid.map]                     # from 0.30 m behind the hind feet"
    yield f"x = [{round(hind - 0.30, 2):.2f}, {m.area_x[1] + 0.05:.2f}]"
    yield f"y = [{m.area_y[0] - 0.08:.2f}, {m.area_y[1] + 0.08:.2f}]"
    yield ""
    yield "[heights]"
    yield "minimum = -0.080               # twice what a foot is sure to reach below the plane it stands on"
    yield f"maximum = {2 * SWING_HEIGHT_M + 0.01:.3f}                # twice the swing height, and a little"
    yield "join_height = 0.008            # more than this between neighbouring stripes is a wall, not a slope"
    yield ""
    yield "[scan]"
    yield f"stripes = {p.stripes}                   # one every 6.4 mm of the area on average, as the paper's 70"
    yield "coarse_every = 2"
    yield f"mirror_angle_first = {p.mirror_angles[0]:.5f}  # just before the area: atan((x - x_mirror) / height) / 2"
    yield f"mirror_angle_last = {p.mirror_angles[1]:.5f}   # just past it"
    yield ""
    yield from _limits(p)
    cycles = ceil((m.area_x[1] - hind) / CYCLE_M) + 1
    yield "[validity]"
    seconds = cycles * (CYCLE_S + PAUSES * SCAN_S)
    yield f"pauses = {min(cycles * PAUSES, 255)}    # until a hind foot treads on the far end of the area"
    yield f"seconds = {seconds:.1f}    # those cycles at {CYCLE_S} s, with scans of {SCAN_S:.0f} s"
    yield ""
    yield "[assumed]                      # nobody has measured these; `guara run` refuses to rely on them"
    for key, what in assumed(p).items():
        yield f'"{key}" = "{what}"'


def camera_height(proposal: Proposal, posture: FoundPosture) -> float:
    """Height of the optical centre over the plane of the soles in a posture [m]."""
    return float(proposal.mounts.camera[2]) + posture.base_height


def _sole_reason(p: Proposal) -> str:
    foot = p.legs[0].foot
    if not foot.shapes:
        return "the URDF gives the foot no shape: a guess"
    return "all of the round foot, seen from above" if foot.is_round else "the foot's collision shape"


def _height_reason(p: Proposal) -> str:
    if p.reach >= 1.0:
        return "the highest from which the feet reach 0.13 m fore and aft, 20 mm down and 60 mm up"
    return f"from no height a foot reaches all that the gait asks; from here {p.reach:.0%}"


def _mount_reason(p: Proposal) -> str:
    return f"{p.mounts.camera_height:.2f} m over the floor; the robot hides {p.mounts.hidden:.0%} of the area"


def _noise() -> Iterator[str]:
    yield "[stance]"
    yield "encoder_sigma = 0.0035         # bias of one joint angle, 0.2 degrees"
    yield "encoder_noise = 0.001          # white noise of one reading: 0.05 degrees and a 12-bit encoder's step"
    yield "contact_sigma = 0.001          # sole against ground, per axis"
    yield "sole_pitch_sigma = 0.0035      # pitch of a loaded flat sole; without meaning for round feet"
    yield "imu_sigma = 0.00175            # direction of gravity at rest, 0.1 degrees"
    yield "level_sigma = 0.03             # body taken as level"
    yield "terrain_slope_sigma = 0.05     # support plane taken as horizontal"
    yield "centre_of_mass_sigma = 0.010   # a balance argument needs more than this"
    yield "unloaded_sigmas = 3.5          # a foot this far above the plane of the others may carry no load"
    yield ""
    yield "[pause]"
    yield "joint_speed_limit = 0.05       # rad/s"
    yield "hold_time = 0.2                # s, all joints slow for this long"
    yield "minimum_feet = 3               # a support plane needs three"
    yield "camera_translation_limit = 0.0005   # within a pause, where noise does not explain it"
    yield "camera_rotation_limit = 0.000873    # 0.05 degrees"
    yield ""
    yield "[odometry]"
    yield "slip_sigmas = 4.5              # a distance between two feet that changes by more: one moved"
    yield "turn_limit = 0.26              # the body turns by less than 15 degrees between two pauses"
    yield "swing_least = 0.035            # a foot that moved by less slipped; a swing is four times that"
    yield ""


def _limits(p: Proposal) -> Iterator[str]:
    height = p.scan.hip_height
    # The body tips by 3 degrees when a foot falls this far.
    drop = min(round(0.055 * height, 3), 0.020)
    half = min(p.sole) / 2.0
    yield "[traversability]"
    yield "slope_limit = 0.35             # 20 degrees: tan 0.36, friction 0.6 leaves a factor of 1.6"
    swing = f"{1e3 * SWING_HEIGHT_M:.0f} mm"
    yield f"step_limit = {SWING_HEIGHT_M / 2:.3f}    # half the swing height of {swing}: the other half is clearance"
    yield f"drop_limit = {drop:.3f}    # a foot that slips off: 3 degrees of tilt, 20 mm at most"
    yield "roughness_limit = 0.0035       # a stone of 17 mm in the disc"
    yield "sigma_limit = 0.005            # a sixth of the step limit of 30 mm"
    yield f"disc_radius = {max(0.015, round(half, 3)):.3f}            # half the sole's width, and three cells at least"
    yield "confidence = 2.0               # sigmas added to every value before it is compared with its limit"
    yield ""

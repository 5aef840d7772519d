"""Planar drift correction: a Kalman filter on (x, y, yaw) of the walk, fed by registration and ground texture.

The odometry pose of a pause has two errors: drift, which persists, and noise, which affects this pause only. Let P be
the covariance of the drift and W that of the noise. Registration observes their sum: it moves the pause by m and
reduces P + W to C. The drift is then corrected by K m, and its covariance is updated to

    P - K (P + W - C) K',        K = P (P + W)^-1.

Without W all of m would count as drift: the noise of one pause, which is larger than the drift of one motion, would
move all later pauses. The map's record contains the correction and its sigmas.

Ground that moves drags the registered poses along, a little at each pause. The sum of the corrections is therefore
compared with the accumulated drift of odometry (`OdometrySum`). If they contradict each other, registrations at the
following pauses are not used. Unless texture confirms the corrections, they are undone and added to the drift of all
cells.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from guara_perception.arrays import Float, Index
from guara_perception.exceptions import FileFormatError, InvalidInput
from guara_perception.fields import Fields
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.map.odom_cells import OdomCells
from guara_perception.terrain.map.odometry_sum import EARLIER_PAUSES, OdometrySum, moved, shown_slip, transition_between
from guara_perception.terrain.map.registration import OPEN_SIGMA, Registration, SeenGround, motion_between, register
from guara_perception.terrain.map.seen_texture import GroundView, SeenTexture, visual_motion
from kinematics.arrays import FrozenArrays

SIDEWAYS = [0, 1, 5]
# Least prior sigmas of height and tilt, which are nuisance parameters of the registration; the soles correct the
# height.
HEIGHT_SIGMA_M = 0.003
TILT_SIGMA = 0.001
# Lower bounds of the sigmas of a motion; they keep the covariances positive definite.
LEAST_SIGMA_M, LEAST_SIGMA_RAD = 1e-4, 3e-5
# A registered motion with a larger sigma is determined by too few objects: ribs all along the path give 0.8 to 1.2 mm,
# a single board or door mostly 2 mm or more. These few objects may be moving, so the correction is not used while the
# motions from scan to scan contradict odometry by more than SUSPICIOUS_SIGMAS.
FEW_OBJECTS_SIGMA_M = 0.0015
SUSPICIOUS_SIGMAS = 1.0
# Lever arm of yaw [m]: distance from the robot to the nearer part of the scanned area.
LEVER_M = 0.6
# Number of pauses kept. A cell last seen before the oldest of them counts as seen at that pause; it is stale anyway.
MOST_PAUSES = 256
TEXTURE_IN_DOUBT = "texture that was seen has moved"
# Path length after which the slip measured by texture has the same weight as the value of robot.toml, and path length
# after which the weight of this measurement no longer grows.
LEARNING_M, LEARNED_M = 0.3, 1.0
# Arrays in every file, and arrays that files of earlier versions lack.
STORED = ("transform", "covariance", "pause_transform", "pause_covariance", "noise", "growth")
STORED_LATER = ("own", "off_texture", "unheld", "off_way", "slip", "begun", "learned")
# File keys of the attributes that are stored under another name.
FILE_KEYS = {"pause_transform": "here", "pause_covariance": "left", "noise": "own", "own": "pause_own"}


@dataclass(frozen=True, slots=True, eq=False)
class WalkCorrection:
    """State of the planar drift filter; covariances are those of x, y and yaw.

    Attributes:
        transform: (4, 4) correction of the drift, a rotation about z and a translation in x and y; it multiplies
            transforms of odometry from the left.
        covariance: (3, 3) covariance of the drift after this correction.
        pause_transform: (4, 4) correction of the last pause only, including its noise.
        pause_covariance: (3, 3) covariance of the last pause relative to the map.
        noise: (3, 3) pose noise of the last pause, not carried to the next.
        last: transform_footprint_to_odom of the last pause from odometry, None before the first pause.
        growth: (3, 3) covariance of the last motion after registration.
        own: (3, 3) covariance of the last pause's own error if texture corrected that pause, otherwise zero.
        shift, turn: sums of the largest horizontal variance and of the yaw variance of all motions since the start
            [m^2, rad^2].
        refused: reason why the last registration was not used, None if it was used or there was none yet.
        sum: corrections since earlier pauses, and the drift of odometry accumulated since the same pauses.
        distrusted: number of future pauses whose registration is not used.
        unheld: (2,) displacement since texture last corrected the walk [m].
        off_texture: (3, 3) covariance of the pose relative to the texture, due to motions since texture last corrected
            the walk or a new reference texture was taken.
        off_way: (2,) displacement since texture last corrected the walk or a new reference texture was taken [m].
        unseen: number of future pauses whose texture is not used, because the ground in view may be moving.
        slip: (2,) sigma of the displacement by slip since the start [m], without the part that texture corrected. Slip
            is assumed to act along the path, always with the same sign.
        begun: (2,) `slip` at the pause at which the reference texture was taken [m].
        learned: (2,) slip along the path measured by texture, and length of that path [m].
        is_denied: True if odometry contradicted the texture at the last pause, so that a new reference texture is
            taken.
        corners: as in `VisualMotion`, for the last pause; None at the first pause and for a walk without images.
        visual_refused: reason why texture did not correct the last pause; None if it did, at the first pause, and for a
            walk without images.
        displaced: as in `Registration`, for the last pause.
    """

    transform: Float = field(default_factory=partial(np.eye, 4))
    covariance: Float = field(default_factory=partial(np.zeros, (3, 3)))
    pause_transform: Float = field(default_factory=partial(np.eye, 4))
    pause_covariance: Float = field(default_factory=partial(np.zeros, (3, 3)))
    noise: Float = field(default_factory=partial(np.zeros, (3, 3)))
    last: Float | None = None
    growth: Float = field(default_factory=partial(np.zeros, (3, 3)))
    own: Float = field(default_factory=partial(np.zeros, (3, 3)))
    shift: float = 0.0
    turn: float = 0.0
    refused: str | None = None
    sum: OdometrySum = field(default_factory=OdometrySum)
    distrusted: int = 0
    unheld: Float = field(default_factory=partial(np.zeros, 2))
    off_texture: Float = field(default_factory=partial(np.zeros, (3, 3)))
    off_way: Float = field(default_factory=partial(np.zeros, 2))
    unseen: int = 0
    is_denied: bool = False
    slip: Float = field(default_factory=partial(np.zeros, 2))
    begun: Float = field(default_factory=partial(np.zeros, 2))
    learned: Float = field(default_factory=partial(np.zeros, 2))
    corners: int | None = None
    visual_refused: str | None = None
    displaced: Float = field(default_factory=partial(np.empty, (0, 2)))

    def check_kind(self, scans: int, *, is_registered: bool, step: int) -> None:
        """Refuse a pause with covariance_since_last after pauses without it, or vice versa.

        The drift in between would be unknown.

        Raises:
            InvalidInput: covariance_since_last is given now but was not given before, or vice versa.
        """
        if not scans or is_registered == (self.last is not None):
            return
        now, before = ("given", "not given") if is_registered else ("not given", "given")
        raise InvalidInput(
            f"covariance_since_last is {now} at step {step} and was {before} at earlier pauses: give it at every "
            "pause of a walk or at none"
        )

    @staticmethod
    def of_fields(fields: Fields) -> WalkCorrection:
        """Read the state from a file.

        Raises:
            FileFormatError: a value is missing or impossible.
        """
        start = WalkCorrection()
        keys = {name: FILE_KEYS.get(name, name) for name in (*STORED, *STORED_LATER)}
        found = [name for name, key in keys.items() if name in STORED or fields.has(key)]
        kept: dict[str, Any] = {name: fields.array(keys[name], getattr(start, name).shape) for name in found}
        kept |= {name: fields.integer(name, 0, EARLIER_PAUSES) for name in ("distrusted", "unseen") if fields.has(name)}
        kept |= {name: fields.text(name) for name in ("refused", "visual_refused") if fields.has(name)}
        return WalkCorrection(
            **kept,
            last=fields.array("last", (4, 4)) if fields.has("last") else None,
            shift=fields.number("shift", 0.0),
            turn=fields.number("turn", 0.0),
            sum=OdometrySum.of_fields(fields.sub("sum")) if fields.has("sum") else start.sum,
            corners=fields.integer("corners", 0) if fields.has("corners") else None,
        )

    def after(
        self,
        cells: OdomCells,
        terrain: TerrainGrid,
        odometry: Float,
        rise: float,
        since_last: Float,
        noise: Float,
        tilt: Float,
        before_this: SeenGround | None,
        slip_share: float,
        view: GroundView | str | None,
        texture: SeenTexture | None,
    ) -> WalkCorrection:
        """Predict the drift at the next pause, and update it with the image and the registered scan of that pause.

        Args:
            cells: memory of the map.
            terrain: scan of the pause.
            odometry: (4, 4) transform_footprint_to_odom from odometry.
            rise: correction of the z of odometry [m].
            since_last: (6, 6) covariance of the motion since the last pause, in the last footprint.
            noise: (6, 6) pose noise of the pause, along the axes of odom.
            tilt: (2, 2) covariance of the scan's tilt.
            before_this: ground measured by the previous scan, None if unknown.
            slip_share: sigma of slip along the path, relative to the length of the path.
            view: view of the scan's image, the reason why the scan has no image, or None for a walk without images.
            texture: texture from earlier images.
        """
        if self.last is None:
            # The map begins at the pose of the first pause, so earlier motion adds no drift.
            sums = self.sum.started(self.transform, odometry, self.covariance, self.noise)
            return replace(self, last=odometry.copy(), sum=sums)
        here, before = self.transform @ odometry, self.transform @ self.last
        motion = covariance_in_odom(before, since_last)
        transition = transition_between(before, here)
        growth = motion[np.ix_(SIDEWAYS, SIDEWAYS)] + np.diag([LEAST_SIGMA_M**2] * 2 + [LEAST_SIGMA_RAD**2])
        turned = self.transform[:3, :3]
        noise = turned @ noise[np.ix_(SIDEWAYS, SIDEWAYS)] @ turned.T
        noise_before = transition @ self.noise @ transition.T
        added = _without(growth, noise_before + noise)
        drift = transition @ self.covariance @ transition.T + added
        way = here[:2, 3] - before[:2, 3]
        unheld, off_way = self.unheld + way, self.off_way + way
        share = float(np.hypot(slip_share * LEARNING_M, self.learned[0]) / np.hypot(LEARNING_M, self.learned[1]))
        if view is not None:
            slipped = _slip_growth(self.unheld, unheld, share)
            drift = drift + slipped
        predicted = drift + noise
        prior = np.diag([0.0, 0.0, motion[2, 2] + HEIGHT_SIGMA_M**2, TILT_SIGMA**2, TILT_SIGMA**2, 0.0])
        prior[3:5, 3:5] += tilt
        prior[np.ix_(SIDEWAYS, SIDEWAYS)] = predicted
        seen, seen_covariance = np.zeros(3), OPEN_SIGMA**2 * np.eye(3)
        if before_this is not None:
            seen, seen_covariance = motion_between(before_this, terrain, np.linalg.inv(self.last) @ odometry, 2 * prior)
            seen, seen_covariance = before[:3, :3] @ seen, before[:3, :3] @ seen_covariance @ before[:3, :3].T
        here[2, 3] += rise
        visual, visual_refused, by_odometry, off_texture = None, None, here, np.zeros((3, 3))
        if view is not None:
            off_texture = transition @ self.off_texture @ transition.T + added + slipped
            view = TEXTURE_IN_DOUBT if self.unseen else view
            visual = visual_motion(view, texture, here, prior, off_texture + noise, shown_slip(off_way))
            here, prior, visual_refused = moved(visual.motion, here) @ here, visual.covariance, visual.refused
            # Either the feet slid or the ground moved, so this contradiction adds to the uncertainty of the pose.
            doubt = np.outer(visual.denied, visual.denied)
            growth, drift, predicted = growth + doubt, drift + doubt, predicted + doubt
            prior[np.ix_(SIDEWAYS, SIDEWAYS)] += doubt
            if not visual_refused:
                unheld, off_way, off_texture = np.zeros(2), np.zeros(2), np.zeros((3, 3))
        shown = float(np.linalg.norm(here[:2, 3] - before[:2, 3])) if visual is not None and visual.is_whole else 0.0
        earlier = self.sum.grown(transition, added, seen, seen_covariance, shown)
        if self.distrusted:
            found = Registration(np.zeros(6), prior, 0, self.refused)
        else:
            found = register(cells, terrain, here, prior)
            suspicion = earlier.suspicion(odometry, noise, slip_share)
            if suspicion > SUSPICIOUS_SIGMAS and _shown_sigma(prior, found.covariance) > FEW_OBJECTS_SIGMA_M:
                reason = f"few objects show the motion, and they contradict odometry by {suspicion:.1f} sigma"
                found = Registration(np.zeros(6), prior, found.cells, found.refused or reason, found.displaced)
        motion = found.motion[SIDEWAYS] + (0.0 if visual is None else visual.motion)
        posterior = found.covariance[np.ix_(SIDEWAYS, SIDEWAYS)]
        kept, own, slip = kept_growth(growth, predicted, posterior), np.zeros((3, 3)), self.slip
        if visual is not None and visual_refused is None:
            kept, own, slip = visual.inherited * posterior, posterior, self.begun
        elif visual is not None:
            # Only the part of the slip that heights did not correct is added.
            along = np.append(way, 0.0)
            left = np.sqrt((along @ posterior @ along) / max(along @ predicted @ along, 1e-30))
            slip = slip + share * left * way
        gain = np.linalg.solve(predicted, drift).T
        learned = self.learned
        if visual is not None and visual.is_whole and not visual_refused:
            walked = self.unheld + way
            length = float(np.linalg.norm(walked))
            learned = learned + (float((gain @ motion)[:2] @ walked) / max(length, LEAST_SIGMA_M), length)
            learned = learned * min(1.0, LEARNED_M / max(float(learned[1]), LEAST_SIGMA_M))
        transform = moved(gain @ motion, by_odometry) @ self.transform
        pause_transform = moved(motion, by_odometry) @ self.transform
        covariance = drift - gain @ (predicted - posterior) @ gain.T
        distrusted, unseen, refused = max(self.distrusted - 1, 0), max(self.unseen - 1, 0), found.refused
        contradiction = earlier.contradiction(transform, odometry, noise, slip_share, textured=texture is not None)
        if contradiction is not None:
            distrusted, refused = EARLIER_PAUSES, contradiction.reason
            if visual_refused and not unseen:
                # If texture is lost while relief moves, a new reference texture could lie on the moving ground. Earlier
                # corrections by texture are kept.
                unseen = EARLIER_PAUSES
                earlier = OdometrySum() if contradiction.transform is None else earlier
        if contradiction is not None and contradiction.transform is not None:
            # Ground seen in these pauses is displaced by the corrections that are undone, and by the errors of
            # odometry.
            transform = pause_transform = contradiction.transform
            covariance, unseen = contradiction.covariance, EARLIER_PAUSES
            posterior = covariance + noise
            kept, own = growth + covariance + contradiction.moved_by.T @ contradiction.moved_by, np.zeros((3, 3))
            earlier = OdometrySum()
        return WalkCorrection(
            transform=transform,
            covariance=covariance,
            pause_transform=pause_transform,
            pause_covariance=posterior,
            noise=noise,
            last=odometry.copy(),
            growth=kept,
            own=own,
            shift=self.shift + float(np.linalg.eigvalsh(kept[:2, :2])[-1]),
            turn=self.turn + float(kept[2, 2]),
            refused=refused,
            sum=earlier.started(transform, odometry, covariance, noise),
            distrusted=distrusted,
            unheld=unheld,
            off_texture=off_texture,
            off_way=off_way,
            unseen=unseen,
            slip=slip,
            begun=self.begun,
            learned=learned,
            is_denied=visual is not None and bool(visual.denied.any()),
            corners=None if visual is None else visual.corners,
            visual_refused=visual_refused,
            displaced=found.displaced,
        )


def covariance_in_odom(transform_footprint_to_odom: Float, covariance: Float) -> Float:
    """Covariance (6, 6) of a motion along the axes of odom, from that along the axes of a footprint."""
    rotation = np.kron(np.eye(2), transform_footprint_to_odom[:3, :3])
    return np.asarray(rotation @ covariance @ rotation.T)


def _slip_growth(before: Float, now: Float, slip_share: float) -> Float:
    """Covariance (3, 3) added in one motion by slip along the path, which always has the same sign.

    Args:
        before, now: (2,) displacements since texture last corrected the walk, before and after the motion [m].
        slip_share: sigma of slip relative to the displacement.
    """
    gained, directions = np.linalg.eigh(np.outer(now, now) - np.outer(before, before))
    result = np.zeros((3, 3))
    result[:2, :2] = slip_share**2 * (directions * np.maximum(gained, 0.0)) @ directions.T
    return result


def _shown_sigma(prior: Float, posterior: Float) -> float:
    """Smallest sigma [m] over all directions of (x, y, LEVER_M * yaw), from the heights without the prior."""
    scale = np.diag([1.0, 1.0, 1.0 / LEVER_M])
    before, after = (np.linalg.inv(each[np.ix_(SIDEWAYS, SIDEWAYS)]) for each in (prior, posterior))
    return float(1.0 / np.sqrt(max(float(np.linalg.eigvalsh(scale @ (after - before) @ scale)[-1]), 1e-6)))


def _without(growth: Float, noise: Float) -> Float:
    """Drift covariance (3, 3) of a motion: its covariance minus the noise of both ends, not below the least sigmas."""
    least = np.diag([LEAST_SIGMA_M, LEAST_SIGMA_M, LEAST_SIGMA_RAD])
    inverse = np.linalg.inv(least)
    variances, directions = np.linalg.eigh(inverse @ (growth - noise) @ inverse)
    root = least @ directions
    return np.asarray(root * np.maximum(variances, 1.0) @ root.T)


@dataclass(frozen=True, slots=True, eq=False)
class SidewaysDrift(FrozenArrays):
    """Covariances of the motions of a walk, accumulated pause by pause.

    Each covariance is of (x, y, yaw) about the origin of `odom`, so that a motion rotates a cell about the position of
    the robot at that time. The difference of two sums is the covariance of all motions between them.

    Attributes:
        pauses: (k,) numbers of the pauses, ascending.
        total: (k, 3, 3) sums from the start to each pause.
        own: (k, 3, 3) covariance of each pause's own error, added to the covariance of motions from or to the pause.
        slip: (k, 2) sigma of slip from the start to each pause, along x and y of odom; slip has the same sign in all
            pauses [m].
    """

    pauses: Index = field(default_factory=lambda: np.empty(0, np.int64))
    total: Float = field(default_factory=partial(np.empty, (0, 3, 3)))
    own: Float = field(default_factory=partial(np.empty, (0, 3, 3)))
    slip: Float = field(default_factory=partial(np.empty, (0, 2)))

    def after(self, pause: int, growth: Float, position: Float, own: Float, slip: Float) -> SidewaysDrift:
        """Add the motion to a pause.

        Args:
            pause: number of the pause.
            growth: (3, 3) covariance of the motion, about the robot and along the axes of odom.
            position: (2,) position of the robot in odom [m].
            own: (3, 3) covariance of the pause's own error, about the robot and along the axes of odom.
            slip: (2,) sigma of slip since the start, along the axes of odom [m].
        """
        about_origin = np.array([[1.0, 0.0, position[1]], [0.0, 1.0, -position[0]], [0.0, 0.0, 1.0]])
        added = about_origin @ growth @ about_origin.T
        last = self.total[-1] if len(self.total) else np.zeros((3, 3))
        pauses, total = np.append(self.pauses, pause), np.concatenate((self.total, (last + added)[None]))
        both = np.concatenate((self.own, (about_origin @ own @ about_origin.T)[None]))
        slips = np.concatenate((self.slip, slip[None]))
        kept = slice(-MOST_PAUSES, None)
        return SidewaysDrift(pauses[kept], total[kept], both[kept], slips[kept])

    def variances(self, seen: Index, x: Float, y: Float, transform_footprint_to_odom: Float) -> Float:
        """Variances (2, n) of the drift of cells since they were seen, along x and y of the footprint [m^2].

        Args:
            seen: (n,) pauses at which the cells were last seen.
            x, y: (n,) positions of the cells in odom [m].
            transform_footprint_to_odom: (4, 4) pose of the footprint.
        """
        if not len(self.pauses):
            return np.zeros((2, len(seen)))
        entry = np.clip(np.searchsorted(self.pauses, seen, side="right") - 1, 0, None)
        axes = transform_footprint_to_odom[:2, :2]
        # J C J' with J = [[1, 0, -y], [0, 1, x]]; the terms of each pause are computed once, so that each cell costs
        # only a few products per axis.
        since = self.total[-1] - self.total
        since[:-1] += self.own[:-1] + self.own[-1]
        slipped = self.slip[-1] - self.slip
        result = np.empty((2, len(seen)))
        for axis, (ax, ay) in enumerate(axes.T.tolist()):
            shift = ax * ax * since[:, 0, 0] + 2 * ax * ay * since[:, 0, 1] + ay * ay * since[:, 1, 1]
            both = 2 * (ax * since[:, 0, 2] + ay * since[:, 1, 2])
            lever = ay * x - ax * y
            shift += (ax * slipped[:, 0] + ay * slipped[:, 1]) ** 2
            result[axis] = shift[entry] + lever * (both[entry] + lever * since[:, 2, 2][entry])
        return np.maximum(result, 0.0)

    @staticmethod
    def of_fields(fields: Fields) -> SidewaysDrift:
        """Read the sums from a file.

        Raises:
            FileFormatError: a value is missing or impossible, the pauses are not ascending, or a drift shrinks.
        """
        count = len(fields.sequence("pauses"))
        pauses = fields.array("pauses", (count,)) if count else np.empty(0)
        total = fields.array("total", (count, 3, 3)) if count else np.empty((0, 3, 3))
        # Files of earlier versions lack these values.
        own = fields.array("own", (count, 3, 3)) if count and fields.has("own") else np.zeros((count, 3, 3))
        slip = fields.array("slip", (count, 2)) if count and fields.has("slip") else np.zeros((count, 2))
        # A drift that shrinks would remove safety margins of the map.
        if (np.diff(pauses) <= 0).any() or (np.diff(total, axis=0).diagonal(axis1=1, axis2=2) < 0).any():
            raise FileFormatError(f"{fields.path_to('total')} decreases or pauses do not ascend: the file is damaged")
        return SidewaysDrift(pauses.astype(np.int64), total, own, slip)


def kept_growth(growth: Float, prior: Float, posterior: Float) -> Float:
    """Covariance of a motion after an update of the filter from `prior` to `posterior`; (3, 3) each.

    The covariance shrinks along each direction in the same ratio as the prior. For a single unknown, it is `growth *
    posterior / prior`.
    """
    root = np.linalg.cholesky(prior)
    inverse = np.linalg.inv(root)
    ratios, directions = np.linalg.eigh(inverse @ posterior @ inverse.T)
    half = directions * np.sqrt(np.clip(ratios, 0.0, 1.0)) @ directions.T
    kept = root @ half @ inverse
    return np.asarray(kept @ growth @ kept.T)

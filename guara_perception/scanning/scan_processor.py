"""Incremental processing of one scan, from its frames to a terrain grid."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from guara_perception.arrays import Float, Grey, Image, Index
from guara_perception.calibration.calibration import Calibration, format_indices
from guara_perception.calibration.drift import Drift
from guara_perception.calibration.file import load_calibration
from guara_perception.exceptions import CalibrationMismatch, InvalidInput
from guara_perception.ground_picture import GroundPicture
from guara_perception.images import to_grey
from guara_perception.ranging.locate import Triangulator, locator
from guara_perception.ranging.scan_geometry import StripePlace, StripeRanger, scan_geometry
from guara_perception.ranging.stripe_points import StripePoints
from guara_perception.ranging.surface import Key
from guara_perception.scanning.background import MOVED, BackgroundWitness, motion_text
from guara_perception.scanning.flash_proof import (
    OTHER_INSTANT,
    SECOND_LINE,
    FlashProof,
    Proof,
    second_line,
    second_line_in_motion,
    without_spoilt,
)
from guara_perception.scanning.light_diagnosis import FrameSamples
from guara_perception.scanning.scan_report import FloorCheck, Proved, planned_record, scan_drift, scan_record
from guara_perception.scanning.scan_surface import ScanSurface, SharedVariance, sway_variance
from guara_perception.scanning.stripe_finder import METHODS, StripeFinder, check_method
from guara_perception.scanning.stripe_places import NO_PLACE, StripePlaces, parted_pairs
from guara_perception.settings import RobotLike, Settings, robot_model
from guara_perception.stripes.band import FramePair, StripeProfile, bad_frame
from guara_perception.terrain.grid import TerrainGrid
from guara_perception.terrain.layers.geometry import GridGeometry, cell_edge
from guara_perception.terrain.layers.record import ScanRecord
from kinematics import BodyTrack, GravityEstimate, Stance, StanceError, Stillness
from kinematics.self_filter import SelfFilter


class ScanProcessor:
    """Incremental computation of a TerrainGrid from the frames of one scan.

    Attributes:
        settings: perception settings of the robot.
        mode: mode of the scan.
        pose: pose of the body in base_footprint.

    Example:
        processor = ScanProcessor(calibration, robot, stance, mode="standard")
        processor.add(index, on, off)
        terrain = processor.finish()
    """

    def __init__(
        self,
        calibration: Calibration | str | Path,
        robot: RobotLike,
        stance: Stance | Mapping[str, Any],
        mode: str = "standard",
        *,
        method: str = "precise",
        threshold: float | None = None,
        resolution: float | None = None,
        stamp: int = 0,
        step: int = 0,
        track: BodyTrack | None = None,
        gravity: GravityEstimate | None = None,
    ) -> None:
        """Compute everything that does not depend on the frames.

        Args:
            calibration: calibration of this rangefinder, or the path of its file.
            robot: model, name or folder of the robot that carries the rangefinder.
            stance: joint positions, support feet and gravity at this pause.
            mode: "coarse" or "standard".
            method: one of `guara_perception.scanning.stripe_finder.METHODS`.
            threshold: binarisation threshold of the paper's methods [8-bit grey levels]; None = set for each frame.
            resolution: edge length of a cell [m], a divisor of both sides of the footprint; None = the robot's default.
            stamp: time of the end of the scan [ns since the Unix epoch].
            step: number of the stance pause.
            track: poses of the body relative to this stance, for a robot that sways. Each stripe is placed at the
                `instant` of its `FramePair`; a stripe whose pose is unknown is not used. Samples may be added to the
                track until `finish`. None = the robot stands still.
            gravity: gravity from leg odometry (`LegOdometry.carried_gravity`), used if the stance contains no gravity.
                Without either, the plane of the support feet is taken as horizontal.

        Raises:
            InvalidInput: unknown mode or method, a threshold that the method does not accept, a resolution that does
                not divide the footprint, or a track with a method other than 'precise'.
            CalibrationMismatch: the calibration belongs to another robot or holds no stripe of this mode.
            MissingFile, FileFormatError: the calibration's file is missing or invalid, its covariance is not as
                documented, or the robot's settings are invalid.
            kinematics.KinematicsError: the robot cannot be loaded, or the stance does not fit it.
        """
        check_method(method, threshold)
        if not isinstance(calibration, Calibration):
            calibration = load_calibration(calibration)
        robot = robot_model(robot)
        if calibration.robot != robot.name:
            raise CalibrationMismatch(
                f"the calibration belongs to robot {calibration.robot!r}, not {robot.name!r}: calibrate this robot"
            )
        self.settings = settings = Settings.of(robot)
        self.mode = mode
        self._pattern = settings.pattern(mode)
        self._calibration, self._robot, self._method, self._threshold = calibration, robot, method, threshold
        self._stance = stance if isinstance(stance, Stance) else Stance.from_dict(stance)
        self._gravity = gravity
        self.pose = robot.stance_pose(self._stance, odometry=gravity)
        self._stamp, self._step = int(stamp), int(step)
        self._floor = FloorCheck(self.pose)
        self._cell = cell_edge(resolution, settings.resolution)
        to_footprint = self.pose.transform_base_to_footprint
        self._geometry = scan_geometry(calibration, to_footprint, settings, mode)
        if not self._geometry.stripes:
            raise CalibrationMismatch(
                f"the calibration holds no stripe of the {mode} pattern; it holds {format_indices(calibration.indices)}"
            )
        self._planned = planned_record(self._geometry, robot, self._stance, self.pose, mode, method)
        self._locator = locator(
            METHODS[method],
            calibration.camera,
            self._geometry.transform_camera_to_footprint,
            (settings.footprint_x, settings.footprint_y),
        )
        self._finder = StripeFinder(method, calibration.camera.size, self._pattern.step, threshold)
        self._body = SelfFilter(self.pose.state, transform_base_to_frame=to_footprint)
        height_limits = settings.minimum_height, settings.maximum_height
        self._ranger = StripeRanger(self._geometry, self._locator, height_limits, self._body.contains)
        self._motion = self._undetectable_motion()
        self._sway = sway_variance(robot, self.pose)
        self._places: StripePlaces | None = None
        if track is not None:
            if not isinstance(self._locator, Triangulator):
                raise InvalidInput(f"method {method!r} takes one pose for all stripes; allowed with a track: 'precise'")
            self._places = StripePlaces(track, self.pose, calibration.transform_camera_to_base)
        self._profiles: dict[int, StripeProfile] = {}
        self._samples = FrameSamples(list(self._geometry.stripes), calibration.camera.size)
        self._surface = self._new_surface()
        self._proof = FlashProof()
        # Corners of the scanned area in base_footprint.
        self._corners = np.array([(x, y, 0.0) for x in settings.footprint_x for y in settings.footprint_y])
        to_camera = self._geometry.transform_camera_to_footprint
        self._witness = BackgroundWitness(calibration.camera, to_camera, self._corners)
        # Cached result of `_what_is_proved`, preceded by the version of the inputs.
        self._proved: tuple[tuple[object, ...], Proved] | None = None
        # Index and laser-off image of the usable stripe with the lowest index, usually the first one fired.
        self._off: tuple[int, Grey] | None = None
        self._seconds = {"extract": 0.0, "triangulate": 0.0, "raster": 0.0}

    def _undetectable_motion(self) -> Float | None:
        """Covariance (6, 6) of the camera motion that the joint readings before and after the scan cannot detect.

        None with fewer than three support feet, or with feet on a line: the node cannot test stillness then, and never
        confirms the scan.
        """
        camera = self._calibration.transform_camera_to_base
        try:
            return Stillness(self._robot, self._stance, 0.0, transform_camera_to_base=camera).covariance
        except StanceError:
            return None

    @property
    def grid(self) -> GridGeometry:
        """Geometry of the grid that `finish` returns for the area "footprint"."""
        return self._surface.grids["footprint"]

    @property
    def camera_position(self) -> Float:
        """Optical centre (3,) in base_footprint [m]; z is the paper's H, and (x, y) is the nadir.

        With method `paper-literal-ortho`, x and y are instead the centre of the scanned area, about which that method
        orthorectifies.
        """
        return self._locator.view_point

    @property
    def transform_camera_to_footprint(self) -> Float:
        """Pose (4, 4) of the camera in base_footprint at this stance."""
        return self._geometry.transform_camera_to_footprint

    @property
    def points(self) -> Mapping[int, StripePoints]:
        """Points of the usable stripes added so far, by stripe index."""
        return self._what_is_proved().surface.stripes

    @property
    def refused(self) -> str:
        """Reason why no stripe of the scan may be used (see `Proof.refused`); empty if there is none."""
        return self._what_is_proved().proof.refused

    @property
    def ground_picture(self) -> GroundPicture | str:
        """Laser-off image of this scan for `TerrainMap.update`, or the reason why there is none."""
        if self._off is None:
            return "the scan has no laser-off picture"
        index, grey = self._off
        proved = self._what_is_proved()
        places = proved.places
        if proved.proof.refused or proved.profiles[index].is_frame_bad:
            return proved.proof.refused or proved.profiles[index].reason
        pose = self.transform_camera_to_footprint if places is None else places[index].transform_camera_to_footprint
        return GroundPicture(grey, self._calibration.camera, pose)

    @property
    def track_fault(self) -> str:
        """Fault of the joint stream that rules out the use of the track; empty without a fault or without a track."""
        return "" if self._places is None else self._places.missing

    def leave_track(self) -> None:
        """Stop using the track, with `track_fault` as the reason, and place all stripes at the pose of the stance.

        This also applies to stripes added later and to all copies of this scan. The caller must know that the body
        stood still. Without a fault, the call has no effect.
        """
        if self._places is not None:
            self._places.left = self.track_fault

    def flash(self, index: int) -> tuple[float, float] | None:
        """Instant of a usable stripe's flash on the clock of the track, and its sigma [s]; None if unknown."""
        return None if self._places is None else self._places.flashes.get(index)

    def expect_dark(self, dark_after: Collection[int]) -> None:
        """Expect dark flashes after some stripes.

        Stripes after the last usable dark flash are not used.

        Args:
            dark_after: indices of stripes still to be added whose dark flash will be given by `FramePair.dark` or
                `add_dark`.
        """
        self._proof.expect(dark_after)

    def add_dark(self, index: int, dark: Image, *, off: Image | None = None) -> None:
        """Add the image of the dark flash after a stripe whose own images cannot be used.

        Args:
            index: index of the stripe.
            dark: image of the dark flash.
            off: a laser-off image for comparison; None = the first dark image that was added without one.
        """
        self._proof.add_dark(index, dark, off)

    def _what_is_proved(self) -> Proved:
        """Stripes confirmed by dark flashes, background and track; cached until one of these changes."""
        placed = 0 if self._places is None else self._places.update()
        version = (*self._proof.version, len(self._profiles), placed, "" if self._places is None else self._places.left)
        if self._proved is None or self._proved[0] != version:
            self._proved = version, self._prove(self._proof.judge())
        return self._proved[1]

    def _prove(self, proof: Proof) -> Proved:
        width = self._calibration.camera.size[0]
        unproved = f"{OTHER_INSTANT}, perhaps: no dark flash followed this stripe"
        forbidden = dict.fromkeys(proof.doubled, SECOND_LINE) | dict.fromkeys(proof.unproved, unproved)
        left = "" if self._places is None else self._places.left
        places = None if self._places is None or left else dict(self._places.places)
        claimed = None
        parted: Collection[Key] = ()
        if places is not None:
            forbidden |= dict.fromkeys(set(self._profiles).difference(places), NO_PLACE)
            claimed = {index: place.transform_camera_to_footprint for index, place in places.items()}
            parted = parted_pairs(places, self._pattern.step, self._corners)
        moved = {i: rise for i, rise in self._witness.moved(self._profiles, claimed).items() if i in self._profiles}
        # The variance of a sway is added only if a motion could go unnoticed. Once motion is detected, only stripes
        # during which the body stood still are used, so it is not needed.
        may_sway = places is None and not moved and self._witness.is_blind
        motion = motion_text(moved, len(parted), len(self._profiles), has_track=places is not None)
        motion = "; ".join(filter(None, (left, motion)))
        forbidden |= dict.fromkeys(moved, MOVED)
        if proof.refused:
            forbidden = dict.fromkeys(self._profiles, proof.refused)
        changed: dict[int, StripeProfile] = {}
        for index, profile in self._profiles.items():
            if profile.is_frame_bad:
                continue
            if index in forbidden:
                changed[index] = bad_frame(width, forbidden[index])
            elif proof.spoilt is not None and (new := without_spoilt(profile, proof.spoilt)) is not profile:
                changed[index] = new
        if not changed and self._places is None:
            return Proved(proof, self._profiles, self._surface, motion, may_sway)
        profiles = {**self._profiles, **changed}
        good = {index: each for index, each in profiles.items() if not each.is_frame_bad}
        surface = self._new_surface(places, parted)
        if self._places is None:
            surface.add({index: each for index, each in self._surface.stripes.items() if index not in changed})
            surface.add(self._ranger.points({index: each for index, each in good.items() if index in changed}))
        else:
            surface.add(self._ranger.points(good, places))
        return Proved(proof, profiles, surface, motion, may_sway, places)

    def _new_surface(
        self, places: Mapping[int, StripePlace] | None = None, parted: Collection[Key] = ()
    ) -> ScanSurface:
        """Empty surface, to which stripes can be added."""
        geometry, body = self._geometry, self._body
        if places:
            geometry, body = geometry.moved(places), places[sorted(places)[len(places) // 2]].body
        # With a track, the sigmas of each stripe's own pose already include the motion.
        motion = None if places else self._motion
        return ScanSurface(
            self._cell,
            geometry,
            self.settings,
            self._pattern,
            body,
            SharedVariance(geometry, self.pose.covariance, motion),
            self.pose.attitude_sigma,
            self._sway,
            parted,
        )

    def drift(self) -> Drift:
        """Check the calibration for drift, using the floor that this scan measured; see `check_drift`.

        Frames mirrored left to right cause an apparent drift that vanishes when they are mirrored back. The result then
        names this cause.
        """
        return scan_drift(self.points, self._mirrored_points, self.pose)

    @property
    def light_margins(self) -> dict[str, float]:
        """Margins of the light diagnosis, and height of the stripe above the background; see `FrameSamples.margins`."""
        return self._samples.margins()

    def _mirrored_points(self) -> dict[int, StripePoints]:
        """Points of the stripes as if every frame had been mirrored left to right."""
        proved = self._what_is_proved()
        usable = {index: each.mirrored() for index, each in proved.profiles.items() if not each.is_frame_bad}
        return self._ranger.points(usable, proved.places)

    @property
    def profiles(self) -> Mapping[int, StripeProfile]:
        """Stripe profiles of the frames added so far, by index."""
        return dict(sorted(self._what_is_proved().profiles.items()))

    def add(self, index: int, on: Image, off: Image | None = None, dark: Image | None = None) -> StripeProfile:
        """Process one frame pair like `add_all`, with the same errors, and return its profile."""
        return self.add_all([FramePair(index, on, off, dark)])[0]

    def add_all(self, pairs: Sequence[FramePair]) -> list[StripeProfile]:
        """Process frame pairs.

        One call with several pairs is faster than a call for each pair, with the same result. If all pairs have
        laser-off frames and none has a dark frame, their order affects only the test for motion.

        Without laser-off frames, the background of a stripe is the pixelwise minimum of one channel of two earlier
        frames of the sweep. Add such stripes in order. The background of the first stripes, which have too few earlier
        frames, is estimated from their own frames. A later stripe is rejected if one of its two earlier frames was
        lost or unusable.

        A frame that cannot be used, for example because it is blank, has the wrong size or is swapped with the other,
        marks its stripe as bad; the scan continues and its report lists the stripe.

        Args:
            pairs: one frame pair per stripe.

        Returns:
            Profile of each stripe, in the order of the pairs.

        Raises:
            InvalidInput: an index is not in the pattern of this mode, or was added before; nothing was processed.
            CalibrationMismatch: an index is not calibrated; nothing was processed.
        """
        indices = [pair.index for pair in pairs]
        for number, index in enumerate(indices):
            self._check_new(index, indices[:number])
            self._calibration.stripe(index)
        start = time.perf_counter()
        stripes = self._geometry.stripes
        profiles: dict[int, StripeProfile] = {}
        for pair in pairs:
            band = stripes[pair.index].band
            profiles[pair.index] = profile = self._finder.find(pair, band)
            self._proof.add(pair.index, profile)
            if not profile.is_frame_bad:
                # Sampled immediately, while these rows of the images are in the CPU cache.
                share = second_line(pair, profile)
                self._samples.add(pair, profile)
                self._witness.look(pair.index, pair.on, pair.off, band)
                if not self._witness.is_still(pair.index):
                    share = second_line_in_motion(share, pair, profile)
                self._proof.add_second_line(pair.index, share)
                if pair.off is not None and (self._off is None or pair.index < self._off[0]):
                    self._off = pair.index, to_grey(pair.off)
            if pair.dark is not None:
                self._proof.add_dark(pair.index, pair.dark, pair.off)
        good = {index: profile for index, profile in profiles.items() if not profile.is_frame_bad}
        extracted = time.perf_counter()
        points: Mapping[int, StripePoints] = {}
        if self._places is None:
            points = self._ranger.points(good)
        else:
            self._places.expect([pair for pair in pairs if pair.index in good])
        triangulated = time.perf_counter()
        self._profiles.update(profiles)
        self._surface.add(points)
        self._seconds["extract"] += extracted - start
        self._seconds["triangulate"] += triangulated - extracted
        self._seconds["raster"] += time.perf_counter() - triangulated
        return list(profiles.values())

    def mark_bad(self, index: int, reason: str) -> None:
        """Mark as bad a stripe that was fired but whose frame was lost or not taken at its mirror angle.

        Args:
            index: index of the stripe in the standard pattern.
            reason: text for the report.

        Raises:
            InvalidInput: the index is not in the pattern of this mode, or was added before.
        """
        self._check_new(index)
        self._profiles[index] = bad_frame(self._calibration.camera.size[0], reason or "no frame")
        self._proof.add(index, self._profiles[index])

    def band(self, index: int) -> tuple[int, int]:
        """Image rows (first, end) between which a stripe can appear; (0, 0) if it is out of view at this stance.

        Raises:
            CalibrationMismatch: the index is not calibrated, or not in the pattern.
        """
        self._calibration.stripe(index)
        if index not in self._geometry.stripes:
            raise CalibrationMismatch(f"stripe index {index} is not in the {self.mode} pattern")
        return self._geometry.stripes[index].band

    @property
    def pairs(self) -> Index:
        """Index (ny, nx) of the first stripe of the pair that encloses each cell on flat ground, -1 where none does.

        With a track, the stripes are projected from the latest known pose of the body.
        """
        now = None if self._places is None or self._places.left else self._places.now()
        if now is None:
            return self._surface.pairs
        return self._new_surface(dict.fromkeys(self._geometry.stripes, now)).pairs

    def extended(self) -> ScanProcessor:
        """Standard scan with the stripes of this coarse scan, to which the caller adds the stripes between them.

        Raises:
            InvalidInput: this scan is not coarse.
        """
        if self.mode != "coarse":
            raise InvalidInput(f"a scan of mode {self.mode!r} cannot be extended; allowed: 'coarse'")
        return self._copy("standard", self._profiles)

    def restricted(self, indices: Collection[int]) -> ScanProcessor:
        """Copy of this scan with only the stripes in `indices`."""
        return self._copy(self.mode, indices)

    def _copy(self, mode: str, indices: Collection[int]) -> ScanProcessor:
        """Copy of this processor in the given mode, with only the stripes in `indices`."""
        other = ScanProcessor(
            self._calibration,
            self._robot,
            self._stance,
            mode,
            method=self._method,
            threshold=self._threshold,
            resolution=self.grid.resolution,
            stamp=self._stamp,
            step=self._step,
            gravity=self._gravity,
        )
        other._places = self._places
        other._profiles.update({index: each for index, each in self._profiles.items() if index in indices})
        other._samples.take_over(self._samples, indices)
        other._off = self._off if self._off is not None and self._off[0] in indices else None
        other._surface.add({index: each for index, each in self._surface.stripes.items() if index in indices})
        # Shared, not copied, so that findings on later frames also apply to the stripes copied now.
        other._proof, other._witness = self._proof, self._witness
        other._seconds.update(self._seconds)
        return other

    def work_ahead(self) -> None:
        """Judge the stripes added so far, so that `finish` only has to compute what later stripes change.

        This changes only the run time of `finish`, and takes about as long as `finish`. Call it while waiting for the
        last few stripes. It has no effect with a track, because stripes are then placed later.
        """
        if self._places is None:
            proved = self._what_is_proved()
            proved.surface.layers("footprint", may_sway=proved.may_sway)
            self._floor.verdict(proved.surface.stripes)

    def finish(self, area: str = "footprint", *, record: ScanRecord | None = None) -> TerrainGrid:
        """Compute the terrain from the stripes added so far.

        May be called at any time, and again after further stripes.

        Args:
            area: "footprint", or "wide": extended along y to the width of the robot's map, for `TerrainMap.update`.
            record: record of another grid of this scan, reused except for its lost cells; None = compute it.

        Raises:
            InvalidInput: unknown area.
            UnsafeGrid: the grid violates the safety invariant (a bug of this program, not a fault in the data).
        """
        start = time.perf_counter()
        proved = self._what_is_proved()
        layers = proved.surface.layers(area, may_sway=proved.may_sway)
        # A refused scan is not evidence of lost returns: its stripes must not erase known cells of the map.
        unusable = {} if proved.proof.refused else proved.profiles
        lost = {index for index, profile in unusable.items() if profile.is_frame_bad}
        is_lost = np.array([index in lost for index in self._geometry.stripes])
        lost_cells = proved.surface.lost_cells(layers, is_lost, area)
        if record is None:
            record = scan_record(
                self._planned,
                geometry=self._geometry,
                robot=self._robot,
                proved=proved,
                layers=layers,
                seconds={**self._seconds, "finish": time.perf_counter() - start},
                samples=self._samples,
                floor=self._floor,
                mirrored_points=self._mirrored_points,
                lost_cells=lost_cells,
            )
        else:
            record = dataclasses.replace(record, lost_cells=lost_cells)
        return TerrainGrid(
            layers=layers,
            geometry=self._surface.grids[area],
            stamp=self._stamp,
            step=self._step,
            extent="footprint",
            record=record,
        )

    def _check_new(self, index: int, others: Sequence[int] = ()) -> None:
        if index not in self._pattern:
            raise InvalidInput(
                f"stripe index {index} is not in the {self.mode} pattern: {format_indices(tuple(self._pattern))}"
            )
        if index in self._profiles or index in others:
            raise InvalidInput(f"stripe index {index} was added before; a scan takes each stripe once")

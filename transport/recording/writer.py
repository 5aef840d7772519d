"""Writer of recordings; acknowledged data survive the end of the process, even if it is killed."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, Self

from transport.exceptions import RecordingError
from transport.keys import DEFAULT_ROBOT
from transport.messages.codec import encode, make_header, make_stance, make_time, to_ros
from transport.messages.stance_pause import StancePause, encode_stance_pause
from transport.messages.stance_stream import StanceStream, encode_stance_stream
from transport.messages.submessages import StanceMessage
from transport.messages.terrain_message import TerrainMessage, encode_terrain
from transport.messages.typestore import SCAN_END, SCAN_START, STRIPE, make_message
from transport.recording.records import CAMERA_FRAME, FlashRecord, FrameRecord, FrameReference, ScanRecord, make_frame
from transport.recording.topic_file import TopicFile
from transport.recording.topics import CALIBRATION_NAME, TYPES, full_name


class RecordingWriter(TopicFile):
    """Writer of an MCAP file with ROS 2 messages; use it in a `with` block. Thread-safe.

    A scan is acknowledged when `end_scan` returns, a grid when `add_terrain` returns. Acknowledged data survive the end
    of the process. Records that do not fit on a full disk are buffered, up to `MAXIMUM_PENDING`, and written when there
    is space again. Only the last record of the file can be incomplete.

    Methods that add data raise RecordingError if the file is closed or the buffer is full, and those that acknowledge
    data also if the disk is full. They raise MessageError if a value does not fit its ROS 2 type.

    In the file, log_time is the time of writing and never decreases. The publish_time of a frame is the stamp by which
    stripes refer to it; all other messages have publish_time equal to log_time.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        robot: str = DEFAULT_ROBOT,
        calibration: bytes | None = None,
        atomic: bool = False,
        sync: bool = False,
    ) -> None:
        """Create the file.

        Args:
            path, robot, atomic, sync: as in `TopicFile`.
            calibration: content of `calibration.json` to attach.

        Raises:
            RecordingError: the file exists or cannot be created. A full disk is reported at the next acknowledgement
                instead.
            KeyNameError: the robot's name cannot be part of a topic name.
        """
        super().__init__(path, robot, atomic=atomic, sync=sync)
        self._stamps: dict[str, int] = {}
        self._scan: ScanRecord | None = None
        self._stripes = 0
        if calibration is not None:
            self.attach(CALIBRATION_NAME, "application/json", calibration)

    def __enter__(self) -> Self:
        """Return the writer."""
        return self

    @property
    def is_scan_open(self) -> bool:
        """True between `begin_scan` and `end_scan`."""
        return self._scan is not None

    def begin_scan(self, scan: ScanRecord) -> None:
        """Start a scan. Its stripes are added by `add_stripe`; `scan.stripes` is ignored.

        Raises:
            RecordingError: another scan is open.
        """
        with self._lock:
            if self._scan is not None:
                raise RecordingError(f"scan of step {self._scan.step} is still open; end it first")
            header = make_header(scan.stamp, "base_link")
            self.add("scan/start", encode(to_ros(SCAN_START, scan, header=header)))
            self._scan, self._stripes = scan, 0

    def add_frame(self, frame: FrameRecord, *, laser_on: bool) -> FrameReference:
        """Add a frame and return the reference for `add_stripe`.

        A frame without a stamp gets the stamp of the open scan. A stamp that is not later than the previous one on the
        same topic is replaced by the previous one plus 1 ns.
        """
        kind = "on" if laser_on else "off"
        short = f"camera/{kind}" if frame.pixels is not None else f"camera/{kind}/compressed"
        with self._lock:
            given = frame.stamp or (self._scan.stamp if self._scan else 0)
            stamp = max(given, self._stamps.get(short, -1) + 1)
            self._stamps[short] = stamp
            self.add(short, encode(make_frame(frame, stamp)), stamp)
            return FrameReference(full_name(short, self._robot), stamp)

    def add_stripe(
        self,
        index: int,
        mirror_angle: float,
        on: FrameRecord | FrameReference | None,
        off: FrameRecord | FrameReference | None = None,
        *,
        stamp: int | None = None,
    ) -> None:
        """Add a stripe of the open scan.

        Args:
            index: index in the standard pattern.
            mirror_angle: commanded mirror angle [rad].
            on: frame with the laser on, or a reference to a frame added before; None if the frame was lost.
            off: frame with the laser off, or a reference to a frame that several stripes share; None if there is
                none.
            stamp: time of the stripe [ns]; None = stamp of the frame with the laser on, or of the scan if that frame
                was lost.

        Raises:
            RecordingError: no scan is open.
        """
        with self._lock:
            scan = self._open_scan()
            on_at = self.add_frame(on, laser_on=True) if isinstance(on, FrameRecord) else on
            off_at = self.add_frame(off, laser_on=False) if isinstance(off, FrameRecord) else off
            when = stamp if stamp is not None else (on_at.stamp if on_at else scan.stamp)
            message = _stripe_message(scan.step, index, mirror_angle, on_at, off_at, when)
            self.add("scan/stripe", encode(message))
            self._stripes += 1

    def add_dark(self, index: int, mirror_angle: float, frame: FrameRecord | FrameReference | None, stamp: int) -> None:
        """Add the dark flash after a stripe of the open scan; call it right after `add_stripe`.

        Args:
            index, mirror_angle: as in `add_stripe`.
            frame: frame of the dark flash; None if it was lost.
            stamp: time of the dark flash [ns].

        Raises:
            RecordingError: no scan is open.
        """
        with self._lock:
            scan = self._open_scan()
            at = self.add_frame(frame, laser_on=False) if isinstance(frame, FrameRecord) else frame
            self.add("scan/dark", encode(_stripe_message(scan.step, index, mirror_angle, None, at, stamp)))

    def add_flash(self, index: int, flash: FlashRecord) -> None:
        """Add the time of a stripe's flash to the open scan; call it after `add_stripe`.

        Raises:
            RecordingError: no scan is open.
        """
        with self._lock:
            message = _stripe_message(self._open_scan().step, index, 0.0, None, None, flash.begin)
            # On this topic, on_stamp and off_stamp contain the time of the flash and its sigma instead of frame stamps.
            message.on_stamp, message.off_stamp = make_time(flash.stamp), make_time(flash.sigma)
            self.add("scan/flash", encode(message))

    def end_scan(self, *, stance_end: StanceMessage | None = None, stamp: int | None = None) -> None:
        """End the open scan and acknowledge it.

        Args:
            stance_end: stance after the scan; None if it was not read.
            stamp: end of the scan [ns]; None = stamp of the scan.

        Raises:
            RecordingError: no scan is open, or the disk is full.
        """
        with self._lock:
            scan = self._open_scan()
            when = stamp if stamp is not None else scan.stamp
            given = {} if stance_end is None else {"has_stance_end": True, "stance_end": make_stance(stance_end)}
            header, step = make_header(when, "base_link"), scan.step
            message = make_message(SCAN_END, header=header, step=step, stripes=self._stripes, **given)
            self.add("scan/end", encode(message))
            self._scan = None
            self.flush()

    def add_terrain(self, terrain: TerrainMessage) -> None:
        """Add a grid of either extent, and acknowledge it."""
        short = "terrain" if terrain.extent == "footprint" else "map"
        self._put(short, encode_terrain(terrain))

    def add_stance_pause(self, pause: StancePause) -> None:
        """Add an announcement of a stance pause, and acknowledge it."""
        self._put("stance", encode_stance_pause(pause))

    def add_stance_stream(self, stream: StanceStream) -> None:
        """Add a stance batch without acknowledging it; the next acknowledgement includes it."""
        self.add("stance_stream", encode_stance_stream(stream))

    def add_messages(self, named: Iterable[tuple[str, Any]]) -> None:
        """Add messages, each with its topic (a key of `TYPES`, such as "occupancy" or "/tf"), and acknowledge them.

        Raises:
            RecordingError: a topic is unknown or has another message type, or the disk is full; the messages before the
                faulty one have been added.
        """
        with self._lock:
            for short, message in named:
                if TYPES.get(short) != message.__msgtype__:
                    raise RecordingError(
                        f"topic {short!r} does not accept {message.__msgtype__}; topics are {', '.join(TYPES)}"
                    )
                self.add(short, encode(message))
            self.flush()

    def add_status(self, payload: bytes | bytearray) -> None:
        """Add the CDR payload of a node's status without acknowledging it; the next acknowledgement includes it."""
        self.add("status", payload)

    def _open_scan(self) -> ScanRecord:
        if self._scan is None:
            raise RecordingError("no scan is open; call begin_scan first")
        return self._scan

    def _put(self, short: str, payload: bytes | bytearray) -> None:
        with self._lock:
            self.add(short, payload)
            self.flush()


def _stripe_message(
    step: int, index: int, mirror_angle: float, on: FrameReference | None, off: FrameReference | None, stamp: int
) -> Any:
    return make_message(
        STRIPE,
        header=make_header(stamp, CAMERA_FRAME),
        step=step,
        index=index,
        mirror_angle=float(mirror_angle),
        on_topic=on.topic if on else "",
        on_stamp=make_time(on.stamp if on else 0),
        off_topic=off.topic if off else "",
        off_stamp=make_time(off.stamp if off else 0),
    )

"""Journal of a walk in a folder, written at each confirmed pause and read when the node is restarted."""

from __future__ import annotations

import logging
import os
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import IO

from guara_perception.app.node.claim import Claim, Seal
from guara_perception.exceptions import FileFormatError, InvalidInput, PerceptionError
from kinematics import RobotModel
from transport import Health, Outbox, ReceiveTimeout, StatusItem

logger = logging.getLogger(__name__)
# At INFO, so that the log also reports that a walk continues.
logger.setLevel(logging.INFO)
# Number of files: two copies of the last claim, in case one is damaged, and the claim before it, for a pause that is
# scanned again.
SLOTS = 3
# [s] Longest time that the node waits for the last claim to be written when it stops.
CLOSE_S = 5.0
# [s] Longest time that a confirmed map waits for the journal; writing takes 0.1 s, or several times that on a busy
# machine.
CONFIRM_S = 2.0


class Journal(AbstractContextManager["Journal"]):
    """Journal of one node in three files, of which the oldest is replaced; written on a separate thread.

    A claim is written to a temporary file when the scan of its pause is fused. When the pause is confirmed, that file
    only has to be renamed, so a node killed immediately afterwards loses nothing. A copy then replaces the next oldest
    file.

    Attributes:
        claims: claims found in the files at the start, newest first; empty once they are rejected, or once the first
            confirmed pause is over and the next has begun.
    """

    def __init__(self, folder: Path, robot: RobotModel, seal: Seal) -> None:
        """Create the folder and read the files in it; the status reports files that cannot be used.

        Raises:
            InvalidInput: the folder cannot be created or is not writable.
        """
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            raise InvalidInput(f"--state is {folder}: {error.strerror}; allowed: a folder of this user") from None
        if not os.access(folder, os.W_OK | os.X_OK):
            raise InvalidInput(f"--state is {folder}, which is not writable; allowed: a folder of this user")
        self._seal, self._lock = seal, threading.Lock()
        self._paths = [folder / f"{seal.instance.replace('/', '-')}-{slot}.journal" for slot in range(SLOTS)]
        self._beside = folder / f".{self._paths[0].stem[:-2]}.journal"
        # The temporary file of an earlier run was never confirmed, or is incomplete.
        self._beside.unlink(missing_ok=True)
        self.claims: tuple[Claim, ...] = ()
        self._outcome, self._level = "no journal was found: a new walk begins", Health.OK
        self._values: dict[str, str] = {"resumed": "0", "refused": "0", "written": "0", "failed": "0"}
        self._trouble = ""
        self._read(robot)
        # The newest claim, and the claim in the temporary file.
        self._last: Claim | None = None
        self._written: Claim | None = None
        self._outbox = Outbox()

    def __exit__(self, *error: object) -> None:
        """Finish writing; wait at most CLOSE_S."""
        with suppress(ReceiveTimeout):
            self._outbox.flush(CLOSE_S)
        self._outbox.close()

    def write(self, claim: Claim | None) -> None:
        """Queue a claim for the temporary file without blocking. It replaces a waiting claim; None only removes it."""
        self._last = claim
        self._outbox.post("claim", lambda: self._write(claim), lane="journal")

    def confirm(self) -> None:
        """Replace the oldest file with the newest claim; wait up to CONFIRM_S until the file is in place.

        If the file was replaced in time, a node killed afterwards does not lose the confirmed pause.
        """
        claim, is_settled = self._last, threading.Event()
        self._outbox.post("confirmation", lambda: self._replace(claim, is_settled), lane="journal")
        is_settled.wait(CONFIRM_S)

    def resumed(self, claim: Claim) -> None:
        """Report that the walk continues from a claim."""
        self._report(f"walk {claim.epoch!r} continues from step {claim.step}", "resumed")

    def refuse(self, why: str) -> None:
        """Remove the files, and report that a new walk begins for the reason `why`."""
        self.claims = ()
        for path in self._paths:
            path.unlink(missing_ok=True)
        self._report(f"a new walk begins: {why}", "refused")

    def item(self) -> StatusItem:
        """Status item of the journal."""
        with self._lock:
            message = "; ".join(filter(None, (self._outcome, self._trouble)))
            level = Health.WARN if self._trouble else self._level
            return StatusItem(name="journal", level=level, message=message, values=dict(self._values))

    def _read(self, robot: RobotModel) -> None:
        refused, found = [], {}
        for path in filter(Path.exists, self._paths):
            try:
                found[path] = Claim.read(path, robot, self._seal)
            except FileFormatError as error:
                refused.append(str(error))
        # Order of replacement: unusable files first, then from the oldest claim to the newest.
        self._paths.sort(key=lambda path: found[path].time if path in found else -1.0)
        self.claims = tuple(sorted(found.values(), key=lambda claim: -claim.time))
        if self.claims:
            self._outcome = "; ".join(("a walk was found: it continues if the next pause fits", *refused))
        elif refused:
            self._values["refused"] = "1"
            self._outcome = f"a new walk begins: {'; '.join(refused)}"
        self._level = Health.WARN if refused else Health.OK
        for reason in refused:
            logger.warning("journal: %s", reason)

    def _report(self, outcome: str, count: str) -> None:
        is_good = count == "resumed"
        (logger.info if is_good else logger.warning)("journal: %s", outcome)
        with self._lock:
            self._outcome, self._level = outcome, Health.OK if is_good else Health.WARN
            self._values[count] = "1"

    def _write(self, claim: Claim | None) -> None:
        self._written, begun = None, time.monotonic()
        if claim is None:
            return
        with self._failures_in_status():
            with self._open() as stream:
                # No fsync: a reboot restarts the clock, which invalidates the journal anyway.
                claim.write(stream, self._seal)
            taken, size = time.monotonic() - begun, self._beside.stat().st_size
            with self._lock:
                self._values |= {"bytes": str(size), "seconds": f"{taken:.3f}"}
            self._written = claim

    def _replace(self, claim: Claim | None, is_settled: threading.Event) -> None:
        try:
            if claim is None or claim is not self._written:
                return
            self._written = None
            with self._failures_in_status():
                self._rotate()
                with self._lock:
                    self._trouble = ""
                    self._values |= {"written": str(int(self._values["written"]) + 1), "step": str(claim.step)}
                is_settled.set()
                with self._open() as copy:
                    copy.write(self._paths[-1].read_bytes())
                self._rotate()
        finally:
            is_settled.set()

    @contextmanager
    def _failures_in_status(self) -> Iterator[None]:
        try:
            yield
        except (OSError, PerceptionError) as error:
            logger.warning("journal: not written: %s", error)
            with self._lock:
                self._trouble = f"the last claim was not written: {error}"
                self._values["failed"] = str(int(self._values["failed"]) + 1)

    def _open(self) -> IO[bytes]:
        self._beside.unlink(missing_ok=True)
        return os.fdopen(os.open(self._beside, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o600), "w+b")

    def _rotate(self) -> None:
        os.replace(self._beside, self._paths[0])
        self._paths.append(self._paths.pop(0))

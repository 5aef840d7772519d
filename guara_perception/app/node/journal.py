"""Journal of a walk in a folder: written at each confirmed pause, read by the node that is started next."""

from __future__ import annotations

import logging
import os
import threading
import time
from pathlib import Path
from typing import Self

from guara_perception.app.node.claim import Claim, Seal
from guara_perception.exceptions import FileFormatError, InvalidInput, PerceptionError
from kinematics import RobotModel
from transport import Health, StatusItem
from transport.supervision import supervised

logger = logging.getLogger(__name__)
# That a walk goes on is an event, as that it does not.
logger.setLevel(logging.INFO)
# The journal before stands in for one that is damaged, or of the pause that is scanned again.
SLOTS = 2
# [s] Longest wait for the last journal when the node ends.
CLOSE_S = 5.0
# [s] Longest wait of a confirmed map for its journal, which is nearly always written by then.
CONFIRM_S = 0.3


class Journal:
    """The journals of one node: two files, of which the older is replaced; a thread of its own writes them.

    A pause is written beside them when its scan is fused and replaces one of them when it is confirmed, so that next to
    nothing is left to do then: a node may be killed right after.

    Attributes:
        claims: what the journals found at the start claim, the newest first; emptied when one was checked.
    """

    def __init__(self, folder: Path, robot: RobotModel, seal: Seal) -> None:
        """Make the folder and read the journals in it; those that cannot be used are named in the status.

        Raises:
            InvalidInput: the folder cannot be made, or nothing may be written to it.
        """
        try:
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            raise InvalidInput(f"--state is {folder}: {error.strerror}; allowed: a folder of this user") from None
        if not os.access(folder, os.W_OK | os.X_OK):
            raise InvalidInput(f"--state is {folder}: nothing may be written to it; allowed: a folder of this user")
        self._seal, self._lock = seal, threading.Lock()
        self._paths = [folder / f"{seal.instance.replace('/', '-')}-{slot}.journal" for slot in range(SLOTS)]
        self._beside = folder / f".{self._paths[0].stem[:-2]}.journal"
        # Never confirmed, or cut.
        self._beside.unlink(missing_ok=True)
        self.claims: tuple[Claim, ...] = ()
        self._outcome, self._level = "none was found: the walk begins", Health.OK
        self._values: dict[str, str] = {"resumed": "0", "refused": "0", "written": "0", "failed": "0"}
        self._trouble = ""
        self._read(robot)
        # Last claim, that of them which waits to be written, that which was, and that which is confirmed.
        self._last: Claim | None = None
        self._next: Claim | None = None
        self._written: Claim | None = None
        self._confirmed: Claim | None = None
        self._has_news, self._is_closing = threading.Condition(self._lock), False
        self._thread = supervised("guara-journal", self._run)

    def __enter__(self) -> Self:
        """Start writing."""
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        """Write what waits, and end."""
        with self._has_news:
            self._is_closing = True
            self._has_news.notify_all()
        self._thread.join(CLOSE_S)

    def write(self, claim: Claim | None) -> None:
        """Have a claim, if any, written beside the journals; returns at once. A newer claim replaces one that waits."""
        with self._has_news:
            self._last = self._next = claim
            self._has_news.notify_all()

    def confirm(self) -> None:
        """Have the last claim replace the older journal; returns when it has, on a slow disk before.

        What is told as confirmed after that is not lost with the node.
        """
        with self._has_news:
            self._confirmed = self._last
            self._has_news.notify_all()
            self._has_news.wait_for(lambda: self._confirmed is None, CONFIRM_S)

    def resumed(self, claim: Claim) -> None:
        """Tell that the walk goes on from a claim."""
        self._tell(f"walk {claim.epoch!r} goes on from step {claim.step}", "resumed")

    def refuse(self, why: str) -> None:
        """Tell that a new walk begins, and remove what was claimed."""
        self.claims = ()
        for path in self._paths:
            path.unlink(missing_ok=True)
        self._tell(f"a new walk begins: {why}", "refused")

    def item(self) -> StatusItem:
        """State for the status."""
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
        # The oldest is replaced first, and before it what cannot be used.
        self._paths.sort(key=lambda path: found[path].time if path in found else -1.0)
        self.claims = tuple(sorted(found.values(), key=lambda claim: -claim.time))
        if self.claims:
            self._outcome = "; ".join(("a walk was found: it goes on if the next pause fits", *refused))
        elif refused:
            self._values["refused"] = "1"
            self._outcome = f"a new walk begins: {'; '.join(refused)}"
        self._level = Health.WARN if refused else Health.OK
        for reason in refused:
            logger.warning("journal: %s", reason)

    def _tell(self, outcome: str, count: str) -> None:
        is_good = count == "resumed"
        (logger.info if is_good else logger.warning)("journal: %s", outcome)
        with self._lock:
            self._outcome, self._level = outcome, Health.OK if is_good else Health.WARN
            self._values[count] = "1"

    def _run(self) -> None:
        while True:
            with self._has_news:
                self._has_news.wait_for(lambda: self._next is not None or self._is_due() or self._is_closing)
                if is_due := self._is_due():
                    claim, self._written = self._written, None
                else:
                    claim, self._next = self._next, None
            if claim is None:
                return
            try:
                if is_due:
                    self._replace(claim)
                else:
                    self._write(claim)
            except (OSError, PerceptionError) as error:
                logger.warning("journal: not written: %s", error)
                with self._has_news:
                    if self._last is claim:
                        self._last = None
                    self._settle(claim)
                    self._trouble = f"the last one was not written: {error}"
                    self._values["failed"] = str(int(self._values["failed"]) + 1)

    def _is_due(self) -> bool:
        return self._written is not None and self._written is self._confirmed

    def _write(self, claim: Claim) -> None:
        begun = time.monotonic()
        self._written = None
        self._beside.unlink(missing_ok=True)
        handle = os.open(self._beside, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o600)
        with os.fdopen(handle, "w+b") as stream:
            # Not synchronised: when the machine goes down its clock begins anew, and the journal is void.
            claim.write(stream, self._seal)
        with self._lock:
            self._values |= {"bytes": str(self._beside.stat().st_size), "seconds": f"{time.monotonic() - begun:.3f}"}
            self._written = claim

    def _settle(self, claim: Claim) -> None:
        if self._confirmed is claim:
            self._confirmed = None
            self._has_news.notify_all()

    def _replace(self, claim: Claim) -> None:
        os.replace(self._beside, self._paths[0])
        self._paths.append(self._paths.pop(0))
        with self._has_news:
            self._trouble = ""
            self._values |= {"written": str(int(self._values["written"]) + 1), "step": str(claim.step)}
            self._settle(claim)

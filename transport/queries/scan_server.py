"""Server for scan requests, processed one at a time; a repeated request gets the result of the first."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from transport.exceptions import MessageError, ScanFailed
from transport.keys import DEFAULT_ROBOT, scan_key
from transport.links.answerer import Answerer, refuse
from transport.links.recent import Recent
from transport.links.session import Session
from transport.messages.scan_messages import (
    ScanReply,
    ScanRequest,
    ScanState,
    decode_scan_request,
    encode_scan_reply,
)
from transport.messages.terrain_message import TerrainMessage
from transport.messages.typestore import SCAN_REPLY, cdr
from transport.supervision import Failure, join, supervised

logger = logging.getLogger(__name__)
# Number of finished requests whose result is kept, in case the request is repeated.
REMEMBERED = 32


class ScanJob:
    """Accepted scan request, as passed to the handler.

    Attributes:
        request: the accepted request.
        cancelled: event that is set when the handler should stop.
        progress: function `progress(done, total)` that reports numbers of stripes to the clients; returns immediately.
    """

    def __init__(self, request: ScanRequest, report: Callable[[int, int], None]) -> None:
        self.request = request
        self.cancelled = threading.Event()
        self.progress = report
        self._deadline = time.monotonic() + request.timeout

    @property
    def remaining(self) -> float:
        """Time until the deadline of the request [s]; 0 after the deadline."""
        return max(0.0, self._deadline - time.monotonic())


class _Work:
    """Running request: its job, its open queries, its latest progress, and its final reply once sent."""

    def __init__(self, job: ScanJob, queries: list[Any]) -> None:
        self.job = job
        self.queries = queries
        self.last: ScanReply | None = None
        self.progress = ScanReply(id=job.request.id, state=ScanState.ACCEPTED)

    def failed(self, code: str, error: object) -> ScanReply:
        return replace(self.progress, state=ScanState.FAILED, code=code, message=str(error))


Handler = Callable[[ScanJob], TerrainMessage]
Admission = Callable[[ScanRequest], None]


class ScanServer(Answerer):
    """Server for the scan requests to one robot.

    Only one request is processed at a time; others are refused as busy. A request with the id of the running scan joins
    it, and one with the id of one of the last `REMEMBERED` scans gets the result of that scan. At the deadline,
    `ScanJob.cancelled` is set, and the clients get a FAILED reply; the server stays busy until the handler returns.
    """

    def __init__(
        self,
        session: Session,
        handler: Handler,
        *,
        robot: str = DEFAULT_ROBOT,
        admission: Admission | None = None,
    ) -> None:
        """Declare the queryable.

        Args:
            session: open session.
            handler: called on a background thread. It must check `job.cancelled`, report progress, and either return
                the grid after publishing it or raise ScanFailed with a code.
            robot: instance name.
            admission: called before a request is accepted; raises ScanFailed with a code, such as "not_stationary", to
                refuse it.
        """
        self._handler = handler
        self._admission = admission
        self._lock = threading.Lock()
        self._work: _Work | None = None
        self._thread: threading.Thread | None = None
        self._finished: Recent[str, ScanReply] = Recent(REMEMBERED)
        self._is_stopped = False
        super().__init__(session, scan_key(robot), self._admit, in_order=True)

    @property
    def is_busy(self) -> bool:
        """True while a request is being processed."""
        return self._work is not None

    def _reply(self, query: Any, reply: ScanReply) -> None:
        payload = encode_scan_reply(reply)
        name = "last" if reply.state in (ScanState.DONE, ScanState.FAILED) else reply.state.name
        self._post(query, name, lambda: query.reply(self.key, payload, encoding=cdr(SCAN_REPLY)))

    def _refuse(self, query: Any, request_id: str, code: str, message: str) -> None:
        self._post(query, "last", lambda: refuse(query, code, message, request_id))

    def _post(self, query: Any, name: str, send: Callable[[], None]) -> None:
        """Post a reply. Replies to one query are sent in order; a slow link of one query does not delay the others."""

        def act() -> None:
            send()
            if name == "last":
                query.drop()

        # The posted action keeps the query alive, so `id(query)` remains unique.
        self._outbox.post(name, act, lane=str(id(query)))

    def _admit(self, query: Any) -> None:
        try:
            request = decode_scan_request(query.payload.to_bytes() if query.payload is not None else b"")
        except MessageError as error:
            self._refuse(query, "", "bad_request", str(error))
            return
        with self._lock:
            known, work = self._finished.get(request.id), self._work
            if work is not None and work.job.request.id == request.id and work.last is None:
                work.queries.append(query)
                self._reply(query, work.progress)
                return
        if known is not None:
            self._reply(query, known)
        elif work is not None:
            self._refuse(query, request.id, "busy", "the scanner is working on another request; try again later")
        else:
            self._accept(query, request)

    def _accept(self, query: Any, request: ScanRequest) -> None:
        try:
            if self._admission is not None:
                self._admission(request)
        except ScanFailed as error:
            self._refuse(query, request.id, error.code, str(error))
            return
        work = _Work(ScanJob(request, lambda done, total: self._report(work, done, total)), [query])

        def on_failure(failure: Failure) -> None:
            self._give_up(work, "internal", failure, returned=True)

        self._reply(query, work.progress)
        with self._lock:
            self._work = work
            self._thread = supervised("transport-scan", lambda: self._run(work), restarts=None, on_failure=on_failure)
            self._thread.start()

    def _report(self, work: _Work, done: int, total: int) -> None:
        reply = replace(work.progress, state=ScanState.PROGRESS, stripes_done=done, stripes_total=total)
        work.progress = reply
        with self._lock:
            if work.last is None and not self._is_stopped:
                for query in work.queries:
                    self._reply(query, reply)

    def _run(self, work: _Work) -> None:
        job = work.job
        ended = threading.Event()

        def keep_deadline() -> None:
            if not ended.wait(job.remaining):
                passed = f"the deadline of {job.request.timeout:g} s passed before the scan was done"
                self._give_up(work, "timeout", passed)

        supervised("transport-deadline", keep_deadline).start()
        try:
            grid = self._handler(job)
            done = replace(work.progress, state=ScanState.DONE, step=grid.step)
            last = replace(done, sequence=grid.sequence, stamp=grid.stamp)
        except ScanFailed as error:
            last = work.failed(error.code, error)
        except Exception as error:
            logger.exception("scan request %s failed", job.request.id)
            last = work.failed("internal", error)
        finally:
            ended.set()
        self._finish(work, last, returned=True)

    def _give_up(self, work: _Work, code: str, error: object, *, returned: bool = False) -> None:
        work.job.cancelled.set()
        self._finish(work, work.failed(code, error), returned=returned)

    def _finish(self, work: _Work, last: ScanReply, *, returned: bool = False) -> None:
        with self._lock:
            if returned:
                # Set before the final reply is sent, so that the client's next request is not refused as busy.
                self._work = None
            if work.last is not None or self._is_stopped:
                return
            work.last = last
            self._finished[last.id] = last
            queries, work.queries = work.queries, []
            for query in queries:
                self._reply(query, last)

    def _release(self) -> None:
        # End a running scan with a failure, and give its handler some time to return.
        work = self._work
        if work is not None:
            self._give_up(work, "closed", "the scanner is shutting down")
        with self._lock:
            self._is_stopped = True
        super()._release()
        join(self._thread)

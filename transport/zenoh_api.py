"""Calls into Zenoh, which is imported at the first; the only file that uses parts that Zenoh marks unstable."""

from __future__ import annotations

import json
import uuid
from collections.abc import Callable, Mapping
from datetime import UTC, datetime, timedelta
from typing import Any, NamedTuple

from transport.supervision import guarded


def _zenoh() -> Any:
    import zenoh

    return zenoh


def zenoh_error() -> type[Exception]:
    """Class of all errors of Zenoh."""
    error: type[Exception] = _zenoh().ZError
    return error


def error_text(error: Exception) -> str:
    """Text of an error of Zenoh, without the source lines that it appends."""
    return str(error).split(" at /", 1)[0].strip()


def open_raw(configuration: Mapping[str, Any] | str) -> Any:
    """Open a Zenoh session from a configuration: nested mappings, or JSON5 text."""
    text = configuration if isinstance(configuration, str) else json.dumps(configuration)
    return _zenoh().open(_zenoh().Config.from_json5(text))


def configuration_value(text: str, key: str) -> Any:
    """One value of a JSON5 configuration text; None where it is not set. `key` is a path with slashes."""
    return json.loads(_zenoh().Config.from_json5(text).get_json(key))


def with_values(text: str, values: Mapping[str, Any]) -> str:
    """A JSON5 configuration text with some values replaced; the keys are paths with slashes."""
    configuration = _zenoh().Config.from_json5(text)
    for key, value in values.items():
        configuration.insert_json5(key, json.dumps(value))
    return str(configuration)


def direct(callback: Callable[[Any], None], finished: Callable[[], None] | None = None) -> Any:
    """A handler that runs `callback` on Zenoh's receiving thread; it must not block.

    No Python thread stands behind it, so nothing keeps the interpreter from ending. What it raises is reported.
    """
    ending = None if finished is None else guarded(finished)
    return _zenoh().handlers.Callback(guarded(callback), ending, indirect=False)


def declare_publisher(session: Any, key: str, priority: str, encoding: str | None = None) -> Any:
    """A publisher whose samples are dropped for those, and only for those, whose link is congested.

    Nothing here ever blocks: a put that blocks for one reader is late for all others, and what blocks on Zenoh's own
    threads (`BLOCK_FIRST`, the cache of its advanced publisher) stops the links of healthy readers as well.

    Args:
        session: raw Zenoh session.
        key: where to publish.
        priority: name of one of Zenoh's priorities; each has a queue of its own on each link.
        encoding: encoding of all payloads, see `transport.messages.typestore`; None for none.
    """
    zenoh = _zenoh()
    return session.declare_publisher(
        key,
        congestion_control=zenoh.CongestionControl.DROP,
        priority=getattr(zenoh.Priority, priority),
        encoding=encoding,
    )


def source_of(publisher: Any) -> str:
    """Identity of a publisher as two chunks of a key: the id of its session and its own."""
    return f"{publisher.id.zid}/{publisher.id.eid}"


class Stamps:
    """Timestamps of one publisher, each later than the one before, under an identity of its own.

    Attributes:
        source: identity of the publisher as two chunks of a key, as advanced subscribers expect it of publishers that
            number their samples by time.
    """

    def __init__(self) -> None:
        """Choose the identity."""
        self._id = _zenoh().TimestampId(uuid.uuid4().bytes)
        self._last = datetime.min.replace(tzinfo=UTC)
        self.source = f"{self._id}/uhlc"

    def next(self) -> Any:
        """The timestamp of the next sample."""
        self._last = max(datetime.now(UTC), self._last + timedelta(microseconds=1))
        return _zenoh().Timestamp(self._last, self._id)


def has_subscribers(publisher: Any) -> bool:
    """Check whether a publisher has subscribers, as far as this session knows."""
    return bool(publisher.matching_status.matching)


def put(
    publisher: Any, payload: bytes | bytearray, attachment: bytes | None, number: int, timestamp: Any = None
) -> None:
    """Send one payload with its number, by which receivers notice losses, or with a timestamp in its place."""
    if timestamp is not None:
        publisher.put(payload, attachment=attachment, timestamp=timestamp)
    else:
        publisher.put(payload, attachment=attachment, source_info=_zenoh().SourceInfo(publisher.id, number))


def number_of(sample: Any) -> tuple[str, int] | None:
    """Source, as in `source_of`, and number of a received sample; None when it carries none."""
    info = sample.source_info
    return None if info is None else (f"{info.source_id.zid}/{info.source_id.eid}", int(info.source_sn))


def declare_subscriber(session: Any, key: str, on_sample: Callable[[Any], None]) -> Any:
    """A subscriber; `on_sample` runs on Zenoh's thread and must not block."""
    return session.declare_subscriber(key, direct(on_sample))


def declare_token(session: Any, key: str) -> Any:
    """A liveliness token: others see it vanish when this session closes, dies or hangs."""
    return session.liveliness().declare_token(key)


def watch_tokens(session: Any, key: str, on_change: Callable[[str, bool], None]) -> Any:
    """A subscriber to liveliness tokens; `on_change(key, is_alive)` runs on Zenoh's thread."""
    put = _zenoh().SampleKind.PUT
    return session.liveliness().declare_subscriber(
        key, direct(lambda sample: on_change(str(sample.key_expr), sample.kind == put)), history=True
    )


def tokens(session: Any, key: str, timeout: float = 1.0) -> list[str]:
    """Keys of the liveliness tokens that are there now and match a key expression."""
    replies = session.liveliness().get(key, timeout=timeout)
    return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]


class Reply(NamedTuple):
    """One reply to a query: its key, and either the payload, with its attachment, or the payload of an error."""

    key: str
    payload: bytes | None
    error: bytes | None
    attachment: bytes | None


def get_replies(
    session: Any,
    selector: str,
    timeout: float,
    on_reply: Callable[[Reply], None],
    on_finished: Callable[[], None],
    *,
    payload: bytes | bytearray | None = None,
    encoding: str | None = None,
    priority: str = "INTERACTIVE_HIGH",
    is_dropped: bool = False,
) -> None:
    """Send a query whose replies may be several on one key.

    Args:
        session: raw Zenoh session.
        selector: key expression, with parameters if any.
        timeout: time after which Zenoh ends the stream with an error reply [s].
        on_reply: called on Zenoh's thread with each reply; access rules judge its key, so that it says whose it is.
        on_finished: called on Zenoh's thread after the last reply, also when there was none.
        payload: payload of the query.
        encoding: encoding of the payload.
        priority: priority of the query and, since Zenoh takes it from there, of the replies.
        is_dropped: drop query and replies on a congested link instead of waiting for it.
    """
    zenoh = _zenoh()

    def take(reply: Any) -> None:
        sample = reply.ok
        if sample is None:
            on_reply(Reply("", None, reply.err.payload.to_bytes(), None))
        else:
            attachment = None if sample.attachment is None else sample.attachment.to_bytes()
            on_reply(Reply(str(sample.key_expr), sample.payload.to_bytes(), None, attachment))

    session.get(
        selector,
        direct(take, on_finished),
        payload=payload,
        encoding=encoding,
        timeout=timeout,
        congestion_control=zenoh.CongestionControl.DROP if is_dropped else None,
        priority=getattr(zenoh.Priority, priority),
        consolidation=zenoh.ConsolidationMode.NONE,
    )


def declare_queryable(session: Any, key: str, on_query: Callable[[Any], None]) -> Any:
    """A queryable with all there is on its key; `on_query` runs on Zenoh's thread and must not block."""
    return session.declare_queryable(key, direct(on_query), complete=True)

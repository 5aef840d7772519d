"""Calls into Zenoh, which is imported at the first call. Only this file uses parts that Zenoh marks as unstable."""

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
    """Return the base class of Zenoh's errors."""
    error: type[Exception] = _zenoh().ZError
    return error


def error_text(error: Exception) -> str:
    """Return the text of a Zenoh error, without the appended source location."""
    return str(error).split(" at /", 1)[0].strip()


def open_raw(configuration: Mapping[str, Any] | str) -> Any:
    """Open a Zenoh session from a configuration, given as nested mappings or JSON5 text."""
    text = configuration if isinstance(configuration, str) else json.dumps(configuration)
    return _zenoh().open(_zenoh().Config.from_json5(text))


def configuration_value(text: str, key: str) -> Any:
    """Return one value of a JSON5 configuration text, or None if it is not set; `key` is a path with slashes."""
    return json.loads(_zenoh().Config.from_json5(text).get_json(key))


def with_values(text: str, values: Mapping[str, Any]) -> str:
    """Return a JSON5 configuration text with some values replaced; the keys of `values` are paths with slashes."""
    configuration = _zenoh().Config.from_json5(text)
    for key, value in values.items():
        configuration.insert_json5(key, json.dumps(value))
    return str(configuration)


def direct(callback: Callable[[Any], None], finished: Callable[[], None] | None = None) -> Any:
    """Make a handler that runs `callback` directly on Zenoh's receiving thread, and `finished` after the last call.

    Neither function may block. The handler uses no Python thread, so it does not keep the interpreter alive. Exceptions
    are reported and not raised.
    """
    ending = None if finished is None else guarded(finished)
    return _zenoh().handlers.Callback(guarded(callback), ending, indirect=False)


def declare_publisher(session: Any, key: str, priority: str, encoding: str | None = None) -> Any:
    """Declare a publisher that drops samples only for readers whose link is congested.

    If a link has no room, a put waits at most the configured time, then drops the sample for that link (see
    `transport.configuration`). Blocking modes are not used, because a put that blocks for one reader delays all others.
    `BLOCK_FIRST` and the cache of the advanced publisher even block Zenoh's own threads, which stops the links of
    healthy readers.

    Args:
        session: raw Zenoh session.
        key: key on which to publish.
        priority: name of a Zenoh priority; each priority has its own queue on each link.
        encoding: Zenoh encoding of all payloads; None = unspecified.
    """
    zenoh = _zenoh()
    return session.declare_publisher(
        key,
        congestion_control=zenoh.CongestionControl.DROP,
        priority=getattr(zenoh.Priority, priority),
        encoding=encoding,
    )


def source_of(entity: Any) -> str:
    """Return the identity of a publisher as two chunks of a key: the id of its session and its own id."""
    return f"{entity.zid}/{entity.eid}"


class Stamps:
    """Generator of strictly increasing timestamps for one publisher, under a random identity.

    Attributes:
        source: identity of the publisher as two chunks of a key, in the form that advanced subscribers expect from
            publishers that use timestamps.
    """

    def __init__(self) -> None:
        self._id = _zenoh().TimestampId(uuid.uuid4().bytes)
        self._last = datetime.min.replace(tzinfo=UTC)
        self.source = f"{self._id}/uhlc"

    def next(self) -> Any:
        """Return the timestamp of the next sample."""
        self._last = max(datetime.now(UTC), self._last + timedelta(microseconds=1))
        return _zenoh().Timestamp(self._last, self._id)


def has_subscribers(publisher: Any) -> bool:
    """Return True if a publisher has subscribers, as far as this session knows."""
    return bool(publisher.matching_status.matching)


def put(
    publisher: Any, payload: bytes | bytearray, attachment: bytes | None, number: int, timestamp: Any = None
) -> None:
    """Publish a payload with a number, by which receivers detect losses; a timestamp, if given, replaces the number."""
    if timestamp is not None:
        publisher.put(payload, attachment=attachment, timestamp=timestamp)
    else:
        publisher.put(payload, attachment=attachment, source_info=_zenoh().SourceInfo(publisher.id, number))


def number_of(sample: Any) -> tuple[str, int] | None:
    """Return the source (as in `source_of`) and number of a received sample; None if the sample contains neither."""
    info = sample.source_info
    return None if info is None else (source_of(info.source_id), int(info.source_sn))


def declare_subscriber(session: Any, key: str, on_sample: Callable[[Any], None]) -> Any:
    """Declare a subscriber; `on_sample` runs on Zenoh's thread and must not block."""
    return session.declare_subscriber(key, direct(on_sample))


def declare_token(session: Any, key: str) -> Any:
    """Declare a liveliness token, which disappears for other sessions when this one closes, dies or hangs."""
    return session.liveliness().declare_token(key)


def watch_tokens(session: Any, key: str, on_change: Callable[[str, bool], None]) -> Any:
    """Declare a subscriber to liveliness tokens; `on_change(key, is_alive)` runs on Zenoh's thread."""
    put = _zenoh().SampleKind.PUT
    return session.liveliness().declare_subscriber(
        key, direct(lambda sample: on_change(str(sample.key_expr), sample.kind == put)), history=True
    )


def tokens(session: Any, key: str, timeout: float) -> list[str]:
    """Return the keys of the current liveliness tokens that match a key expression; `timeout` is in [s]."""
    replies = session.liveliness().get(key, timeout=timeout)
    return [str(reply.ok.key_expr) for reply in replies if reply.ok is not None]


class Reply(NamedTuple):
    """Reply to a query, or the end of the query.

    Attributes:
        key: key of the reply. If access control is enabled, it identifies the sender, because access rules restrict who
            may use the key.
        payload: payload of the reply; None for an error.
        error: payload of an error, or None.
        attachment: attachment of the reply, or None.
        end: reason why no more replies follow; empty for a reply.
    """

    key: str = ""
    payload: bytes | None = None
    error: bytes | None = None
    attachment: bytes | None = None
    end: str = ""


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
    """Send a query; if there are several replies on one key, all are delivered.

    Args:
        session: raw Zenoh session.
        selector: key expression, with parameters if there are any.
        timeout: time after which Zenoh ends the query with an error reply [s].
        on_reply: called on Zenoh's thread with each reply.
        on_finished: called on Zenoh's thread after the last reply, even if there was none.
        payload: payload of the query.
        encoding: Zenoh encoding of the payload.
        priority: name of the Zenoh priority of the query and its replies.
        is_dropped: True = drop query and replies on a congested link instead of waiting.
    """
    zenoh = _zenoh()

    def take(reply: Any) -> None:
        sample = reply.ok
        if sample is None:
            on_reply(Reply(error=reply.err.payload.to_bytes()))
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
    """Declare a complete queryable; `on_query` runs on Zenoh's thread and must not block."""
    return session.declare_queryable(key, direct(on_query), complete=True)

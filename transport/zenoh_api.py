"""The only file that names parts of Zenoh which its makers mark unstable; imports Zenoh when first used."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

from transport.supervision import guarded

# Names below `zenoh` that this file relies on and that a new release may change.
UNSTABLE = ("handlers.Callback", "Publisher.id", "Publisher.matching_status", "SourceInfo", "SessionInfo.links")


def _zenoh() -> Any:
    import zenoh

    return zenoh


def missing_names() -> tuple[str, ...]:
    """The names of `UNSTABLE` that the installed Zenoh does not have; empty when all is well."""
    import zenoh.handlers

    missing = []
    for name in UNSTABLE:
        found: Any = zenoh
        for attribute in name.split("."):
            found = getattr(found, attribute, None)
        if found is None:
            missing.append(name)
    return tuple(missing)


def zenoh_error() -> type[Exception]:
    """The one class of all errors of Zenoh."""
    error: type[Exception] = _zenoh().ZError
    return error


def error_text(error: Exception) -> str:
    """Zenoh's own words, without the source lines that it appends."""
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
        encoding: encoding of all payloads, see `transport.messages.encodings`; None says nothing.
    """
    zenoh = _zenoh()
    return session.declare_publisher(
        key,
        congestion_control=zenoh.CongestionControl.DROP,
        priority=getattr(zenoh.Priority, priority),
        encoding=encoding,
    )


def source_of(publisher: Any) -> str:
    """The identity of a publisher as two chunks of a key: the id of its session and its own."""
    return f"{publisher.id.zid}/{publisher.id.eid}"


def has_subscribers(publisher: Any) -> bool:
    """Whether somebody has subscribed to what a publisher sends, as far as is known here now."""
    return bool(publisher.matching_status.matching)


def put(publisher: Any, payload: bytes | bytearray, attachment: bytes | None, number: int) -> None:
    """Send one payload with its number, by which receivers notice losses."""
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


def get_replies(
    session: Any,
    key: str,
    payload: bytes | bytearray,
    timeout: float,
    on_reply: Callable[[str, bytes | None, bytes | None], None],
    on_finished: Callable[[], None],
    *,
    priority: str = "INTERACTIVE_HIGH",
    encoding: str | None = None,
) -> None:
    """Send a query whose replies may be several on one key.

    Args:
        session: raw Zenoh session.
        key: key expression.
        payload: payload of the query.
        timeout: [s] after which Zenoh ends the stream with an error reply.
        on_reply: called on Zenoh's thread with (key, payload, None) or ("", None, error payload); access rules judge
            the key, so that it says whose answer it is.
        on_finished: called on Zenoh's thread after the last reply, also when there was none.
        priority: priority of the query and, since Zenoh takes it from there, of the replies.
        encoding: encoding of the payload.
    """
    zenoh = _zenoh()

    def take(reply: Any) -> None:
        if reply.ok is not None:
            on_reply(str(reply.ok.key_expr), reply.ok.payload.to_bytes(), None)
        else:
            on_reply("", None, reply.err.payload.to_bytes())

    session.get(
        key,
        direct(take, on_finished),
        payload=payload,
        encoding=encoding,
        timeout=timeout,
        priority=getattr(zenoh.Priority, priority),
        consolidation=zenoh.ConsolidationMode.NONE,
    )


def get_pieces(
    session: Any,
    selector: str,
    timeout: float,
    on_piece: Callable[[str, bytes, bytes], None],
    on_finished: Callable[[], None],
) -> None:
    """Ask for pieces of messages; nobody waits for this side when its link is congested, the piece is dropped.

    Args:
        session: raw Zenoh session.
        selector: key expression and parameters.
        timeout: [s] after which Zenoh ends the stream.
        on_piece: called on Zenoh's thread with the key, the attachment and the payload of each reply.
        on_finished: called on Zenoh's thread after the last reply, also when there was none.
    """
    zenoh = _zenoh()

    def take(reply: Any) -> None:
        sample = reply.ok
        if sample is not None and sample.attachment is not None:
            on_piece(str(sample.key_expr), sample.attachment.to_bytes(), sample.payload.to_bytes())

    session.get(
        selector,
        direct(take, on_finished),
        timeout=timeout,
        congestion_control=zenoh.CongestionControl.DROP,
        priority=zenoh.Priority.DATA_HIGH,
        consolidation=zenoh.ConsolidationMode.NONE,
    )


def declare_queryable(session: Any, key: str, on_query: Callable[[Any], None]) -> Any:
    """A queryable with all there is on its key; `on_query` runs on Zenoh's thread and must not block."""
    return session.declare_queryable(key, direct(on_query), complete=True)

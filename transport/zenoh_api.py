"""The only file that names parts of Zenoh which its makers mark unstable; imports Zenoh when first used."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from typing import Any

# [s] A publisher repeats its last sequence number this often, so that a lost last sample is noticed. Always, not only
# after a change: on a congested link the heartbeat after the last sample is lost as well, and with it, in two of
# three runs over 20 Mbit/s, the last sample for ever.
HEARTBEAT = 0.5

# Names below `zenoh` that this file relies on and that a new release may change.
UNSTABLE = (
    "CongestionControl.BLOCK_FIRST",
    "handlers.Callback",
    "ext.declare_advanced_publisher",
    "ext.declare_advanced_subscriber",
    "ext.CacheConfig",
    "ext.HistoryConfig",
    "ext.MissDetectionConfig",
    "ext.RecoveryConfig",
    "ext.RepliesConfig",
    "ext.AdvancedSubscriber.sample_miss_listener",
    "SessionInfo.links",
)


def _zenoh() -> Any:
    import zenoh

    return zenoh


def missing_names() -> tuple[str, ...]:
    """The names of `UNSTABLE` that the installed Zenoh does not have; empty when all is well."""
    import zenoh.ext
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

    No Python thread stands behind it, so nothing keeps the interpreter from ending.
    """
    return _zenoh().handlers.Callback(callback, finished, indirect=False)


def declare_latched_publisher(session: Any, key: str) -> Any:
    """A publisher with memory: late joiners get its last sample, losses are noticed, no put waits long."""
    import zenoh.ext

    return zenoh.ext.declare_advanced_publisher(
        session,
        key,
        congestion_control=zenoh.CongestionControl.BLOCK_FIRST,
        priority=zenoh.Priority.DATA_HIGH,
        cache=zenoh.ext.CacheConfig(
            1,
            # By default the fragments of a large reply are dropped on a link that is slow.
            replies_config=zenoh.ext.RepliesConfig(
                congestion_control=zenoh.CongestionControl.BLOCK_FIRST, priority=zenoh.Priority.DATA_HIGH
            ),
        ),
        publisher_detection=True,
        sample_miss_detection=zenoh.ext.MissDetectionConfig(heartbeat=HEARTBEAT, sporadic_heartbeat=None),
    )


def declare_plain_publisher(session: Any, key: str) -> Any:
    """A publisher without memory, whose samples may be dropped on a congested link."""
    return session.declare_publisher(key, congestion_control=_zenoh().CongestionControl.DROP)


def declare_latched_subscriber(
    session: Any, key: str, on_sample: Callable[[Any], None], on_miss: Callable[[int], None]
) -> tuple[Any, Any]:
    """A subscriber that asks publishers for their last sample and recovers a lost one.

    Args:
        session: raw Zenoh session.
        key: key expression.
        on_sample: called on Zenoh's thread with each sample.
        on_miss: called on Zenoh's thread with the number of samples that were lost for good.

    Returns:
        The subscriber and its miss listener; both must be kept.
    """
    import zenoh.ext

    subscriber = zenoh.ext.declare_advanced_subscriber(
        session,
        key,
        direct(on_sample),
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
        recovery=zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
    )
    return subscriber, subscriber.sample_miss_listener(direct(lambda miss: on_miss(int(miss.nb))))


def declare_token(session: Any, key: str) -> Any:
    """A liveliness token: others see it vanish when this session closes, dies or hangs."""
    return session.liveliness().declare_token(key)


def watch_tokens(session: Any, key: str, on_change: Callable[[str, bool], None]) -> Any:
    """A subscriber to liveliness tokens; `on_change(key, is_alive)` runs on Zenoh's thread."""
    put = _zenoh().SampleKind.PUT
    return session.liveliness().declare_subscriber(
        key, direct(lambda sample: on_change(str(sample.key_expr), sample.kind == put)), history=True
    )


def get_replies(
    session: Any,
    key: str,
    payload: bytes | bytearray,
    timeout: float,
    on_reply: Callable[[bytes | None, bytes | None], None],
    on_finished: Callable[[], None],
) -> None:
    """Send a query whose replies may be several on one key.

    Args:
        session: raw Zenoh session.
        key: key expression.
        payload: of the query.
        timeout: [s] after which Zenoh ends the stream with an error reply.
        on_reply: called on Zenoh's thread with (payload, None) or (None, error payload).
        on_finished: called on Zenoh's thread after the last reply, also when there was none.
    """
    zenoh = _zenoh()

    def sort(reply: Any) -> None:
        if reply.ok is not None:
            on_reply(reply.ok.payload.to_bytes(), None)
        else:
            on_reply(None, reply.err.payload.to_bytes())

    session.get(
        key,
        direct(sort, on_finished),
        payload=payload,
        timeout=timeout,
        priority=zenoh.Priority.INTERACTIVE_HIGH,
        consolidation=zenoh.ConsolidationMode.NONE,
    )


def declare_queryable(session: Any, key: str, on_query: Callable[[Any], None]) -> Any:
    """A queryable with all there is on its key; `on_query` runs on Zenoh's thread, must not block."""
    return session.declare_queryable(key, direct(on_query), complete=True)

"""Others who have the name of a node, or want it: what the node's status says of them."""

from __future__ import annotations

from collections.abc import Callable

from transport.keys import claim_key, run_key
from transport.links.liveliness import TokenWatcher
from transport.links.session import Session
from transport.messages.status_message import StatusItem
from transport.messages.terrain_message import Health


class NameWatch:
    """Watches the tokens of a name; a session's end ends it too."""

    def __init__(self, session: Session, robot: str, run: str, on_change: Callable[[], None]) -> None:
        """Watch from now on.

        Args:
            session: open session of the node.
            robot: instance name.
            run: identity of the node's own run.
            on_change: runs on Zenoh's thread and must not block.
        """
        self._robot, self._run = robot, run
        self._claims = TokenWatcher(session, claim_key(robot), lambda _: on_change())
        # Over an uplink that was down when the name was claimed another node may come into sight later.
        self._runs = TokenWatcher(session, run_key(robot), lambda _: on_change())

    def items(self) -> list[StatusItem]:
        """Empty when nobody else is there."""
        if self._runs.names - {self._run}:
            level, message = (
                Health.ERROR,
                (
                    f"another node lives under the name {self._robot!r}, beyond an uplink: readers there take the "
                    "grids of one of the two. Give one of them another name"
                ),
            )
        elif self._claims.names:
            level, message = (
                Health.WARN,
                (
                    f"another node wants the name {self._robot!r} and waits until this one is gone: one robot has one "
                    "node. Stop one of the two, or give it another name"
                ),
            )
        else:
            return []
        return [StatusItem(name="name", level=level, message=message, hardware_id=self._robot)]

    def close(self) -> None:
        """Stop watching; safe to call twice."""
        self._claims.close()
        self._runs.close()

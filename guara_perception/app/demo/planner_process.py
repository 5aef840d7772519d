"""Runs the demo's planner in a second process and asks it for footholds."""

from __future__ import annotations

import json
import subprocess
import sys
from types import TracebackType
from typing import Any, Self

from guara_perception.exceptions import PlannerFailed
from transport.supervision import supervised

START_TIMEOUT_S = 60.0
# Longer than the planner itself waits for the two grids of a step, so that its own error is reported.
ANSWER_TIMEOUT_S = 130.0
STOP_TIMEOUT_S = 10.0


class PlannerProcess:
    """The other process; use it in a `with` block. It gets grids over Zenoh only, and only questions over its pipe."""

    def __init__(self, endpoint: str, robot: str) -> None:
        """Start it and wait until it is connected.

        Raises:
            PlannerFailed: it did not come up.
        """
        self._process = subprocess.Popen(
            [sys.executable, "-m", "guara_perception.app.demo.planner", endpoint, robot],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            self._read(START_TIMEOUT_S)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def choose(self, *, step: int, leg: str, x: float, y: float, extent: str = "footprint") -> dict[str, Any]:
        """Ask for a foothold near (x, y) [m in base_footprint of that step]; see `planner` for the answer.

        Raises:
            PlannerFailed: the process died or does not answer.
        """
        pipe = self._process.stdin
        request = {"step": step, "leg": leg, "x": x, "y": y, "extent": extent}
        try:
            if pipe is not None:
                pipe.write(json.dumps(request) + "\n")
                pipe.flush()
        except (OSError, ValueError):  # the pipe is broken, or was closed
            raise PlannerFailed(f"the planner process ended (exit code {self._process.poll()})") from None
        return self._read(ANSWER_TIMEOUT_S)

    def close(self) -> None:
        """End it; safe to call twice."""
        if self._process.stdin is not None:
            try:
                self._process.stdin.close()
            except BrokenPipeError:
                pass
        try:
            self._process.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._process.stdout is not None:
            self._process.stdout.close()

    def _read(self, timeout: float) -> dict[str, Any]:
        lines: list[str] = []
        stdout = self._process.stdout
        reader = supervised(
            "planner's answer", lambda: lines.append(stdout.readline() if stdout else ""), restarts=None
        )
        reader.start()
        reader.join(timeout)
        if not lines or not lines[0]:
            if reader.is_alive():
                self._process.kill()
                raise PlannerFailed(f"the planner process did not answer within {timeout:g} s")
            raise PlannerFailed(f"the planner process ended (exit code {self._process.wait()})")
        answer: dict[str, Any] = json.loads(lines[0])
        return answer

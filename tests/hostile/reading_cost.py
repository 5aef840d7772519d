"""Memory and processor time that each file made to harm its reader costs before it is refused.

`python -m tests.hostile.reading_cost [--json]`.
"""

from __future__ import annotations

import dataclasses
import json
import os
import resource
import sys
import tempfile
import time
import traceback
from pathlib import Path

from tests.hostile.harmful_files import FILES

MEMORY_MB = 300.0
SECONDS = 5.0


@dataclasses.dataclass(frozen=True, slots=True)
class Cost:
    """What reading one file took, in a process of its own.

    Attributes:
        name: name of the file.
        size: size of the file, or of all files in its folder [byte].
        memory: peak above the process after its imports [byte].
        seconds: processor time.
        outcome: "refused: ..." with the message of one of our errors, "read", or "TRACEBACK ...".
    """

    name: str
    size: int
    memory: int
    seconds: float
    outcome: str

    @property
    def is_within(self) -> bool:
        """Whether it stayed within the limits and was read, or refused with a message."""
        is_handled = self.outcome.startswith(("refused", "read"))
        return is_handled and self.memory <= MEMORY_MB * 1e6 and self.seconds <= SECONDS


def _high_water() -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith("VmHWM"):
            return int(line.split()[1]) * 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _imports() -> None:
    import cv2  # noqa: F401
    import mcap.reader  # noqa: F401
    import ruamel.yaml  # noqa: F401
    import zenoh  # noqa: F401
    import zstandard  # noqa: F401

    import guara_perception as gp  # noqa: F401
    from kinematics import load_robot
    from transport.messages.typestore import warm_up

    load_robot("guara")
    warm_up()


def measure(name: str) -> Cost:
    """Make one of `FILES` and read it in a process of its own, which has its imports done."""
    from guara_perception.exceptions import PerceptionError
    from kinematics import KinematicsError
    from transport import TransportError

    filename, make, read = FILES[name]
    _imports()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / filename
        maker = os.fork()
        if not maker:
            make(path)
            os._exit(0)
        os.waitpid(maker, 0)
        files = [path] if path.is_file() else list(path.rglob("*"))
        size = sum(file.stat().st_size for file in files)
        receiver, sender = os.pipe()
        reader = os.fork()
        if not reader:
            Path("/proc/self/clear_refs").write_text("5")
            before, start = _high_water(), time.process_time()
            try:
                read(path)
                outcome = "read"
            except (PerceptionError, KinematicsError, TransportError) as error:
                outcome = f"refused: {str(error).replace(folder + '/', '')}"
            except BaseException as error:
                outcome = f"TRACEBACK {type(error).__name__}: {error}"
                traceback.print_exc()
            answer = json.dumps([_high_water() - before, time.process_time() - start, outcome[:300]])
            os.write(sender, answer.encode())
            os._exit(0)
        os.close(sender)
        with os.fdopen(receiver) as pipe:
            text = pipe.read()
        _, status = os.waitpid(reader, 0)
    if not text:
        return Cost(name, size, 0, 0.0, f"DIED of signal {os.waitstatus_to_exitcode(status)}")
    memory, seconds, outcome = json.loads(text)
    return Cost(name, size, memory, seconds, outcome)


def main() -> None:
    """Print a line per file, or with --json an object per line."""
    is_met = True
    for name in FILES:
        cost = measure(name)
        if "--json" in sys.argv:
            print(json.dumps(dataclasses.asdict(cost)), flush=True)
            continue
        is_met &= cost.is_within
        mark = "ok  " if cost.is_within else "FAIL"
        figures = f"{cost.memory / 1e6:6.1f} MB {cost.seconds:5.2f} s  {cost.size / 1e3:8.0f} kB"
        print(f"{mark} {figures}  {name}: {cost.outcome[:110]}", flush=True)
    sys.exit(0 if is_met else 1)


if __name__ == "__main__":
    main()

"""Zenoh relay for a gait in a language without a Zenoh client: passes its messages and clock answers to the node.

Start `guara run --simulated --gait external` in one terminal and this in another:

    python examples/relay_gait.py tcp/127.0.0.1:7447 node examples/javascript/gait.mjs stance.json 3 6

The program prints lines `KEY PAYLOAD` (hexadecimal), each of which is put on KEY. Each query for the gait's clock is
passed to it as a line `clock`; its next payload with the key of the clock is the answer.
"""

import argparse
import queue
import subprocess
import sys
import threading

import zenoh

CLOCK = "guara/gait/v1/clock"


def main() -> int:
    """Relay until the program ends; return its exit code."""
    parser = argparse.ArgumentParser()
    parser.add_argument("endpoint")
    parser.add_argument("command", nargs=argparse.REMAINDER)
    options = parser.parse_args()
    configuration = zenoh.Config()
    configuration.insert_json5("mode", '"client"')
    configuration.insert_json5("connect/endpoints", f'["{options.endpoint}"]')
    clock_answers: queue.Queue[bytes] = queue.Queue()
    one_query = threading.Lock()
    gait = subprocess.Popen(options.command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    assert gait.stdin is not None and gait.stdout is not None
    lines = gait.stdin

    def answer(query: zenoh.Query) -> None:
        with one_query:
            lines.write("clock\n")
            lines.flush()
            query.reply(CLOCK, clock_answers.get(timeout=5.0))

    with zenoh.open(configuration) as session:
        session.declare_queryable(CLOCK, answer)
        for line in gait.stdout:
            key, payload = line.split()
            if key == CLOCK:
                clock_answers.put(bytes.fromhex(payload))
            else:
                session.put(key, bytes.fromhex(payload))
    return gait.wait()


if __name__ == "__main__":
    sys.exit(main())

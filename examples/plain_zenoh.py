"""Newest grid received with Zenoh alone, as in a program in any language; the payload is written to a file.

    python examples/plain_zenoh.py tcp/127.0.0.1:7447 guara/perception/v1/terrain terrain.cdr

Endpoint, key and file are arguments; any key with grids may be given.
"""

import sys

import zenoh

if len(sys.argv) != 4:
    print(f"{len(sys.argv) - 1} arguments given; usage: python {sys.argv[0]} ENDPOINT KEY FILE", file=sys.stderr)
    sys.exit(2)
endpoint, key, file = sys.argv[1:]
configuration = zenoh.Config()
configuration.insert_json5("mode", '"client"')
configuration.insert_json5("connect/endpoints", f'["{endpoint}"]')
with zenoh.open(configuration) as session:
    # The subscriber receives what is published from now on; a query on the same key fetches the last grid.
    subscriber = session.declare_subscriber(key)
    for reply in session.get(key, timeout=5.0):
        if reply.ok is not None:
            sample = reply.ok
            break
    else:
        sample = subscriber.recv()
    with open(file, "wb") as payload:
        payload.write(sample.payload.to_bytes())
    print(f"{sample.key_expr}: {len(sample.payload)} bytes of {sample.encoding}")

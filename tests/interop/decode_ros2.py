"""Decodes every message of a recording with rclpy; run by the Python of `.venv-ros`, says what it found as JSON."""

import importlib
import json
import sys
from pathlib import Path

from mcap.reader import make_reader
from rclpy.serialization import deserialize_message, serialize_message

HEADER = 4


def main(recording: str, share: list[str]) -> None:
    counts: dict[str, int] = {}
    facts: dict[str, int] = {}
    differing: dict[str, int] = {}
    hashes: dict[str, str] = {}
    with open(recording, "rb") as file:
        for schema, channel, message in make_reader(file).iter_messages():
            package, _, name = schema.name.split("/")
            kind = getattr(importlib.import_module(f"{package}.msg"), name)
            body = deserialize_message(message.data, kind)
            # Padding may hold anything: what is decoded again must be the same.
            again = deserialize_message(serialize_message(body), kind)
            if again != body and "nan" not in str(body):
                differing[channel.topic] = differing.get(channel.topic, 0) + 1
            counts[channel.topic] = counts.get(channel.topic, 0) + 1
            if name == "PointCloud2":
                facts[channel.topic] = body.width
            elif name == "TFMessage":
                facts[channel.topic] = len(body.transforms)
            elif name == "OccupancyGrid":
                facts[channel.topic] = len(body.data)
            if schema.name not in hashes:
                hashes[schema.name] = type_hash(package, name, share)
    print(json.dumps({"counts": counts, "facts": facts, "differing": differing, "hashes": hashes}))


def type_hash(package: str, name: str, share: list[str]) -> str:
    """The type hash that rosidl computed when the package was built."""
    for folder in share:
        path = Path(folder) / "share" / package / "msg" / f"{name}.json"
        if path.is_file():
            table = json.loads(path.read_text())["type_hashes"]
            return next(item["hash_string"] for item in table if item["type_name"] == f"{package}/msg/{name}")
    raise FileNotFoundError(f"{package}/msg/{name}.json")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])

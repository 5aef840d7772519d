// Decodes every message of a recording with Foxglove's libraries; says how many of each topic, as one JSON object.
import { open } from "node:fs/promises";
import { loadDecompressHandlers } from "@mcap/support";
import { FileHandleReadable } from "@mcap/nodejs";
import { McapIndexedReader } from "@mcap/core";
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";

const file = await open(process.argv[2], "r");
const reader = await McapIndexedReader.Initialize({
  readable: new FileHandleReadable(file),
  decompressHandlers: await loadDecompressHandlers(),
});
const readers = new Map();
const counts = {};
const facts = {};
for await (const message of reader.readMessages()) {
  const channel = reader.channelsById.get(message.channelId);
  const schema = reader.schemasById.get(channel.schemaId);
  if (!readers.has(schema.name)) {
    const definitions = parse(new TextDecoder().decode(schema.data), { ros2: true });
    readers.set(schema.name, new MessageReader(definitions));
  }
  const body = readers.get(schema.name).readMessage(message.data);
  counts[channel.topic] = (counts[channel.topic] ?? 0) + 1;
  if (!channel.metadata.get("offered_qos_profiles")) throw new Error(`${channel.topic} says no QoS`);
  if (schema.name === "sensor_msgs/msg/PointCloud2") facts[channel.topic] = body.width;
  if (schema.name === "tf2_msgs/msg/TFMessage") facts[channel.topic] = body.transforms.length;
  if (schema.name === "nav_msgs/msg/OccupancyGrid") facts[channel.topic] = body.data.length;
}
console.log(JSON.stringify({ profile: reader.header.profile, counts, facts }));
await file.close();

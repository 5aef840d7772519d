// Gait controller in JavaScript: node gait.mjs STANCE.json PAUSES SECONDS. It announces stance pauses as
// `guara_msgs/StancePause`, streams the joints as `guara_msgs/StanceStream` and reports the clock of their stamps. It prints
// messages as lines `KEY PAYLOAD` (hexadecimal), and answers each line `clock` on standard input with the current time.
// examples/relay_gait.py relays these lines; a gait with a Zenoh client needs no relay.
import { randomUUID } from "node:crypto";
import { readFileSync } from "node:fs";
import { createInterface } from "node:readline";
import { setTimeout as sleep } from "node:timers/promises";
import { writer } from "./terrain.mjs";

const BEGIN = 1, END = 2, HOLD = 3;
// Interval between two HOLDs and sampling period of the joint stream [s], noise of an encoder [rad].
const HOLD_PERIOD = 0.05, SAMPLE_PERIOD = 0.005, ENCODER_NOISE = 0.0002;
const [file, pauses, seconds] = process.argv.slice(2);
const { joint_positions: posture, support_feet: feet } = JSON.parse(readFileSync(file, "utf8"));
const pauseWriter = writer("StancePause"), streamWriter = writer("StanceStream");
const epoch = randomUUID();

// Clock of the joints' stamps, as `builtin_interfaces/Time`.
function now() {
  const milliseconds = performance.timeOrigin + performance.now();
  return { sec: Math.floor(milliseconds / 1000), nanosec: Math.floor((milliseconds % 1000) * 1e6) };
}

function send(key, payload) {
  process.stdout.write(`${key} ${Buffer.from(payload).toString("hex")}\n`);
}

// CDR of a time, twelve bytes: header, seconds, nanoseconds.
function tellClock() {
  const payload = Buffer.from([0, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0]);
  const { sec, nanosec } = now();
  payload.writeInt32LE(sec, 4);
  payload.writeUInt32LE(nanosec, 8);
  send("guara/gait/v1/clock", payload);
}

// Each message has new joint readings; here they are the posture with encoder noise.
function joints() {
  const noise = () => ENCODER_NOISE * Math.sqrt(-2 * Math.log(1 - Math.random())) * Math.cos(2 * Math.PI * Math.random());
  return Object.values(posture).map((angle) => angle + noise());
}

// Samples since the last batch, each with its stamp. A batch is sent with each announcement.
let samples = [], batches = 0;
const seconds_of = ({ sec, nanosec }, since) => sec - since.sec + (nanosec - since.nanosec) * 1e-9;
function sample() {
  const stamp = now();
  if (samples.length === 0 || seconds_of(stamp, samples.at(-1).stamp) > 0) samples.push({ stamp, joint_positions: joints() });
}

function stream() {
  sample();
  const stamp = samples[0].stamp;
  const not_measured = Array(3 * samples.length).fill(NaN); // without an IMU, all values are NaN; the array must not be empty
  const message = {
    header: { stamp, frame_id: "base_link" }, robot: "guara", epoch, sequence: BigInt(batches++), joint_names: Object.keys(posture), legs: feet,
    times: samples.map((each) => seconds_of(each.stamp, stamp)), joint_positions: samples.flatMap((each) => each.joint_positions),
    supports: new Uint8Array(samples.length * feet.length).fill(1), gravity_in_base: not_measured, angular_velocity: not_measured,
  };
  samples = [];
  send("guara/gait/v1/stance_stream", streamWriter.writeMessage(message));
}

function say(step, phase, time_available = 0) {
  const stamp = now();
  const stance = {
    joint_names: Object.keys(posture),
    joint_positions: joints(),
    support_feet: feet,
    gravity_known: false,
    gravity_in_base: { x: 0, y: 0, z: 0 },
  };
  const header = { stamp, frame_id: "base_footprint" };
  const message = { header, robot: "guara", step: BigInt(step), phase, stance, time_available, known_ground: [], epoch };
  send("guara/gait/v1/stance", pauseWriter.writeMessage(message));
  stream();
}

createInterface({ input: process.stdin }).on("line", (line) => line === "clock" && tellClock());
setInterval(sample, 1000 * SAMPLE_PERIOD);
for (let step = 0; step < Number(pauses); step++) {
  say(step, BEGIN, Number(seconds));
  for (const end = performance.now() + 1000 * Number(seconds); performance.now() < end; await sleep(1000 * HOLD_PERIOD)) say(step, HOLD);
  say(step, END);
  await sleep(1000);
}
process.exit(0);

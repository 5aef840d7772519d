// Reader of grids and their cells: payloads of `<robot>/perception/v1/terrain` or `/map`, lossless or compact.
import { readFileSync, readdirSync } from "node:fs";
import { join } from "node:path";
import { fileURLToPath } from "node:url";
import { parse } from "@foxglove/rosmsg";
import { MessageReader, MessageWriter } from "@foxglove/rosmsg2-serialization";
import { decompress } from "fzstd";

const DEFINITIONS = fileURLToPath(new URL("../../transport/msg", import.meta.url));
const FRAME_MAGIC = [0x28, 0xb5, 0x2f, 0xfd];
// Flags of `hazard` of an unknown cell; all other flags are hazards of known ground.
export const UNKNOWN = 0x003f;
// Required layers, and their types.
const NEEDED = { elevation: 1, traversability: 1, hazard: 2 };

// Definition of a type and of all types in it, for the parser of ROS 2 definitions.
function definition(name, home) {
  const others = [["guara_msgs", DEFINITIONS]];
  const standard = join(DEFINITIONS, "standard");
  for (const entry of readdirSync(standard, { withFileTypes: true })) {
    if (entry.isDirectory()) others.push([entry.name, join(standard, entry.name)]);
  }
  let text = readFileSync(join(home, `${name}.msg`), "utf8");
  for (const [place, folder] of others) {
    for (const file of readdirSync(folder).filter((each) => each.endsWith(".msg") && each !== `${name}.msg`)) {
      text += `\n${"=".repeat(80)}\nMSG: ${place}/${file.slice(0, -4)}\n${readFileSync(join(folder, file), "utf8")}`;
    }
  }
  return parse(text, { ros2: true });
}

const reader = (name, home = DEFINITIONS) => new MessageReader(definition(name, home));
// Writer of messages of one type as CDR.
export const writer = (name, home = DEFINITIONS) => new MessageWriter(definition(name, home));

const terrainReader = reader("Terrain");
const summaryReader = reader("TerrainSummary");
const statusReader = reader("DiagnosticArray", join(DEFINITIONS, "standard", "diagnostic_msgs"));

// Decoder of the compact encoding: a zstd frame with the first bytes of all groups of four, then the second bytes, and so on.
export function plainCdr(payload) {
  if (!FRAME_MAGIC.every((byte, i) => payload[i] === byte)) return payload;
  const shuffled = decompress(payload);
  const count = Math.floor(shuffled.length / 4);
  const plain = new Uint8Array(shuffled.length);
  for (let byte = 0; byte < 4; byte++) {
    for (let i = 0; i < count; i++) plain[4 * i + byte] = shuffled[byte * count + i];
  }
  plain.set(shuffled.subarray(4 * count), 4 * count);
  return plain;
}

export function readTerrain(payload) {
  const terrain = terrainReader.readMessage(plainCdr(payload));
  if (terrain.version_major !== 1) throw new Error(`terrain message of version ${terrain.version_major}, 1 is read here`);
  const arrays = { 1: "float32_values", 2: "uint16_values", 3: "uint8_values" };
  terrain.layer = {};
  for (const { name, type, ...values } of terrain.layers) {
    const wanted = NEEDED[name];
    if (wanted !== undefined && type !== wanted) throw new Error(`layer ${name} has type ${type}, ${wanted} is read here`);
    // Skip layers of a type of a later version.
    if (!(type in arrays)) continue;
    const count = values[arrays[type]].length;
    if (count !== terrain.nx * terrain.ny) throw new Error(`layer ${name} has ${count} values`);
    terrain.layer[name] = values[arrays[type]];
  }
  const missing = Object.keys(NEEDED).filter((name) => !(name in terrain.layer));
  if (missing.length) throw new Error(`layers ${missing.join(", ")} are missing`);
  return terrain;
}

// Reader of the summary of a map (`<robot>/perception/v1/summary`): three layers, each a zstd frame of shuffled bytes.
export function readSummary(payload) {
  const summary = summaryReader.readMessage(payload);
  if (summary.version_major !== 1) throw new Error(`summary of version ${summary.version_major}, 1 is read here`);
  const count = summary.nx * summary.ny;
  const bytes = (name, size) => {
    const plain = decompress(summary[name]);
    if (plain.length !== size * count) throw new Error(`layer ${name} has ${plain.length} bytes`);
    return plain;
  };
  const [heights, hazard, traversability] = [bytes("heights", 2), bytes("hazard", 2), bytes("traversability", 1)];
  const at16 = (plain, i) => plain[i] | (plain[count + i] << 8);
  summary.layer = {
    hazard: Uint16Array.from({ length: count }, (_, i) => at16(hazard, i)),
    traversability: Float32Array.from(traversability, (value) => value / 255),
    elevation: Float32Array.from({ length: count }, (_, i) => {
      const millimetres = (at16(heights, i) << 16) >> 16;
      return millimetres === -32768 ? NaN : millimetres / 1000;
    }),
  };
  return summary;
}

// Values of the current status of the node: the reply to a query of `<robot>/perception/v1/status`, made before each use.
export function readStatus(payload) {
  const own = statusReader.readMessage(payload).status.find((item) => item.name === "transport");
  if (own === undefined) throw new Error("a status without the item transport");
  return Object.fromEntries(own.values.map(({ key, value }) => [key, value]));
}

// Reasons why a grid or summary may not be used, from the node's status queried after it arrived; empty if it may be used.
// If the node does not answer, neither may be used.
export function staleBecause(grid, status) {
  const said = grid.metadata === undefined ? grid : JSON.parse(grid.metadata);
  const because = said.withdrawn ? ["it was withdrawn"] : [];
  if (said.run !== status.run) return [...because, "it is of a run of the node that is over"];
  const own = Number(grid.step);
  const pauses = status.step === "" ? 0 : Number(status.step) - own;
  const age = Number(status.clock_s) - said.scan_end_clock;
  if (!(age <= grid.valid_for)) because.push(`it is ${age} s old; allowed: ${grid.valid_for} s`);
  if ((said.epoch ?? "") !== status.epoch) because.push("it is of another walk");
  else if (pauses > grid.valid_pauses) because.push(`it is ${pauses} ${pauses === 1 ? "pause" : "pauses"} old; allowed: ${grid.valid_pauses}`);
  if (said.provisional && (pauses > 0 || status.standing === "false")) because.push("its pause is over and did not confirm it");
  const isOvertaken = grid.extent === "footprint" && Number(status.last_scan_sequence) > Number(grid.sequence);
  if (isOvertaken && status.standing !== "") because.push("a newer one has been published");
  return because;
}

// Content of the cell at a position [m] in the grid's frame; outside the grid nothing is known. A point on the border of two
// cells belongs to the farther one; the margin protects against rounding errors: 0.70 - 0.50 is slightly less than 40 * 0.005.
export function cellAt(terrain, x, y) {
  const ix = Math.floor((x - terrain.origin_x) / terrain.resolution + 1e-6);
  const iy = Math.floor((y - terrain.origin_y) / terrain.resolution + 1e-6);
  if (!(ix >= 0 && ix < terrain.nx && iy >= 0 && iy < terrain.ny)) return { known: false, safe: false };
  const at = iy * terrain.nx + ix;
  const hazard = terrain.layer.hazard[at];
  return {
    known: (hazard & UNKNOWN) === 0,
    safe: hazard === 0 && terrain.layer.traversability[at] > 0,
    hazard,
    elevation: terrain.layer.elevation[at],
    traversability: terrain.layer.traversability[at],
  };
}

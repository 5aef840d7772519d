// Says what a payload holds, and what is known of a place: node read_terrain.mjs PAYLOAD X Y [STATUS]
// With the node's status of now, asked for after the payload, it also says whether a robot may step by it.
import { readFileSync } from "node:fs";
import { cellAt, readStatus, readTerrain, staleBecause } from "./terrain.mjs";

// What is refused ends in one line.
process.on("uncaughtException", (error) => {
  console.error(error.message);
  process.exit(1);
});
const [file, x, y, statusFile] = process.argv.slice(2);
const terrain = readTerrain(new Uint8Array(readFileSync(file)));
const safe = terrain.layer.hazard.filter((flags) => flags === 0).length;
console.log(`${terrain.robot}, ${terrain.extent} of step ${terrain.step}: ${terrain.nx} x ${terrain.ny} cells, ${safe} safe`);
const cell = cellAt(terrain, Number(x), Number(y));
if (statusFile === undefined) {
  console.log(JSON.stringify(cell));
} else {
  const because = staleBecause(terrain, readStatus(new Uint8Array(readFileSync(statusFile))));
  console.log(JSON.stringify({ ...cell, safe: cell.safe && because.length === 0 }));
  console.log(because.length ? `not to step by: ${because.join("; ")}` : "may be used");
}

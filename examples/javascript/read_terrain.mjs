// Prints what the payload of a grid contains, and what is known about a position: node read_terrain.mjs PAYLOAD X Y [STATUS]
// Given the node's status, queried after the payload arrived, it also prints if the grid may be used.
import { readFileSync } from "node:fs";
import { cellAt, readStatus, readTerrain, staleBecause } from "./terrain.mjs";

// Print errors as one line.
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

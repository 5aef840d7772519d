// Says what a payload holds, and what is known of a place: node read_terrain.mjs PAYLOAD X Y
import { readFileSync } from "node:fs";
import { cellAt, readTerrain } from "./terrain.mjs";

// What is refused ends in one line.
process.on("uncaughtException", (error) => {
  console.error(error.message);
  process.exit(1);
});
const [file, x, y] = process.argv.slice(2);
const terrain = readTerrain(new Uint8Array(readFileSync(file)));
const safe = terrain.layer.hazard.filter((flags) => flags === 0).length;
console.log(`${terrain.robot}, ${terrain.extent} of step ${terrain.step}: ${terrain.nx} x ${terrain.ny} cells, ${safe} safe`);
console.log(JSON.stringify(cellAt(terrain, Number(x), Number(y))));

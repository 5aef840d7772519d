// Says what the summary of a map holds, and what is known of a place: node read_summary.mjs PAYLOAD X Y
import { readFileSync } from "node:fs";
import { cellAt, readSummary } from "./terrain.mjs";

// What is refused ends in one line.
process.on("uncaughtException", (error) => {
  console.error(error.message);
  process.exit(1);
});
const [file, x, y] = process.argv.slice(2);
const summary = readSummary(new Uint8Array(readFileSync(file)));
const safe = summary.layer.hazard.filter((flags) => flags === 0).length;
console.log(`${summary.robot}, summary of step ${summary.step}: ${summary.nx} x ${summary.ny} cells, ${safe} safe`);
console.log(JSON.stringify(cellAt(summary, Number(x), Number(y))));

// Says what the summary of a map holds, and what is known of a place: node read_summary.mjs PAYLOAD X Y [STATUS]
// With the node's status of now, asked for after the payload, it also says whether a robot may step by it.
import { readFileSync } from "node:fs";
import { cellAt, readStatus, readSummary, staleBecause } from "./terrain.mjs";

// What is refused ends in one line.
process.on("uncaughtException", (error) => {
  console.error(error.message);
  process.exit(1);
});
const [file, x, y, statusFile] = process.argv.slice(2);
const summary = readSummary(new Uint8Array(readFileSync(file)));
const safe = summary.layer.hazard.filter((flags) => flags === 0).length;
console.log(`${summary.robot}, summary of step ${summary.step}: ${summary.nx} x ${summary.ny} cells, ${safe} safe`);
const cell = cellAt(summary, Number(x), Number(y));
if (statusFile === undefined) {
  console.log(JSON.stringify(cell));
} else {
  const because = staleBecause(summary, readStatus(new Uint8Array(readFileSync(statusFile))));
  console.log(JSON.stringify({ ...cell, safe: cell.safe && because.length === 0 }));
  console.log(because.length ? `not to step by: ${because.join("; ")}` : "may be used");
}

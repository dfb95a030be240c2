// Builds the page into built/ (or the folder of the first argument). The same sources and packages give the same bytes.
import {build} from "esbuild";
import {copyFile, mkdir, readFile, writeFile} from "node:fs/promises";
import {createRequire} from "node:module";
import {feature} from "topojson-client";

const out = process.argv[2] ?? "built";
await mkdir(out, {recursive: true});
await build({
  entryPoints: {console: "src/main.tsx"},
  outdir: out,
  bundle: true,
  minify: true,
  format: "esm",
  splitting: true,  // what import() names is loaded when it is needed
  chunkNames: "[name]",
  target: ["chrome110", "firefox115", "safari16"],
  jsx: "automatic",
  jsxImportSource: "preact",
  charset: "ascii",
  legalComments: "eof",
});
for (const file of ["index.html", "icon.svg"]) await copyFile(`src/${file}`, `${out}/${file}`);

// The outline of the land for the map, of Natural Earth at 1:110 million (public domain): rings of points in tenths of a degree,
// each point but the first as a step from the one before; a ring that is smaller than that is left out.
const atlas = JSON.parse(await readFile(createRequire(import.meta.url).resolve("world-atlas/land-110m.json"), "utf8"));
const shapes = feature(atlas, atlas.objects.land).features.flatMap(({geometry}) =>
  geometry.type === "Polygon" ? [geometry.coordinates] : geometry.coordinates);
const rings = shapes.flat().map((ring) => {
  // A ring goes on beyond 180 degrees where it crosses that line; one around a pole is closed by way of the pole.
  let turns = 0;
  const whole = ring.map(([lon, lat], i) => {
    if (i) turns -= Math.round((lon - ring[i - 1][0]) / 360);
    return [lon + 360 * turns, lat];
  });
  const pole = 90 * Math.sign(whole[0][1]);
  if (turns) whole.push([whole.at(-1)[0], pole], [whole[0][0], pole]);
  const steps = [];
  let former = [0, 0];
  for (const point of whole) {
    const next = point.map((degrees) => Math.round(degrees * 10));
    const step = [next[0] - former[0], next[1] - former[1]];
    if (steps.length && !step[0] && !step[1]) continue;
    steps.push(...step);
    former = next;
  }
  return steps;
}).filter((steps) => steps.length >= 8);
await writeFile(`${out}/land.json`, `${JSON.stringify({rings})}\n`);

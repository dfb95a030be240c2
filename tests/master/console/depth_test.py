#!/usr/bin/python3
"""The page decodes depth frames of all codecs to the millimetres of the C++ decoder, pixel by pixel, and refuses the same frames.

usage: depth_test.py DEPTH_FRAMES
"""
import subprocess
import sys
import tempfile
from pathlib import Path

import npm_packages

SCRIPT = """
import {readFileSync, readdirSync, existsSync} from "node:fs";
import {millimetres, NoDepth} from "./depth.mjs";
const folder = process.argv[2];
let good = 0, refused = 0, wrong = 0;
for (const file of readdirSync(folder).filter((name) => name.endsWith(".frame"))) {
  const name = `${folder}/${file.slice(0, -6)}`;
  const wanted = existsSync(`${name}.mm`) ? readFileSync(`${name}.mm`) : null;
  let mm = null, why = "";
  try {
    mm = millimetres(new Uint8Array(readFileSync(`${name}.frame`)));
  } catch (error) {
    if (!(error instanceof NoDepth)) throw error;
    why = error.message;
  }
  wanted ? good++ : refused++;
  if (!wanted === !mm && (!mm || Buffer.from(mm.buffer).equals(wanted))) continue;
  wrong++;
  const at = mm && wanted ? mm.findIndex((value, i) => value !== wanted.readUInt16LE(2 * i)) : -1;
  console.log(`wrong: ${file}: ${!mm ? why : !wanted ? "it is not refused" : `pixel ${at} has ${mm[at]} mm, not ${wanted.readUInt16LE(2 * at)}`}`);
}
const begin = performance.now(), again = readFileSync(`${folder}/room-2-compact.frame`);
for (let i = 0; i < 10; i++) millimetres(new Uint8Array(again));
console.log(`${good} frames decoded, ${refused} refused; a compact frame takes ${((performance.now() - begin) / 10).toFixed(1)} ms`);
process.exit(wrong || good < 21 || refused < 21 ? 1 : 0);
"""


def main():
    packages = npm_packages.packages()
    with tempfile.TemporaryDirectory(prefix="iotcloud-depth-") as folder:
        frames, code = Path(folder) / "frames", Path(folder) / "code"
        frames.mkdir()
        subprocess.run([sys.argv[1], frames], check=True)
        subprocess.run([packages / "node_modules/.bin/esbuild", npm_packages.PAGE / "src/depth.ts", "--format=esm", "--log-level=warning",
                        f"--outfile={code / 'depth.mjs'}"], check=True)
        (code / "check.mjs").write_text(SCRIPT)
        sys.exit(subprocess.run(["node", code / "check.mjs", frames], check=False).returncode)


if __name__ == "__main__":
    try:
        main()
    except npm_packages.Unavailable as problem:
        sys.exit(str(problem))

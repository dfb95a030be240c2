#!/usr/bin/python3
"""Measures the loop of somebody who changes one source: for each room it changes the largest source and times `./dev
test ROOM --unit`; then it changes a header that many sources include and times `./dev build`.

usage: loop.py [--room ROOM]... [--json FILE]      (build/loop.json; everything must have been built before)

A change is a comment at the end of the file, which is taken away again (the next build compiles it anew). ccache is off:
it would return the object of the old text.
"""
import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
ROOMS = ["config", "security", "rpc", "brokers", "discovery", "drivers", "processes", "gateway", "master", "topology",
         "examples", "deploy"]
TESTED_BY = {"deploy": "containers"}  # the room of its unit tests, where it is another
COMMENTS = {".cc": b"// changed\n", ".h": b"// changed\n", ".py": b"# changed\n"}
HEADERS = ["config/error.h", "brokers/message.h"]
TARGETS = {"room": 45.0, "header": 240.0}  # seconds


def timed(file, command):
    """Seconds that `command` takes after a change of `file`."""
    text = file.read_bytes()
    try:
        file.write_bytes(text + COMMENTS[file.suffix])
        begin = time.monotonic()
        done = subprocess.run(command, cwd=ROOT, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT, text=True, env={**os.environ, "CCACHE_DISABLE": "1"})
        seconds = time.monotonic() - begin
    finally:
        file.write_bytes(text)
    if done.returncode != 0:
        sys.exit(f"{' '.join(command)}:\n{done.stdout}")
    return seconds


def largest_source(room):
    """The largest source in C++; deploy has only scripts."""
    sources = list((ROOT / room).rglob("*.cc")) or list((ROOT / room).rglob("*.py"))
    return max(sources, key=lambda file: file.stat().st_size)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--room", action="append", choices=ROOMS)
    parser.add_argument("--json", type=Path, default=ROOT / "build/loop.json")
    given = parser.parse_args()
    rows = []
    for room in given.room or ROOMS:
        file = largest_source(room)
        tests = TESTED_BY.get(room, room)
        rows.append(("room", str(file.relative_to(ROOT)), timed(file, ["./dev", "test", tests, "--unit"])))
        print(f"{rows[-1][2]:7.1f} s  {rows[-1][1]}: built, and the unit tests of {tests}", flush=True)
        subprocess.run(["./dev", "build"], cwd=ROOT, stdout=subprocess.DEVNULL, check=True)  # restores the build
    if not given.room:
        for header in HEADERS:
            rows.append(("header", header, timed(ROOT / header, ["./dev", "build"])))
            print(f"{rows[-1][2]:7.1f} s  {header}: everything built", flush=True)
    commit = subprocess.run(["git", "describe", "--always", "--dirty"], cwd=ROOT, capture_output=True, text=True).stdout
    results = []
    for kind, target in TARGETS.items():
        seconds = [row[2] for row in rows if row[0] == kind]
        if seconds:
            middle = statistics.median(seconds)
            print(f"{middle:7.1f} s  median of {kind}s; {target:.0f} s are wanted")
            results.append({"name": f"one changed {kind}", "value": middle, "unit": "s", "target": target,
                            "met": middle <= target})
    results += [{"name": name, "value": value, "unit": "s"} for _, name, value in rows]
    given.json.parent.mkdir(parents=True, exist_ok=True)
    given.json.write_text(json.dumps({"commit": commit.strip(), "cores": os.cpu_count(), "results": results}, indent=1))


if __name__ == "__main__":
    main()

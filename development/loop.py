#!/usr/bin/python3
"""Measures the loop of somebody who changes one source: for each room it changes the largest source and times `./dev
test ROOM --unit`; then it changes a header that many sources include and times `./dev build`.

usage: ./dev bench loop [--room ROOM]... [--json FILE]      (it builds everything, and runs this file)

Prints each time and writes all as figures to build/bench/loop.json (`./dev bench keep loop`). A change is a comment at
the end of the file. Afterwards the file has its text and its time of before, so that the next step compiles nothing
because of it. ccache is off: it would return the object of the old text.
"""
import argparse
import os
import statistics
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "bench"))

import figures  # noqa: E402
from heartbeat import Heartbeat, seconds_of_last_run  # noqa: E402

ROOMS = ["config", "security", "rpc", "brokers", "discovery", "recording", "drivers", "processes", "gateway", "master",
         "topology", "check", "examples", "deploy"]
TESTED_BY = {"deploy": "containers"}  # the room of its unit tests, where it is another
COMMENTS = {".cc": b"// changed\n", ".h": b"// changed\n", ".py": b"# changed\n"}
HEADERS = ["config/error.h", "brokers/message.h"]
TARGETS = {"room": 45.0, "header": 240.0}  # seconds


def timed(file, command):
    """Seconds that `command` takes after a change of `file`."""
    text, status = file.read_bytes(), file.stat()
    try:
        file.write_bytes(text + COMMENTS[file.suffix])
        begin = time.monotonic()
        done = subprocess.run(command, cwd=ROOT, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT, text=True, env={**os.environ, "CCACHE_DISABLE": "1"})
        seconds = time.monotonic() - begin
    finally:
        file.write_bytes(text)
        os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns))
    if done.returncode != 0:
        sys.exit(f"{' '.join(command)}:\n{done.stdout}")
    return seconds


def largest_source(room):
    """The largest source in C++; deploy has only scripts."""
    sources = list((ROOT / room).rglob("*.cc")) or list((ROOT / room).rglob("*.py"))
    return max(sources, key=lambda file: file.stat().st_size)


def results_of(rows):
    """The rows (kind, name, seconds) in the form of a benchmark's results: the median of each kind first, which has the
    target."""
    for kind, target in TARGETS.items():
        seconds = [row[2] for row in rows if row[0] == kind]
        if seconds:
            middle = statistics.median(seconds)
            yield {"name": f"one changed {kind}, median", "value": middle, "unit": "s", "target": f"<= {target:.0f}",
                   "met": middle <= target}
    for kind, name, seconds in rows:
        yield {"name": f"one changed {kind}: {name}", "value": seconds, "unit": "s", "met": None}


def measured(rooms):
    """Rows (kind, name, seconds) of these rooms; without any, of all and of the headers. Prints each."""
    rows = []
    for room in rooms or ROOMS:
        file = largest_source(room)
        tests = TESTED_BY.get(room, room)
        rows.append(("room", str(file.relative_to(ROOT)), timed(file, ["./dev", "test", tests, "--unit"])))
        print(f"{rows[-1][2]:7.1f} s  {rows[-1][1]}: built, and the unit tests of {tests}", flush=True)
        subprocess.run(["./dev", "build"], cwd=ROOT, stdout=subprocess.DEVNULL, check=True)  # links the rest
    if not rooms:
        for header in HEADERS:
            rows.append(("header", header, timed(ROOT / header, ["./dev", "build"])))
            print(f"{rows[-1][2]:7.1f} s  {header}: everything built", flush=True)
    return rows


def main():
    parser = argparse.ArgumentParser(prog="./dev bench loop", description=__doc__.split("\n")[0])
    parser.add_argument("--room", action="append", choices=ROOMS)
    parser.add_argument("--json", type=Path, default=ROOT / "build/bench/loop.json")
    given = parser.parse_args()
    begun = figures.begin(ROOT)
    command = figures.command_line(["loop", *sys.argv[1:]])
    with Heartbeat("loop", seconds_of_last_run(given.json, command)):
        rows = measured(given.room)
    results = list(results_of(rows))
    for result in results:
        if result["met"] is not None:
            print(f"{result['value']:7.1f} s  {result['name']}; {result['target']} s are wanted")
    figures.write(given.json, command, begun, {}, results)


if __name__ == "__main__":
    main()

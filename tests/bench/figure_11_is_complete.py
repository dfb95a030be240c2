#!/usr/bin/python3
"""The short form of the paper's figure 11, `./dev bench paper --figure 11`, with real servers: of all numbers of partitions every
partition is read, and of 4 and of 1000 drivers every message comes back. How fast is not judged, nor whether the bare client
beside it holds out, so other processes may take the CPUs. The figures stay below BUILD_DIR: none that was measured is
overwritten.

usage: figure_11_is_complete.py BUILD_DIR
Exit status 77: skipped, because a server cannot be had.
"""

import json
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "bench"))

from paper import drivers  # noqa: E402
from paper.systems import HOSTS  # noqa: E402  (and the way to tests/servers)

import maven_jars  # noqa: E402
import private_server  # noqa: E402

SKIPPED = 77
DRIVERS, RATE = (4, 1000), 5
POINTS = "(4|1000) x 5/s"


def problems_of_point(point):
    """What is wrong with a point of ours."""
    sent = point["x"] * point["rate"] * drivers.WINDOW_S["usual"]
    if "failed" in point:
        yield point["failed"]
    elif (point["n"], point["lost"]) != (sent, 0):
        yield f"{point['n']} of {sent} messages came back, {point['lost']} were lost"


def problems(figure, status):
    """What is wrong with the figure's file, and the exit status of the program that wrote it."""
    curves = {curve["name"]: curve["points"] for plot in figure["plots"][:1] for curve in plot["series"]}
    read = {result["name"]: result["value"] for result in figure["results"] if result["name"].endswith(": partitions read")}
    for layout, partitions in drivers.PARTITIONS.items():
        points = curves.pop(f"IoTCloud, {layout}", [])
        taken = sorted((point["x"], point["rate"]) for point in points)
        if taken != [(count, RATE) for count in DRIVERS]:
            yield f"{layout}: these points were taken: {taken}"
        for point in points:
            yield from (f"{layout}, {point['x']} drivers: {wrong}" for wrong in problems_of_point(point))
        said, there_are = read.get(f"Kafka, {layout}: partitions read"), HOSTS * partitions
        if said != there_are:
            yield f"{layout}: {said} of {there_are} partitions were read"
    bare_failed = any("failed" in point for points in curves.values() for point in points)
    if figure.get("failed") and not bare_failed:
        yield figure["failed"]
    if status != (1 if figure.get("failed") else 0):
        yield f"the benchmark ended with status {status}, and its file says: {figure.get('failed') or 'not failed'}"


def main():
    if len(sys.argv) != 2:
        sys.exit(__doc__.split("\n\n")[1])
    build = Path(sys.argv[1]).resolve()
    out = build / "figure-11" / "paper"  # the page goes beside
    shutil.rmtree(out.parent, ignore_errors=True)
    try:
        maven_jars.fetch("kafka")
    except private_server.Unavailable as reason:
        print(f"skipped: {reason}")
        return SKIPPED
    status = subprocess.run([sys.executable, ROOT / "bench/report.py", "paper", "--figure", "11", "--points", POINTS,
                             "--rounds", "1", "--build", build, "--out", out]).returncode
    file = out / "figure-11.json"
    if not file.exists():
        sys.exit(f"wrong: the benchmark ended with status {status} and wrote no {file}")
    found = list(problems(json.loads(file.read_text(encoding="utf-8")), status))
    if found:
        sys.exit("wrong: " + "\n       ".join(found))
    return 0


if __name__ == "__main__":
    sys.exit(main())

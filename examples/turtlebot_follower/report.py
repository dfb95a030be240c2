"""Figures and pictures of one run, from the turtle driver's traces (drivers/turtle/README.md has the columns)."""

import csv
import math
import os
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path

GOAL_M = 0.7  # the reference's distance between camera and person
MAX_MEAN_ERROR_M = 0.25
MIN_ANSWERED = 0.99


@dataclass
class Row:
    seq: int
    seconds: float
    robot: tuple
    person: tuple
    distance: float
    in_box: bool  # the person stands where the follower looks
    encode_ms: float
    raw_bytes: int
    payload_bytes: int
    answered: bool
    latency_ms: float


def read_trace(path, last=None):
    """The rows of a trace that may still be growing: an incomplete last line is left out."""
    try:
        text = Path(path).read_text()
    except FileNotFoundError:
        return []
    lines = text[: text.rfind("\n") + 1].splitlines()
    if len(lines) < 2:
        return []
    body = lines[1:] if last is None else lines[1:][-last:]
    rows = []
    for fields in csv.DictReader([lines[0], *body]):
        rows.append(Row(
            seq=int(fields["seq"]), seconds=float(fields["capture_s"]),
            robot=(float(fields["robot_x"]), float(fields["robot_y"])),
            person=(float(fields["person_x"]), float(fields["person_y"])),
            distance=float(fields["distance"]), in_box=fields["in_box"] == "1",
            encode_ms=float(fields["encode_us"]) / 1000, raw_bytes=int(fields["raw_bytes"]),
            payload_bytes=int(fields["payload_bytes"]), answered=fields["answered"] == "1",
            latency_ms=float(fields["latency_us"] or 0) / 1000))
    return rows


def percentile(values, percent):
    """Nearest rank; NaN for an empty list."""
    if not values:
        return math.nan
    ordered = sorted(values)
    return ordered[max(0, math.ceil(percent / 100 * len(ordered)) - 1)]


def spread(values):
    """p50, p99, max, mean and standard deviation; null if there are no values."""
    if not values:
        return {"n": 0, "p50": None, "p99": None, "max": None, "mean": None, "stdev": None}
    mean = sum(values) / len(values)
    return {"n": len(values), "p50": round(percentile(values, 50), 4), "p99": round(percentile(values, 99), 4),
            "max": round(max(values), 4), "mean": round(mean, 4),
            "stdev": round(math.sqrt(sum((v - mean) ** 2 for v in values) / len(values)), 4)}


def follow_figures(rows, seconds):
    """How well one robot followed its person."""
    errors = [abs(row.distance - GOAL_M) for row in rows]
    mean_error = sum(errors) / len(errors) if errors else math.inf
    answered = sum(row.answered for row in rows)
    lost = sum(not row.in_box for row in rows)
    length = rows[-1].seconds - rows[0].seconds if rows else 0
    # True if the loop was closed for nearly the whole time asked for.
    long_enough = length >= 0.9 * (seconds - 1)
    share = answered / len(rows) if rows else 0
    return {
        "followed": bool(long_enough and lost == 0 and share >= MIN_ANSWERED and mean_error < MAX_MEAN_ERROR_M),
        "seconds": round(length, 3),
        "frames_sent": len(rows),
        "frames_answered": answered,
        "frames_without_person": lost,
        "distance_error_m": {"mean": round(mean_error, 4) if errors else None,
                             "worst": round(max(errors), 4) if errors else None},
        "latency_ms": spread([row.latency_ms for row in rows if row.answered]),
    }


def without_frame_under_way(rows):
    """Drops a last frame without an answer: the demo removes the robot at its end, perhaps before the command comes."""
    return rows[:-1] if rows and not rows[-1].answered else rows


def make_report(robots, traces, options, measured):
    """Figures of all frames, and under "robots" those of each robot."""
    traces = [without_frame_under_way(trace) for trace in traces]
    rows = [row for trace in traces for row in trace]
    each = [{"gateway": robot.gateway, "seed": robot.properties["seed"], **follow_figures(trace, options.seconds)}
            for robot, trace in zip(robots, traces)]
    payload = sum(row.payload_bytes for row in rows)
    return {
        **follow_figures(rows, options.seconds),
        "followed": all(robot["followed"] for robot in each),
        "seconds": min(robot["seconds"] for robot in each),
        "mode": options.engine or ("cluster" if options.cluster else "local"),
        "broker": measured["broker"],
        "seed": options.seed,
        "codec": {"ratio": round(sum(row.raw_bytes for row in rows) / payload, 2) if payload else None,
                  "encode_ms": spread([row.encode_ms for row in rows]),
                  "frame_bytes": round(payload / len(rows)) if rows else None},
        "robots": each,
        "bolts_ms": measured["bolts_ms"],
        "cpu_cores": measured["cpu_cores"],
        "machine": {"cores": os.cpu_count(), "kernel": os.uname().release},
    }


def draw(traces, out):
    """Draws paths.png, distance.png and latency.png beside the report; each robot has a world of its own."""
    if not shutil.which("gnuplot"):
        print("no pictures: gnuplot is not installed (./dev deps installs it)")
        return
    if not all(any(row.answered for row in rows) for rows in traces):
        print("no pictures: a robot had no command at all")
        return
    data = out / "plot.dat"
    data.write_text("\n\n".join("".join(  # a block for each robot
        f"{r.seconds} {r.robot[0]} {r.robot[1]} {r.person[0]} {r.person[1]} {r.distance} "
        f"{r.latency_ms if r.answered else 'nan'}\n" for r in rows) for rows in traces))

    def curves(columns, style, what):
        names = [what if len(traces) == 1 else f"{what} {number + 1}" for number in range(len(traces))]
        return ", ".join(f"'{data}' index {number} using {columns} with {style} title '{name}'"
                         for number, name in enumerate(names))

    script = f"""
set terminal pngcairo size 900,600 noenhanced font 'sans,11'
set grid
set datafile missing 'nan'
set output '{out}/paths.png'
set title 'The paths, seen from above'
set xlabel 'x (m)'; set ylabel 'y (m)'; set size ratio -1; set key outside
plot {curves("4:5", "lines lw 2", "person")}, {curves("2:3", "lines lw 2", "robot")}
set output '{out}/distance.png'
set size noratio; set key inside
set title 'Distance between camera and person'
set xlabel 'time (s)'; set ylabel 'm'; set yrange [0:*]
plot {curves("1:6", "lines lw 2", "distance")}, {GOAL_M} with lines dt 2 title 'goal'
set output '{out}/latency.png'
set title 'Frame to command, every frame (the paper, figure 12)'
set ylabel 'ms'
plot {curves("1:7", "points pt 7 ps 0.4", "latency")}
"""
    subprocess.run(["gnuplot"], input=script, text=True, check=True)
    data.unlink()


def print_summary(result, out):
    latency, codec, error = result["latency_ms"], result["codec"], result["distance_error_m"]

    def show(value, unit):
        return "-" if value is None else f"{value:.2f} {unit}"

    print()
    print(f"followed             {'yes' if result['followed'] else 'NO'}"
          f"  ({result['mode']}, {result['broker']}, seed {result['seed']})")
    if len(result["robots"]) > 1:
        for number, robot in enumerate(result["robots"], 1):
            worst, tail = robot["distance_error_m"]["worst"], robot["latency_ms"]["p99"]
            print(f"robot {number:<14} {'followed' if robot['followed'] else 'LOST    '}  {robot['gateway']}, seed"
                  f" {robot['seed']}: {robot['frames_answered']} of {robot['frames_sent']} answered, error at most"
                  f" {show(worst, 'm')}, p99 {show(tail, 'ms')}")
    print(f"distance error       mean {show(error['mean'], 'm')}, worst {show(error['worst'], 'm')}"
          f" (goal {GOAL_M} m; mean below {MAX_MEAN_ERROR_M} m)")
    print(f"frames               {result['frames_sent']} sent, {result['frames_answered']} answered,"
          f" {result['frames_without_person']} without the person")
    print(f"frame to command     p50 {show(latency['p50'], 'ms')}, p99 {show(latency['p99'], 'ms')},"
          f" max {show(latency['max'], 'ms')}")
    print(f"compression          {codec['ratio']}:1, encode p50 {show(codec['encode_ms']['p50'], 'ms')}"
          f" a frame of {codec['frame_bytes']} bytes")
    for bolt, times in result["bolts_ms"].items():
        print(f"bolt {bolt:<15} p50 {show(times['p50'], 'ms')}, p99 {show(times['p99'], 'ms')}")
    cpu = ", ".join(f"{name} {cores:.2f}" for name, cores in result["cpu_cores"].items())
    print(f"CPU used (cores)     {cpu}")
    print(f"report and logs      {os.path.relpath(out)}")

#!/usr/bin/python3
"""Runs the benchmarks of the topology runtime, prints a table and writes build/bench/NAME.json.

usage: report.py runtime [--quick] [--build DIR] [--json FILE]      (./dev bench builds what this needs)
       report.py soak [--minutes N] [--seed N] [--build DIR] [--json FILE]

Everything here is measured: the engines take turns, round by round, a ratio is the median of the ratios of one round,
and whether a target is met is computed.
"""

import argparse
import json
import os
import platform
import shlex
import signal
import statistics
import subprocess
import sys
import time
from pathlib import Path

OURS, CALLS, RING, PEER = "iotcloud", "calls", "ring", "onetbb"
BASELINES = {CALLS: "plain calls", RING: "SPSC rings", PEER: "oneTBB"}  # two limits, and a peer
DAGS = {"chain": "chain of 3", "words": "word count", "fan": "fan 1-4-1", "payload": "60 KB chain"}
UNITS = {"cpu": "% of a core", "switches": "switches/s"}
NO_ALLOCATION = 0.001  # for each tuple: pools may still grow by a few objects in all, when another thread takes part
LOADS = (1, 50, 90)  # percent of what the engine reached at most


class Programs:
    def __init__(self, folder):
        self.folder = folder

    def engines(self, *without):
        there = [e for e in (OURS, *BASELINES) if (self.folder / f"bench_runtime_{e}").exists()]
        return [e for e in there if e not in without]

    def run(self, name, *arguments):
        """The lines of JSON that a program prints. One that fails ends the benchmark: its figures mean nothing."""
        command = [str(self.folder / f"bench_runtime_{name}"), *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=600)
        if done.returncode != 0:
            sys.exit(f"{shlex.join(command)} failed with status {done.returncode}:\n{done.stderr}{done.stdout}")
        return [json.loads(line) for line in done.stdout.splitlines()]


class Report:
    def __init__(self):
        self.results = []
        self.failed = False

    def compare(self, name, unit, by_engine, at_least=None, at_most=None):
        """One figure: `by_engine` has a value of each round for ours, and for each baseline that ran beside it. One
        line of the table, and a result for each baseline."""
        values = by_engine[OURS]
        value = statistics.median(values)
        target, met = None, None
        if at_least is not None:
            target, met = f">= {at_least:g}", value >= at_least
        if at_most is not None:
            target, met = f"<= {at_most:g}", value <= at_most
        beside = []
        for baseline in [e for e in BASELINES if e in by_engine] or [None]:
            theirs = by_engine.get(baseline, [])
            ratios = [a / b for a, b in zip(values, theirs) if b]
            beside.append(
                {
                    "name": name,
                    "value": value,
                    "unit": unit,
                    "baseline": BASELINES.get(baseline),
                    "baseline_value": statistics.median(theirs) if theirs else None,
                    "ratio": statistics.median(ratios) if ratios else None,
                    "target": target,
                    "met": met,
                    "rounds": len(values),
                    "spread": (max(values) - min(values)) / value if value else 0.0,
                }
            )
        self.results += beside
        self.print_line(beside)

    @staticmethod
    def print_head():
        beside = "".join(f" {name:>12} {'ratio':>7}" for name in BASELINES.values())
        print(f"{'figure':<42} {'value':>9} {'unit':<11}{beside} {'target':>9} {'met':>4} {'n':>2} {'spread':>6}")

    @staticmethod
    def print_line(beside):
        theirs = {r["baseline"]: r for r in beside}
        columns = "".join(
            f" {number(r.get('baseline_value')):>12} {number(r.get('ratio')):>7}"
            for r in (theirs.get(name, {}) for name in BASELINES.values())
        )
        r = beside[0]
        print(
            f"{r['name']:<42} {number(r['value']):>9} {r['unit']:<11}{columns} {r['target'] or '':>9}"
            f" {number(r['met']):>4} {r['rounds']:>2} {r['spread']:>6.0%}",
            flush=True,
        )

    def verdict(self):
        judged = {r["name"]: r["met"] for r in self.results if r["met"] is not None}
        missed = [name for name, met in judged.items() if not met]
        lines = [f"{len(judged) - len(missed)} of {len(judged)} targets met"]
        lines += [f"  missed: {name}" for name in missed]
        return "\n".join(lines + ["  bench/README.md says why"] * bool(missed))


def number(value):
    if value is None:
        return ""
    if isinstance(value, bool):
        return "yes" if value else "NO"
    if abs(value) >= 100:
        return f"{value:,.0f}"
    if abs(value) < 0.001 and value != 0:
        return f"{value:.0e}"
    return f"{value:.3g}"


def title(dag, tracked):
    return f"{DAGS[dag]}, {'tracked' if tracked else 'untracked'}"


def saturation(programs, report, dag, tracked, rounds, seconds):
    """As many results as possible. Returns {engine: results a second}."""
    lines = {engine: [] for engine in programs.engines()}
    for _ in range(rounds):
        for engine in lines:
            options = ["--dag", dag, "--warm-up", 0.5, "--seconds", seconds] + ["--tracked"] * tracked
            lines[engine] += programs.run(engine, *options)
    targets = {("chain", False): 15e6, ("chain", True): 5e6, ("words", False): 12e6}
    target = targets.get((dag, tracked))
    unit = "M words/s" if dag == "words" else "M tuples/s"
    report.compare(
        f"{title(dag, tracked)}: at most",
        unit,
        {engine: [line["per_second"] / 1e6 for line in runs] for engine, runs in lines.items()},
        at_least=None if target is None else target / 1e6,
    )
    report.compare(
        f"{title(dag, tracked)}: a hop",
        "ns",
        {engine: [line["ns_per_hop"] for line in runs] for engine, runs in lines.items()},
    )
    report.compare(
        f"{title(dag, tracked)}: cpu then",
        UNITS["cpu"],
        {engine: [line["cpu_percent"] for line in runs] for engine, runs in lines.items()},
    )
    return {engine: statistics.median(line["per_second"] for line in runs) for engine, runs in lines.items()}


def latency(programs, report, dag, tracked, most, load, rounds, seconds):
    """At a part of what each engine reached: from the intended time of sending to the last task's execute (or ack)."""
    lines = {engine: [] for engine in programs.engines(CALLS)}
    for _ in range(rounds):
        for engine in lines:
            rate = most[engine] * load / 100
            options = ["--dag", dag, "--rate", f"{rate:.0f}", "--warm-up", 0.5, "--seconds", seconds]
            lines[engine] += programs.run(engine, *options, *["--tracked"] * tracked)
    for quantile in ("p50", "p99", "max"):
        report.compare(
            f"{title(dag, tracked)}: {quantile} at {load} % load",
            "us",
            {engine: [line["latency"][f"{quantile}_us"] for line in runs] for engine, runs in lines.items()},
            at_most=100 if (quantile, load) == ("p99", 50) else None,
        )


def quiet(programs, report, rounds, seconds):
    """The chain at 100 tuples a second: from the moment that the thread that brings a tuple has it."""
    lines = {engine: [] for engine in programs.engines()}
    for _ in range(rounds):
        for engine in lines:
            lines[engine] += programs.run(engine, "--rate", 100, "--warm-up", 0.5, "--seconds", seconds)
    for quantile, target in (("p50", 3), ("p99", 20), ("max", None)):
        report.compare(
            f"{DAGS['chain']} at 100/s: {quantile}",
            "us",
            {engine: [line["service"][f"{quantile}_us"] for line in runs] for engine, runs in lines.items()},
            at_most=target,
        )
    for key in ("cpu_percent", "switches_per_second"):
        figure = key.split("_")[0]
        report.compare(
            f"{DAGS['chain']} at 100/s: {figure}",
            UNITS[figure],
            {engine: [line[key] for line in runs] for engine, runs in lines.items()},
        )


def costs(programs, report, rounds, seconds):
    """What only our runtime is asked: nothing runs beside it."""
    runs = {}
    for _ in range(rounds):
        for line in programs.run("costs", seconds):
            runs.setdefault(line["figure"], []).append(line["value"])
    targets = {"idle: cpu": 0.5, "10 000 tasks: idle MB": 100}
    for figure, values in runs.items():
        kind = figure.split(":")[0]
        unit = {"heap": "allocations", "copies": "copies"}.get(kind, figure.split()[-1])
        # A sentence of the word count is longer than a string holds without the heap: no small tuple.
        if kind == "heap" and "words" not in figure:
            targets[figure] = NO_ALLOCATION
        if kind == "copies":
            targets[figure] = 0
        report.compare(figure, UNITS.get(unit, unit), {OURS: values}, at_most=targets.get(figure))


def machine():
    with open("/proc/cpuinfo", encoding="ascii", errors="replace") as cpuinfo:
        model = next((line.split(":", 1)[1].strip() for line in cpuinfo if line.startswith("model name")), "unknown")
    return {
        "cpu": model,
        "cores": os.cpu_count(),
        "memory_mb": os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2**20,
        "kernel": platform.release(),
        "load_average_before": os.getloadavg()[0],
    }


def commit(root):
    def git(*arguments):
        return subprocess.run(["git", "-C", root, *arguments], capture_output=True, text=True).stdout.strip()

    return git("rev-parse", "HEAD") + ("-modified" if git("status", "--porcelain") else "")


def run_runtime(programs, report, given):
    rounds, seconds = (2, 0.5) if given.quick else (5, 1.0)
    if PEER not in programs.engines():
        print("oneTBB's program is not built (libtbb-dev was missing when CMake ran): the peer is left out")
    report.print_head()
    costs(programs, report, 1 if given.quick else 3, 1.0)
    quiet(programs, report, rounds, 2 if given.quick else 5)
    for dag in DAGS:
        for tracked in (False, True):
            most = saturation(programs, report, dag, tracked, rounds, seconds)
            if given.quick and dag not in ("chain", "words"):
                continue
            for load in LOADS:
                latency(programs, report, dag, tracked, most, load, 1 if given.quick else 3, seconds)
    return report.verdict()


def run_soak(programs, report, given):
    """One long run; what it says on the way is passed on. Returns the verdict."""
    command = [str(programs.folder / "bench_runtime_soak"), "--minutes", str(given.minutes)]
    if given.seed is not None:
        command += ["--seed", str(given.seed)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True)
    report.print_head()
    for line in map(json.loads, done.stdout.splitlines()):
        report.compare(line["figure"], line["unit"], {OURS: [line["value"]]}, at_most=line.get("at_most"))
    if done.returncode != 0:
        report.failed = True
        return "VIOLATED, see above"
    return "every tuple is accounted for, no key was out of order, memory stayed flat"


def main():
    signal.signal(signal.SIGPIPE, signal.SIG_DFL)
    root = Path(__file__).resolve().parent.parent
    options = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    commands = options.add_subparsers(dest="what", required=True)
    runtime, soak = commands.add_parser("runtime"), commands.add_parser("soak")
    for command in (runtime, soak):
        command.add_argument("--build", type=Path, default=root / "build/release")
        command.add_argument("--json", type=Path)
    runtime.add_argument("--quick", action="store_true", help="fewer and shorter rounds, no latency of the wider DAGs")
    soak.add_argument("--minutes", type=float, default=10)
    soak.add_argument("--seed", type=int, help="to disturb it in the same way again")
    given = options.parse_args()
    file = given.json or root / f"build/bench/{given.what}.json"

    programs = Programs(given.build / "bin")
    report = Report()
    facts = machine()
    print(f"{facts['cpu']}, {facts['cores']} cores, load {facts['load_average_before']:.2f}", flush=True)
    if facts["load_average_before"] > 0.5:
        print("THE MACHINE IS NOT QUIET: the tails of latencies, and what needs all cores, are worse than they are")
    began = time.monotonic()
    verdict = (run_soak if given.what == "soak" else run_runtime)(programs, report, given)
    facts["load_average_after"] = os.getloadavg()[0]
    file.parent.mkdir(parents=True, exist_ok=True)
    command = shlex.join(["./dev", "bench", *sys.argv[1:]])
    written = {"machine": facts, "commit": commit(root), "command": command, "results": report.results}
    file.write_text(json.dumps(written, indent=1) + "\n")
    print(f"{verdict}\n{time.monotonic() - began:.0f} s; all figures are in {file}")
    sys.exit(1 if report.failed else 0)


if __name__ == "__main__":
    main()

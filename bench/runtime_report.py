"""The figures of `./dev bench runtime` and `./dev bench soak`."""

import json
import statistics
import subprocess

from figures import Programs, Verdict, number

OURS, CALLS, RING, PEER = "iotcloud", "calls", "ring", "onetbb"
BASELINES = {CALLS: "plain calls", RING: "SPSC rings", PEER: "oneTBB"}  # the first two are limits, the third is a peer
DAGS = {"chain": "chain of 3", "words": "word count", "fan": "fan 1-4-1", "payload": "60 KB chain"}
UNITS = {"cpu": "% of a core", "switches": "switches/s"}
# allocations per tuple that count as none: pools still grow by a few objects when another thread takes part
NO_ALLOCATION = 0.001
LOADS = (1, 50, 90)  # percent of the engine's highest rate


def engines(programs, *without):
    return [e for e in (OURS, *BASELINES) if programs.has(e) and e not in without]


class Report(Verdict):
    def compare(self, name, unit, by_engine, at_least=None, at_most=None):
        """Reports one figure. `by_engine` has a value for each round, for our engine and for each baseline that ran
        beside it. Prints one line of the table and adds a result for each baseline."""
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


def title(dag, tracked):
    return f"{DAGS[dag]}, {'tracked' if tracked else 'untracked'}"


def saturation(programs, report, dag, tracked, rounds, seconds):
    """Measures the highest rate. Returns {engine: results a second}."""
    lines = {engine: [] for engine in engines(programs)}
    for _ in range(rounds):
        for engine in lines:
            options = ["--dag", dag, "--warm-up", 0.5, "--seconds", seconds] + ["--tracked"] * tracked
            lines[engine] += programs.run(engine, *options)
    targets = {("chain", False): 25e6, ("chain", True): 20e6, ("words", False): 12e6, ("words", True): 11e6}
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
        at_most=None if target is None else 110,  # the rate is that of one core
    )
    return {engine: statistics.median(line["per_second"] for line in runs) for engine, runs in lines.items()}


def latency(programs, report, dag, tracked, most, load, rounds, seconds):
    """Measures latency at a part of each engine's highest rate: from the time at which an item should have been sent to
    the end of the last task (or to the ack)."""
    lines = {engine: [] for engine in engines(programs, CALLS)}
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
            at_most={("p99", 50): 100, ("p99", 90): 5000}.get((quantile, load)),
        )


def quiet(programs, report, rounds, seconds):
    """Measures the chain at 100 tuples a second. Latency counts from the time at which the source's thread has woken
    up."""
    lines = {engine: [] for engine in engines(programs)}
    for _ in range(rounds):
        for engine in lines:
            lines[engine] += programs.run(engine, "--rate", 100, "--warm-up", 0.5, "--seconds", seconds)
    for quantile, target in (("p50", 12), ("p99", 33), ("max", None)):
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
    """Measures the costs of our runtime that have no baseline."""
    runs = {}
    for _ in range(rounds):
        for line in programs.run("costs", seconds):
            runs.setdefault(line["figure"], []).append(line["value"])
    targets = {"idle: cpu": 0.5, "10 000 tasks: idle MB": 100}
    for figure, values in runs.items():
        kind = figure.split(":")[0]
        unit = {"heap": "allocations", "copies": "copies"}.get(kind, figure.split()[-1])
        # The word count is left out, because a sentence does not fit into a string without an allocation.
        if kind == "heap" and "words" not in figure:
            targets[figure] = NO_ALLOCATION
        if kind == "copies":
            targets[figure] = 0
        report.compare(figure, UNITS.get(unit, unit), {OURS: values}, at_most=targets.get(figure))


def run_runtime(given):
    programs, report = Programs(given.build / "bin", "runtime"), Report()
    rounds, seconds = (2, 0.5) if given.quick else (5, 1.0)
    if PEER not in engines(programs):
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
    return report, report.verdict()


def run_soak(given):
    """Runs the soak program, and passes its progress on to standard error."""
    programs, report = Programs(given.build / "bin", "runtime"), Report()
    command = [str(programs.folder / "bench_runtime_soak"), "--minutes", str(given.minutes)]
    if given.seed is not None:
        command += ["--seed", str(given.seed)]
    done = subprocess.run(command, stdout=subprocess.PIPE, text=True)
    report.print_head()
    for line in map(json.loads, done.stdout.splitlines()):
        report.compare(line["figure"], line["unit"], {OURS: [line["value"]]}, at_most=line.get("at_most"))
    if done.returncode != 0:
        report.fail(f"VIOLATED: the soak ended with status {done.returncode}")
        return report, "what was violated stands above"
    return report, "every tuple is accounted for, no key was out of order, memory stayed flat"

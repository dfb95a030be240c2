"""The figures of `./dev bench runtime` and `./dev bench soak`."""

import json
import statistics
import subprocess

from brokers_report import NOISE
from figures import Programs, Verdict, number
from rounds import Rounds

OURS, CALLS, RING, PEER, BEFORE = "iotcloud", "calls", "ring", "onetbb", "before"
# The first two are limits, the third is a peer, the last is an earlier build of ours, if one is given.
BASELINES = {CALLS: "plain calls", RING: "SPSC rings", PEER: "oneTBB", BEFORE: "earlier build"}
DAGS = {"chain": "chain of 3", "words": "word count", "fan": "fan 1-4-1", "payload": "60 KB chain"}
UNITS = {"cpu": "% of a core", "switches": "switches/s"}
# allocations per tuple that count as none: pools still grow by a few objects when another thread takes part
NO_ALLOCATION = 0.001
LOADS = (1, 50, 90)  # percent of the engine's highest rate
PACE = 100_000  # tuples a second of `paced()`
# Targets, by DAG and whether it is tracked.
RATES = {("chain", False): 25, ("chain", True): 20, ("words", False): 12, ("words", True): 11}  # M/s, on one core
RATES_OF_TWO_SOURCES = {"words": 16}  # M/s, on two cores
RING_SHARES = {("chain", False): 0.3, ("chain", True): 0.25}  # of the rings' rate, in the same round
TIMES_BEFORE = {"fan": 1.8, "payload": 1.8}  # of the earlier build's rate, in the same round
ONE_CORE = 110  # percent of a core at most, when a rate is that of one
TAILS_US = {("p99", 50): 100, ("p99", 90): 5000}
QUIET_US = {"p50": 12, "p99": 33}
PACED_US = {"p50": 0.5}


def engines(programs, *without):
    return [e for e in (OURS, *BASELINES) if e not in without and programs.has(e)]


class WithBefore(Programs):
    """The programs of this build, and our engine of an earlier one: `before` is its program, or None."""

    def __init__(self, folder, prefix, before):
        super().__init__(folder, prefix)
        self.before = before

    def has(self, name):
        return self.before is not None if name == BEFORE else super().has(name)

    def path(self, name):
        return self.before if name == BEFORE else super().path(name)


class Report(Verdict):
    def __init__(self):
        super().__init__()
        self.thrown_away = 0

    def compare(self, name, unit, by_engine, at_least=None, at_most=None):
        """Reports one figure. `by_engine` has a value for each round, for our engine and for each baseline that ran
        beside it. Prints one line of the table and adds a result for each baseline. Without a round it does nothing:
        the reason was told."""
        values = by_engine[OURS]
        if not values:
            return
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

    def compare_ratio(self, name, by_engine, baseline, at_least):
        """Reports the ratio to a baseline as a figure of its own, for it has a target."""
        ratios = [a / b for a, b in zip(by_engine[OURS], by_engine[baseline]) if b]
        self.compare(name, "x", {OURS: ratios}, at_least=at_least)

    @staticmethod
    def print_head():
        beside = "".join(f" {name:>13} {'ratio':>7}" for name in BASELINES.values())
        print(f"{'figure':<47} {'value':>9} {'unit':<11}{beside} {'target':>9} {'met':>4} {'n':>2} {'spread':>6}")

    @staticmethod
    def print_line(beside):
        theirs = {r["baseline"]: r for r in beside}
        columns = "".join(
            f" {number(r.get('baseline_value')):>13} {number(r.get('ratio')):>7}"
            for r in (theirs.get(name, {}) for name in BASELINES.values())
        )
        r = beside[0]
        print(
            f"{r['name']:<47} {number(r['value']):>9} {r['unit']:<11}{columns} {r['target'] or '':>9}"
            f" {number(r['met']):>4} {r['rounds']:>2} {r['spread']:>6.0%}",
            flush=True,
        )


class Scale:
    """How much is measured."""

    def __init__(self, quick, keep_noisy=False):
        self.keep_noisy, self.quick = keep_noisy, quick
        self.rounds, self.latency_rounds, self.costs_rounds = (2, 1, 1) if quick else (5, 5, 3)
        self.seconds, self.quiet_s = (0.5, 2) if quick else (1.0, 5)

    def loads(self, dag):
        return () if self.quick and dag not in ("chain", "words") else LOADS


def title(dag, tracked, sources=1):
    return f"{DAGS[dag]}, {'tracked' if tracked else 'untracked'}{', two sources' * (sources == 2)}"


def turns(programs, report, scale, name, sides, rounds, options_of):
    """Runs rounds in which every engine of `sides` takes a turn with the options `options_of(engine)`. Returns {engine: [a
    line for each quiet round]}."""
    taken = Rounds(name, rounds, sides, scale.keep_noisy)

    def turn(engine):
        line = programs.run(engine, *options_of(engine))[0]
        return {"others_cpu": 0.0, **line}  # an earlier build may not tell

    while taken.wants_more():
        taken.take(turn)
    taken.say_problem(report)
    return taken.lines


def column(lines, figure):
    return {engine: [figure(line) for line in runs] for engine, runs in lines.items()}


def saturation(programs, report, scale, dag, tracked, sources=1):
    """Measures the highest rate. With two `sources` the spout of our engine has two tasks, so that the work is shared out among
    two cores. Returns {engine: results a second}, empty if it could not be measured."""
    name = title(dag, tracked, sources)
    sides = engines(programs, *([] if dag in TIMES_BEFORE else [BEFORE]))
    options = ["--dag", dag, "--warm-up", 0.5, "--seconds", scale.seconds] + ["--tracked"] * tracked
    lines = turns(programs, report, scale, f"{name}: at most", sides, scale.rounds,
                  lambda engine: options + ["--sources", sources] * (engine == OURS))
    target = RATES.get((dag, tracked)) if sources == 1 else RATES_OF_TWO_SOURCES[dag]
    rates = column(lines, lambda line: line["per_second"] / 1e6)
    report.compare(f"{name}: at most", "M words/s" if dag == "words" else "M tuples/s", rates, at_least=target)
    if sources == 1 and (dag, tracked) in RING_SHARES and RING in rates:
        report.compare_ratio(f"{name}: share of the rings' rate", rates, RING, RING_SHARES[dag, tracked])
    if BEFORE in rates:
        report.compare_ratio(f"{name}: times the earlier build's rate", rates, BEFORE, TIMES_BEFORE[dag])
    report.compare(f"{name}: a hop", "ns", column(lines, lambda line: line["ns_per_hop"]))
    report.compare(f"{name}: cpu then", UNITS["cpu"], column(lines, lambda line: line["cpu_percent"]),
                   at_most=ONE_CORE if target is not None and sources == 1 else None)
    return {engine: statistics.median(line["per_second"] for line in runs) for engine, runs in lines.items() if runs}


def numbered(programs, report, scale, tracked, most):
    """Measures our highest rate with words that have their item's number, as they have at a load and as they always have on the
    other engines. Returns `most` with this rate in the place of ours."""
    name = f"{title('words', tracked)}, numbered"
    lines = turns(programs, report, scale, name, (OURS,), scale.rounds,
                  lambda _: ["--dag", "words", "--numbered", "--warm-up", 0.5, "--seconds", scale.seconds, *["--tracked"] * tracked])
    report.compare(f"{name}: at most", "M words/s", column(lines, lambda line: line["per_second"] / 1e6))
    return {**most, OURS: statistics.median(line["per_second"] for line in lines[OURS])} if lines[OURS] else {}


def with_births(programs, report, scale, tracked):
    """Measures our highest rate in the chain when tuples record their birth, as they do for deadlines and where bolts send to
    brokers."""
    name = f"{title('chain', tracked)}, births"
    lines = turns(programs, report, scale, name, (OURS,), scale.rounds,
                  lambda _: ["--births", "--warm-up", 0.5, "--seconds", scale.seconds, *["--tracked"] * tracked])
    report.compare(f"{name}: at most", "M tuples/s", column(lines, lambda line: line["per_second"] / 1e6))


def latency(programs, report, scale, dag, tracked, most, load):
    """Measures latency at a part of each engine's highest rate: from the time at which an item should have been sent to
    the end of the last task (or to the ack). Plain calls are slowed down to our highest rate: what they have, the machine does."""
    def options_of(engine):
        highest = most[OURS if engine == CALLS else engine]
        return ["--dag", dag, "--rate", f"{highest * load / 100:.0f}", "--warm-up", 0.5, "--seconds", scale.seconds,
                *["--tracked"] * tracked, *(["--most", f"{highest:.0f}"] if engine == CALLS else [])]

    name = title(dag, tracked)
    lines = turns(programs, report, scale, f"{name}: at {load} % load", engines(programs, BEFORE), scale.latency_rounds,
                  options_of)
    for quantile in ("p50", "p99", "max"):
        report.compare(f"{name}: {quantile} at {load} % load", "us",
                       column(lines, lambda line, q=quantile: line["latency"][f"{q}_us"]), at_most=TAILS_US.get((quantile, load)))


def quiet(programs, report, scale):
    """Measures the chain at 100 tuples a second. Latency counts from the time at which the source's thread has woken
    up."""
    name = f"{DAGS['chain']} at 100/s"
    lines = turns(programs, report, scale, name, engines(programs, BEFORE), scale.rounds,
                  lambda _: ["--rate", 100, "--warm-up", 0.5, "--seconds", scale.quiet_s])
    for quantile in ("p50", "p99", "max"):
        report.compare(f"{name}: {quantile}", "us", column(lines, lambda line, q=quantile: line["service"][f"{q}_us"]),
                       at_most=QUIET_US.get(quantile))
    for key in ("cpu_percent", "switches_per_second"):
        figure = key.split("_")[0]
        report.compare(f"{name}: {figure}", UNITS[figure], column(lines, lambda line, k=key: line[k]))


def paced(programs, report, scale):
    """Measures the chain at PACE tuples a second, of a source that is awake all the time: from when a tuple was due."""
    name = f"{DAGS['chain']} at {PACE // 1000} k/s"
    lines = turns(programs, report, scale, name, engines(programs, BEFORE), scale.rounds,
                  lambda _: ["--rate", PACE, "--warm-up", 0.5, "--seconds", scale.seconds])
    for quantile in ("p50", "p99", "max"):
        report.compare(f"{name}: {quantile}", "us", column(lines, lambda line, q=quantile: line["latency"][f"{q}_us"]),
                       at_most=PACED_US.get(quantile))


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


def measure(programs, report, scale):
    """Measures all figures but the costs."""
    quiet(programs, report, scale)
    paced(programs, report, scale)
    for dag in DAGS:
        for tracked in (False, True):
            most = saturation(programs, report, scale, dag, tracked)
            if dag == "chain":
                with_births(programs, report, scale, tracked)
            if dag == "words" and most:
                most = numbered(programs, report, scale, tracked, most)
            for load in scale.loads(dag) if most else ():
                latency(programs, report, scale, dag, tracked, most, load)
            if dag in RATES_OF_TWO_SOURCES:
                saturation(programs, report, scale, dag, tracked, sources=2)


def run_runtime(given):
    programs, report = WithBefore(given.build / "bin", "runtime", given.before), Report()
    scale = Scale(given.quick, given.keep_noisy)
    if not programs.has(PEER):
        print("oneTBB's program is not built (libtbb-dev was missing when CMake ran): the peer is left out")
    if not programs.has(BEFORE):
        print("no earlier build is given (--before): by how much fan and 60 KB chain are faster is left out")
    report.print_head()
    costs(programs, report, scale.costs_rounds, 1.0)
    measure(programs, report, scale)
    if report.thrown_away:
        print(f"{report.thrown_away} rounds were thrown away: other processes took more than {NOISE} of a CPU")
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

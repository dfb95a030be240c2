"""The figures of `./dev bench brokers`: the round trip through each broker, ours beside a bare client."""

import re
import statistics
import sys
import tempfile
import time
from pathlib import Path

from figures import ProgramFailed, Programs, Verdict, number
from heartbeat import Line

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "servers"))
from private_cluster import Children, StartError  # noqa: E402

OURS = "iotcloud"
# broker: library of the bare client
BROKERS = {"rabbitmq": "librabbitmq", "kafka": "librdkafka", "activemq": "qpid-proton"}
SIZES = {"100 B": 100, "1 KB": 1000, "10 KB": 10_000, "60 KB": 60_000, "200 KB": 200_000, "1 MB": 1_000_000}
RATES = (10, 50, 100)  # messages a second of each of 4 drivers
MOST = {"100 B": 1000, "60 KB": 64}  # messages under way at the highest rate
# A topic of ours has one partition unless configured otherwise, so one that the bare client makes has, too.
SERVER = {"kafka": ["--throughput", "--partitions", "1"], "activemq": ["--throughput"]}
UNSAFE = ("rabbitmq", "kafka")  # brokers whose bare clients can also run without confirms and acknowledgements
NOISE = 0.2  # CPUs that other processes may take in a round


class Report(Verdict):
    """Prints a line for each figure. Its ratio is the median, over the rounds, of the ratio within one round."""

    def __init__(self):
        super().__init__()
        self.thrown_away = 0
        self.missing = 0  # number of figures that could not be measured

    @staticmethod
    def print_head():
        print(f"{'figure':<46} {'ours':>8} {'unit':<8} {'beside':<18} {'theirs':>8} {'ratio':>6} {'of rounds':>12} "
              f"{'target':>8} {'met':>4} {'n':>2}")

    def compare(self, name, unit, ours, beside=None, theirs=(), ratio_at_least=None, ratio_at_most=None, at_most=None,
                at_least=None):
        """`ours` and `theirs` have a value for each round. The target is for the ratio, or (at_most, at_least) for our
        value."""
        if not ours:
            self.missing += 1  # the reason was printed
            return
        value, ratios = statistics.median(ours), [a / b for a, b in zip(ours, theirs) if b]
        ratio = statistics.median(ratios) if ratios else None
        target = met = None
        if at_most is not None:
            target, met = f"<= {at_most:g}", value <= at_most
        if at_least is not None:
            target, met = f">= {at_least:g}", value >= at_least
        if ratio is not None and ratio_at_least is not None:
            target, met = f">= {ratio_at_least:g} x", ratio >= ratio_at_least
        if ratio is not None and ratio_at_most is not None:
            target, met = f"<= {ratio_at_most:g} x", ratio <= ratio_at_most
        self.results.append({
            "name": name, "value": value, "unit": unit, "baseline": beside,
            "baseline_value": statistics.median(theirs) if theirs else None, "ratio": ratio,
            "ratio_spread": [min(ratios), max(ratios)] if ratios else None, "target": target, "met": met,
            "rounds": len(ours), "spread": (max(ours) - min(ours)) / value if value else 0.0})
        of_rounds = f"{number(min(ratios))}..{number(max(ratios))}" if ratios else ""
        print(f"{name:<46} {number(value):>8} {unit:<8} {beside or '':<18} "
              f"{number(statistics.median(theirs) if theirs else None):>8} {number(ratio):>6} {of_rounds:>12} "
              f"{target or '':>8} {number(met):>4} {len(ours):>2}", flush=True)


class Progress:
    """Tells which figure is being measured and about how long the rest will take."""

    def __init__(self):
        self.began, self.seconds_done, self.seconds_all = time.monotonic(), 0.0, 0.0
        self.line = Line()

    def say(self, text):
        left = ""
        if self.seconds_done:
            spent = time.monotonic() - self.began
            minutes = spent / self.seconds_done * max(0, self.seconds_all - self.seconds_done) / 60
            left = f", about {minutes:.0f} min left"
        self.line.say(text + left)


class Plan:
    """Has the interface of Bench, but measures nothing: it adds up the seconds that one broker's figures will take."""

    def __init__(self, kind, given):
        self.kind, self.bare, self.given = kind, BROKERS[kind], given
        self.rounds = given.rounds or (3 if given.quick else 7)
        self.shorter = 0.6 if given.quick else 1.0
        self.seconds = 0.0

    def run(self, _engine, _options, seconds):
        self.seconds += seconds

    def asked_for(self, title):
        return not self.given.figures or re.search(self.given.figures, f"{self.kind}, {title}") is not None

    def turns(self, title, variants, seconds):
        if self.asked_for(title):
            self.seconds += self.rounds * seconds * self.shorter * len(variants)
        return {name: [] for name in variants}

    def pair(self, title, options, seconds):
        """Runs our client and the bare client with the same options. Returns the lines of both."""
        runs = self.turns(title, {OURS: (OURS, options), self.bare: (self.kind, options)}, seconds)
        return runs[OURS], runs[self.bare]

    def compare(self, *_, **__):
        pass

    def cpu(self, title, ours, theirs):
        self.compare(f"{title}: client CPU", "s/10 000", client_cpu, ours, theirs, ratio_at_most=1.3)
        self.compare(f"{title}: broker CPU", "s/10 000", broker_cpu, ours, theirs)


class Bench(Plan):
    """One broker's private server, and the clients that take turns on it."""

    def __init__(self, kind, url, processes, programs, report, progress, given):
        super().__init__(kind, given)
        self.url, self.programs, self.report, self.progress = url, programs, report, progress
        self.processes = [word for process in processes for word in ("--server", process)]

    def run(self, engine, options, seconds):
        """Runs the client `engine` once. `options` are those of the program, without the dashes."""
        self.progress.seconds_done += seconds
        options = {"warm_up": 0.5 * self.shorter, **options}
        words = ["--name", f"bench-{engine}-{'shared' if options.get('shared') else 'own'}"]
        for name, value in options.items():
            words += [f"--{name.replace('_', '-')}"] + ([] if value is True else [value])
        return self.programs.run(engine, "--url", self.url, *words, "--seconds", seconds, *self.processes)[0]

    def turns(self, title, variants, seconds):
        """Runs rounds in each of which every one of `variants` ({name: (engine, options)}) runs once. Returns {name: [a
        line for each round]}, without the rounds in which other processes took more than NOISE CPUs. There are no
        lines when the load is more than a variant can sustain, when one failed, or when the figure is not among
        those asked for."""
        kept, thrown = {name: [] for name in variants}, 0
        if not self.asked_for(title):
            return kept
        for attempt in range(2 * self.rounds):
            if len(kept[OURS]) == self.rounds:
                break
            self.progress.say(f"{self.kind}, {title}, round {attempt + 1}")
            order = list(variants) if attempt % 2 == 0 else list(reversed(variants))
            try:
                lines = {name: self.run(*variants[name], seconds * self.shorter) for name in order}
            except ProgramFailed as failure:  # the other figures are still worth knowing
                self.report.fail(f"{self.kind}, {title}: GIVEN UP: {failure}")
                kept = {name: [] for name in variants}
                break
            if not self.given.keep_noisy and max(line["others_cpu"] for line in lines.values()) > NOISE:
                thrown += 1
                continue
            stalled = [name for name, line in lines.items() if line["count"] == 0 and not variants[name][1].get("idle")]
            if stalled:
                self.report.fail(f"{self.kind}, {title}: nothing came back to {' and '.join(stalled)} in a whole round")
                continue
            late = [name for name, line in lines.items() if not line["sustained"]]
            if late:
                print(f"{self.kind}, {title}: more than {' and '.join(late)} can send through it", flush=True)
                kept = {name: [] for name in variants}
                break
            for name, line in lines.items():
                kept[name].append(line)
        self.report.thrown_away += thrown
        if thrown and not kept[OURS]:
            print(f"{self.kind}, {title}: no round was quiet", flush=True)
        return kept

    def compare(self, figure, unit, of, ours, theirs, beside=None, **target):
        if not self.asked_for(figure):
            return
        self.report.compare(f"{self.kind}, {figure}", unit, [of(line) for line in ours], beside or self.bare,
                            [of(line) for line in theirs], **target)


def p50(line):
    return line["p50_us"] / 1000


def p99(line):
    return line["p99_us"] / 1000


def per_second(line):
    return line["per_second"]


def client_cpu(line):
    return line["cpu_seconds"] / line["count"] * 10_000


def broker_cpu(line):
    return line["server_cpu_seconds"] / line["count"] * 10_000


def both_cpus(line):
    return (line["cpu_seconds"] + line["server_cpu_seconds"]) / line["seconds"]


def idle(bench, layout):
    ours, theirs = bench.pair("idle", {**layout, "idle": True}, 2)
    bench.compare("connected and idle: client CPU", "%", lambda line: 100 * line["cpu_seconds"] / line["seconds"],
                  ours, theirs, at_most=0.5)


def closed_loop(bench, layout):
    """The round trip with 8 messages under way, which has the targets."""
    for size in ("100 B", "60 KB"):
        options = {**layout, "size": SIZES[size], "under_way": 8}
        variants = {OURS: (OURS, options), bench.bare: (bench.kind, options)}
        without = f"{bench.bare} unsafe"
        if bench.kind in UNSAFE:
            variants[without] = (bench.kind, {**options, "no_confirms": True, "no_acknowledgements": True})
        title = f"{size}, 8 under way"
        runs = bench.turns(title, variants, 2)
        gate = {"ratio_at_least": 0.9} if bench.kind == "rabbitmq" else {}
        bench.compare(f"{title}: rate", "/s", per_second, runs[OURS], runs[bench.bare], **gate)
        if without in runs:
            bench.compare(f"{title}: rate", "/s", per_second, runs[OURS], runs[without], without)
        bench.cpu(title, runs[OURS], runs[bench.bare])


def most(bench, layout):
    for size, under_way in MOST.items():
        title = f"{size}, {under_way} under way"
        ours, theirs = bench.pair(title, {**layout, "size": SIZES[size], "under_way": under_way}, 2)
        bench.compare(f"{title}: rate", "/s", per_second, ours, theirs)
        bench.cpu(title, ours, theirs)


def paced(bench, layout, sizes, rates):
    for size in sizes:
        for rate in rates:
            title = f"{size}, 4 x {rate}/s"
            ours, theirs = bench.pair(title, {**layout, "size": SIZES[size], "rate": rate}, 3 if rate < 50 else 2)
            small = SIZES[size] <= 200_000
            half = {"ratio_at_most": 1.15} if bench.kind == "kafka" or (bench.kind == "rabbitmq" and small) else {}
            tail = {"ratio_at_most": 1.3} if bench.kind == "rabbitmq" and small else {}
            bench.compare(f"{title}: p50", "ms", p50, ours, theirs, **half)
            bench.compare(f"{title}: p99", "ms", p99, ours, theirs, **tail)
            if rate == max(rates):
                bench.cpu(title, ours, theirs)


def many_drivers(bench, layouts):
    """1000 drivers in one process, beside 4 of them, with little to do and with as many messages in all, and beside the
    bare client."""
    for layout in layouts:
        many = {**layout, "drivers": 1000, "rate": 5, "warm_up": 2}
        few = {f"4 x {rate}/s": (OURS, {**layout, "drivers": 4, "rate": rate}) for rate in (100, 1250)}
        kind = "shared" if layout else "exclusive"
        title = f"1000 x 5/s, {kind}"
        runs = bench.turns(title, {OURS: (OURS, many), bench.bare: (bench.kind, many), **few}, 6)
        bench.compare(f"{title}: p50", "ms", p50, runs[OURS], runs[bench.bare])
        bench.compare(f"{title}: p99", "ms", p99, runs[OURS], runs[bench.bare])
        for name in few:
            bench.compare(f"{title}: p99", "ms", p99, runs[OURS], runs[name], f"ours, {name}", ratio_at_most=1.5)
        bench.cpu(title, runs[OURS], runs[bench.bare])
        bench.compare(f"{title}: CPUs of client and broker", "CPUs", both_cpus, runs[OURS], runs[bench.bare])


def figures(bench, quick):
    # A Kafka topic is never exclusive.
    layout = {"shared": True} if bench.kind == "kafka" else {}
    layouts = [{"shared": True}] if bench.kind == "kafka" else [{"shared": True}, {}]
    # runs both clients before the first round, so that the server's JVM has compiled the code that they use
    for engine in (OURS, bench.kind):
        bench.run(engine, {**layout, "under_way": 100}, 2 if bench.kind == "rabbitmq" else 6)
    idle(bench, layout)
    closed_loop(bench, layout)
    paced(bench, layout, ("100 B", "60 KB") if quick else SIZES, (100,) if quick else RATES)
    most(bench, layout)
    many_drivers(bench, layouts[:1] if quick else layouts)


def run_brokers(given):
    programs, report, progress = Programs(given.build / "bin", "brokers"), Report(), Progress()
    kinds = [kind for kind in BROKERS if not given.only or kind in given.only]
    for kind in filter(programs.has, kinds):
        plan = Plan(kind, given)
        figures(plan, given.quick)
        progress.seconds_all += plan.seconds
    report.print_head()
    for kind in kinds:
        if not programs.has(kind):
            print(f"{kind}: left out, its bare client is not built")
            continue
        with tempfile.TemporaryDirectory(prefix="iotcloud-bench-") as folder, Children(folder) as servers:
            try:
                url = servers.server(kind, *SERVER.get(kind, []))
            except StartError as error:
                print(f"{kind}: left out, {error}")
                continue
            bench = Bench(kind, url, servers.descendants(), programs, report, progress, given)
            try:
                figures(bench, given.quick)
            except ProgramFailed as failure:  # what the other brokers can do is still worth knowing
                report.fail(f"{kind}: GIVEN UP: {failure}")
    if report.thrown_away:
        print(f"{report.thrown_away} rounds were thrown away: other processes took more than {NOISE} of a CPU")
    if report.missing:
        print(f"{report.missing} figures are missing: no round was quiet, or the load was too much")
    if given.keep_noisy:
        print("--keep-noisy: rounds with company count as well")
    return report, report.verdict() + ("\n  FAILED, see above" if report.failed else "")

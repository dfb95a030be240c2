"""The figures of `./dev bench storm`: ours beside Apache Storm, on the same broker, in memory and on a cluster."""

import statistics
import sys
import tempfile
from pathlib import Path

from brokers_report import NOISE, broker_cpu, p50, p99
from figures import ProgramFailed, number
from paper.points import asked_for, bytes_text
from rounds import Rounds

sys.path.insert(0, str(Path(__file__).resolve().parent / "peers"))
from local_storm import build  # noqa: E402
from storm_cluster import Cluster  # noqa: E402
from storm_cluster_report import ClusterMeasurement, ClusterScale  # noqa: E402
from storm_turns import BARE, DEFAULTS, DRIVERS, OURS, SETTLE_S, STORM, TUNED, StartError, Turns  # noqa: E402

POINTS = [(size, rate) for size in (100, 60_000) for rate in (20, 100)]
NAMES = {"words": ("word count", "M words/s"), "chain": ("chain of 3", "M tuples/s")}
KINDS = {OURS: "ours", STORM: "peer", BARE: "limit"}  # kind of each side's curve in the plots
LIBRARY = "librabbitmq"
TAIL_TARGET, CPU_TARGET = 1 / 3, 1 / 5  # targets: share of Storm's
RATE_TARGETS = {("words", False): 5, ("words", True): 12}  # targets: times Storm's
START_S = 8  # how long a JVM with Storm needs until its topology works
STATISTICS = {"mean_ms": "mean_us", "p50_ms": "p50_us", "p99_ms": "p99_us", "stddev_ms": "stddev_us"}


def tracking(tracked):
    return "tracked" if tracked else "untracked"


def echo_title(size, rate, tracked):
    return f"{bytes_text(size)}, {DRIVERS} x {rate}/s, {tracking(tracked)}"


def memory_title(dag, tracked):
    return f"{NAMES[dag][0]}, {tracking(tracked)}"


class Scale:
    """How much is measured: rounds, seconds, and the phases (topology, tracked, setting). `asked_for(title)` says
    whether a figure is to be measured."""

    def __init__(self, scale, rounds=None, asked_for=lambda _title: True, keep_noisy=False):
        quick = scale == "quick"
        self.keep_noisy = keep_noisy
        self.rounds = rounds or {"quick": 2, "usual": 3, "full": 7}[scale]
        self.warm_up_s = 6 if quick else 20
        self.echo_s, self.memory_s = (2, 1.5) if quick else (5, 3)
        if quick:
            self.phases = [("echo", True, TUNED), ("words", False, TUNED), ("words", True, TUNED), ("chain", False, TUNED)]
        else:
            self.phases = [(topology, tracked, setting) for topology in ("echo", "words", "chain")
                           for tracked in (True, False) for setting in (TUNED, DEFAULTS)]
        self.asked_for = asked_for
        self.phases = [phase for phase in self.phases if phase[0] == "echo" and self.points(*phase[1:])
                       or phase[0] != "echo" and asked_for(f"{memory_title(*phase[:2])}, {phase[2]}")]

    def points(self, tracked, setting):
        """The echo's points (size, rate) that are to be measured."""
        return [point for point in POINTS if self.asked_for(f"{echo_title(*point, tracked)}, {setting}")]

    def round_s(self, topology):
        if topology == "echo":
            return 3 * (self.echo_s + SETTLE_S["echo"])
        return 2 * (self.memory_s + SETTLE_S["memory"])

    def warm_up_of(self, topology):
        return START_S + self.warm_up_s

    def seconds(self):
        pairs = {phase: len(self.points(*phase[1:])) if phase[0] == "echo" else 1 for phase in self.phases}
        return sum(self.warm_up_of(phase[0]) + self.rounds * count * self.round_s(phase[0])
                   for phase, count in pairs.items())


def point_of(x, rounds, side):
    """A point of a plot: medians, the largest maximum and sums over the rounds."""
    lines = rounds.lines[side]
    if not lines:
        return {"x": x, "failed": rounds.problem.splitlines()[-1] if rounds.problem else "no round was quiet"}
    point = {"x": x, **{name: statistics.median(line[key] for line in lines) / 1000 for name, key in STATISTICS.items()}}
    return {**point, "max_ms": max(line["max_us"] for line in lines) / 1000, "n": sum(line["count"] for line in lines),
            "lost": sum(line["lost"] for line in lines),
            **({} if side == BARE else {"processor_cpu_s": statistics.median(map(processor_cpu, lines)) / 1e6}),
            "broker_cpu_s": statistics.median(map(broker_cpu, lines)) / 1e4}


def processor_cpu(line):
    """CPU time for a message, in microseconds, of the process that sends it back."""
    return 1e6 * line["processor_cpu_seconds"] / line["count"]


class Measurement:
    """Runs all phases, adds their figures to a report, and keeps what is plotted."""

    def __init__(self, turns, scale, report, progress):
        self.turns, self.scale, self.report, self.progress = turns, scale, report, progress
        self.curves, self.rates, self.table = {}, {}, []

    def run(self):
        for phase in self.scale.phases:
            topology, tracked, setting = phase
            self.progress.step(f"{topology}, {tracking(tracked)}, {setting}: warm-up", self.scale.warm_up_of(topology))
            try:
                (self.echo if topology == "echo" else self.memory)(*phase)
            except (StartError, ProgramFailed) as failure:  # the other phases are measured in any case
                self.report.fail(f"{topology}, {tracking(tracked)}, {setting}: GIVEN UP: {failure}")
        self.print_table()
        return self.plots()

    def take(self, rounds, topology, turn):
        self.progress.step(f"{rounds.title}, round {rounds.taken + 1}", self.scale.round_s(topology))
        rounds.take(turn)

    def echo(self, _topology, tracked, setting):
        all_rounds = {point: Rounds(echo_title(*point, tracked), self.scale.rounds, (OURS, STORM, BARE), self.scale.keep_noisy)
                      for point in self.scale.points(tracked, setting)}
        with self.turns.echo(tracked, setting, self.scale.warm_up_s):
            while any(rounds.wants_more() for rounds in all_rounds.values()):
                for (size, rate), rounds in all_rounds.items():
                    if rounds.wants_more():
                        self.take(rounds, "echo", lambda side: self.turns.echo_turn(side, size, rate, self.scale.echo_s))
        for (size, rate), rounds in all_rounds.items():
            self.judge_echo(rounds, setting)
            for side, name in ((OURS, "IoTCloud"), (STORM, setting), (BARE, LIBRARY)):
                point = point_of(size, rounds, side)
                curve = self.curves.setdefault((tracked, name, rate, side), [])
                # ours and the bare client are measured beside each of Storm's settings, and plotted once
                if size not in [each["x"] for each in curve]:
                    curve.append(point)
                self.table.append((f"{rounds.title}: {name}" + f" beside {setting}" * (side != STORM), point))

    def judge_echo(self, rounds, setting):
        rounds.say_problem(self.report)

        def compare(name, unit, figure, **target):
            self.report.compare(f"{rounds.title}: {name}", unit, rounds.of(OURS, figure), setting,
                                rounds.of(STORM, figure), **target)

        compare("p50", "ms", p50)
        compare("p99", "ms", p99, ratio_at_most=TAIL_TARGET)
        self.report.compare(f"{rounds.title}: p99", "ms", rounds.of(OURS, p99), LIBRARY, rounds.of(BARE, p99))
        compare("CPU", "us/msg", processor_cpu, ratio_at_most=CPU_TARGET)
        # broker_cpu() is in s for 10 000 messages
        compare("broker's CPU", "us/msg", lambda line: 100 * broker_cpu(line))

    def memory(self, dag, tracked, setting):
        _, unit = NAMES[dag]
        rounds = Rounds(memory_title(dag, tracked), self.scale.rounds, (OURS, STORM), self.scale.keep_noisy)
        with self.turns.memory(dag, tracked, setting, self.scale.warm_up_s):
            while rounds.wants_more():
                self.take(rounds, dag, lambda side: self.turns.memory_turn(side, dag, tracked, self.scale.memory_s))
        rounds.say_problem(self.report)

        def compare(figure, unit, of, **target):
            self.report.compare(f"{rounds.title}: {figure}", unit, rounds.of(OURS, of), setting, rounds.of(STORM, of),
                                **target)

        target = RATE_TARGETS.get((dag, tracked))
        compare("rate", unit, lambda line: line["per_second"] / 1e6, **({"ratio_at_least": target} if target else {}))
        compare("CPUs then", "CPUs", lambda line: line["cpus"])
        for side in (OURS, STORM):
            key = (dag, setting if side == STORM else "IoTCloud", side)
            values = rounds.of(side, lambda line: line["per_second"])
            if values and tracking(tracked) not in [each["x"] for each in self.rates.setdefault(key, [])]:
                self.rates[key].append({"x": tracking(tracked), "per_second": statistics.median(values), "n": len(values)})

    def print_table(self):
        """Prints every point with all its values."""
        if not self.table:
            return
        print(f"\n{'round trip, ms':<60} {'mean':>7} {'p50':>7} {'p99':>7} {'max':>7} {'stddev':>7} {'n':>6} {'lost':>5} "
              f"{'CPU us/msg':>10}")
        for name, point in self.table:
            if "failed" in point:
                print(f"{name:<60} {point['failed']}")
                continue
            values = " ".join(f"{point[key]:>7.3f}" for key in ("mean_ms", "p50_ms", "p99_ms", "max_ms", "stddev_ms"))
            print(f"{name:<60} {values} {point['n']:>6} {point['lost']:>5} "
                  f"{number(1e6 * point['processor_cpu_s']) if 'processor_cpu_s' in point else '':>10}")
        sys.stdout.flush()

    def plots(self):
        made = []
        for statistic, word in (("p50_ms", "median"), ("p99_ms", "99th percentile")):
            for tracked in sorted({key[0] for key in self.curves}, reverse=True):
                series = [{"name": f"{name}, {rate}/s", "kind": KINDS[side], "points": points}
                          for (kind, name, rate, side), points in self.curves.items() if kind == tracked]
                made.append({"title": f"Round trip on RabbitMQ, {tracking(tracked)}: {word}", "x": "message size",
                             "x_unit": "B", "x_log": True, "y": f"round trip, {word}", "y_unit": "ms", "y_log": True,
                             "statistic": statistic, "series": series})
        for dag in dict.fromkeys(key[0] for key in self.rates):
            name, unit = NAMES[dag]
            series = [{"name": who, "kind": KINDS[side], "points": points}
                      for (of, who, side), points in self.rates.items() if of == dag]
            made.append({"title": f"{name} in memory", "x": "", "y": "results a second", "y_unit": "/s",
                         "y_log": True, "statistic": "per_second", "series": series})
        return made


class StormFigure:
    """A figure of `./dev bench paper`."""

    name, title, broker, servers = "storm", "the same application beside Apache Storm", "rabbitmq", ("rabbitmq", "storm")

    @staticmethod
    def scales(given):
        """How much is measured of both parts: in one process, and on a cluster."""
        more = (given.scale, given.rounds, lambda title: asked_for(given, title), getattr(given, "keep_noisy", False))
        return Scale(*more), ClusterScale(*more)

    def seconds(self, given):
        return sum(scale.seconds() for scale in self.scales(given))

    def take(self, given, report, progress):
        scale, cluster_scale = self.scales(given)
        if not scale.phases and not cluster_scale.phases:
            return []
        class_path, plots = build(), []
        with tempfile.TemporaryDirectory(prefix="iotcloud-bench-") as folder:
            if scale.phases:
                with Turns(given.build / "bin", Path(folder) / "local", class_path) as turns:
                    plots += Measurement(turns, scale, report, progress).run()
            if cluster_scale.phases:
                with Cluster(given.build, Path(folder) / "cluster", class_path) as cluster:
                    plots += ClusterMeasurement(cluster, cluster_scale, report, progress).run()
        if report.thrown_away:
            print(f"{report.thrown_away} rounds were thrown away: other processes took more than {NOISE} of a CPU")
        return plots


FIGURE = StormFigure()


def add_options(command, root):
    scale = command.add_mutually_exclusive_group()
    scale.add_argument("--quick", action="store_true", help="tuned Storm only, fewer and shorter rounds")
    scale.add_argument("--full", action="store_true", help="seven rounds")
    command.add_argument("--rounds", type=int, help="default: 3, with --quick 2, with --full 7; on a cluster 5, 3 and 7")
    command.add_argument("--points", metavar="REGEX", help="those in whose name this is found, as in "
                         "'60 KB, 4 x 100/s, tracked, Storm, tuned' or 'on Storm, chain of 3, 2 workers, acked'; the "
                         "file has no others then")
    command.add_argument("--keep-noisy", action="store_true", help="rounds in which other processes took much CPU count, too")
    command.add_argument("--soak", action="store_const", dest="figure", const=["storm-soak"], help="only this: does the memory of "
                         "Storm's workers with components of C++ grow under load?")
    command.add_argument("--turtlebot", action="store_const", dest="figure", const=["storm-turtlebot"], help="only this: how soon "
                         "does the TurtleBot obey when its topology is on Storm, beside our own worker?")
    command.add_argument("--minutes", type=float, help="of --soak; default: 20")
    command.add_argument("--out", type=Path, default=root / "build/bench/paper", help="where the figure's file goes")
    command.set_defaults(figure=[FIGURE.name], broker=None)

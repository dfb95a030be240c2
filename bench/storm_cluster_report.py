"""The part of `./dev bench storm` that runs on a real cluster: components of C++ in Storm's workers beside the same in plain
Java there, and beside our own worker."""

import statistics

from brokers_report import p50, p99
from figures import ProgramFailed
from rounds import Rounds
from storm_cluster import CPP, JAVA, LOADS, OWN, SETTLE_S, StartError
from storm_board import FULL

RATE_TARGET, CPU_TARGET, LATENCY_TARGET = 0.9, 1.2, 1.0  # targets: times plain Java's
PACE = 1000  # items a second at which latency is measured
PACED = ("chain", "1 KiB")  # the loads whose latency is measured
KINDS = {CPP: "ours", JAVA: "peer", OWN: "limit"}  # kind of each side's curve in the plots
SUBMIT_S = 10  # about how long a topology takes until it works


def acked(tracked):
    return "acked" if tracked else "not acked"


def title_of(load, workers, tracked):
    return f"on Storm, {LOADS[load].name}, {workers} worker{'s' * (workers > 1)}, {acked(tracked)}"


def paced_title(title):
    return f"{title}, {PACE}/s"


def sides_of(workers):
    """Our own worker is one process, which hands nothing to another one."""
    return (CPP, JAVA, OWN) if workers == 1 else (CPP, JAVA)


class ClusterScale:
    """How much is measured: rounds, seconds, and the phases (load, workers, tracked). `asked_for(title)` says whether a
    figure is to be measured."""

    def __init__(self, scale, rounds=None, asked_for=lambda _title: True, keep_noisy=False):
        quick = scale == "quick"
        self.rounds = rounds or {"quick": 3, "usual": 5, "full": 7}[scale]
        self.warm_up_s, self.turn_s, self.keep_noisy = 10 if quick else 20, 3 if quick else 4, keep_noisy
        if quick:
            phases = [("chain", 1, True), ("words", 1, False), ("words", 2, True), ("100 KB", 1, True)]
        else:
            phases = [(load, workers, tracked) for load in LOADS for workers in (1, 2) for tracked in (True, False)]
        self.asked_for = asked_for
        self.phases = [phase for phase in phases if self.titles(*phase)]

    def titles(self, load, workers, tracked):
        """Those of the phase's figures that are to be measured: at the highest rate, and at PACE."""
        title = title_of(load, workers, tracked)
        paced = [paced_title(title)] if tracked and load in PACED else []
        return [each for each in [title, *paced] if self.asked_for(each)]

    def warm_up_of(self, workers):
        return len(sides_of(workers)) * (SUBMIT_S + self.warm_up_s)

    def round_s(self, workers):
        return len(sides_of(workers)) * (SETTLE_S + self.turn_s)

    def seconds(self):
        return sum(self.warm_up_of(phase[1]) + len(self.titles(*phase)) * self.rounds * self.round_s(phase[1])
                   for phase in self.phases)


class ClusterMeasurement:
    """Runs all phases, adds their figures to a report, and keeps what is plotted."""

    def __init__(self, cluster, scale, report, progress):
        self.cluster, self.scale, self.report, self.progress = cluster, scale, report, progress
        self.rates = {}  # points by (workers, tracked) and side

    def run(self):
        for phase in self.scale.phases:
            title = title_of(*phase)
            self.progress.step(f"{title}: warm-up", self.scale.warm_up_of(phase[1]))
            try:
                self.measure(*phase)
            except (StartError, ProgramFailed) as failure:  # the other phases are measured in any case
                self.report.fail(f"{title}: GIVEN UP: {failure}")
        return self.plots()

    def measure(self, load, workers, tracked):
        sides, title = sides_of(workers), title_of(load, workers, tracked)
        wanted = {each: Rounds(each, self.scale.rounds, sides, self.scale.keep_noisy)
                  for each in self.scale.titles(load, workers, tracked)}
        with self.cluster.phase(load, workers, tracked, self.scale.warm_up_s, sides):
            for rounds in wanted.values():
                rate = FULL if rounds.title == title else PACE
                while rounds.wants_more():
                    self.progress.step(f"{rounds.title}, round {rounds.taken + 1}", self.scale.round_s(workers))
                    rounds.take(lambda side, rate=rate: self.cluster.turn(side, rate, self.scale.turn_s))
        for rounds in wanted.values():
            rounds.say_problem(self.report)
            (self.judge_rate if rounds.title == title else self.judge_latency)(rounds, LOADS[load].unit)
        if title in wanted:
            self.keep(load, workers, tracked, wanted[title])

    def compare(self, rounds, name, unit, figure, **target):
        """Beside plain Java, for which the target is, and beside our own worker."""
        for side in rounds.sides[1:]:
            self.report.compare(f"{rounds.title}: {name}", unit, rounds.of(CPP, figure), side, rounds.of(side, figure),
                                **(target if side == JAVA else {}))

    def judge_rate(self, rounds, unit):
        self.compare(rounds, "rate", f"k {unit}s/s", lambda line: line["per_second"] / 1000, ratio_at_least=RATE_TARGET)
        self.compare(rounds, "CPU", f"us/{unit}", cpu, ratio_at_most=CPU_TARGET)

    def judge_latency(self, rounds, unit):
        for name, figure in (("p50", p50), ("p99", p99)):
            self.compare(rounds, name, "ms", figure, ratio_at_most=LATENCY_TARGET)
        self.compare(rounds, "CPU", f"us/{unit}", cpu)

    def keep(self, load, workers, tracked, rounds):
        for side in rounds.sides:
            values = rounds.of(side, lambda line: line["per_second"])
            point = {"x": LOADS[load].name}
            if values:
                point |= {"per_second": statistics.median(values), "cpu_us": statistics.median(rounds.of(side, cpu)),
                          "n": len(values)}
            else:
                point |= {"failed": rounds.problem.splitlines()[-1] if rounds.problem else "no round was quiet"}
            self.rates.setdefault((workers, tracked), {}).setdefault(side, []).append(point)

    def plots(self):
        return [{"title": f"In workers of a cluster: results a second, {workers} worker{'s' * (workers > 1)}, {acked(tracked)}",
                 "x": "", "y": "results a second", "y_unit": "/s", "y_log": True, "statistic": "per_second",
                 "series": [{"name": side, "kind": KINDS[side], "points": points} for side, points in of_sides.items()]}
                for (workers, tracked), of_sides in self.rates.items()]


def cpu(line):
    """CPU time of the workers for a result, in microseconds."""
    return line["cpu_us"]

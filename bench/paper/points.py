"""Shared by the paper's figures: rounds in pairs, points of a curve, and the progress line."""

import re
import statistics
import time

from figures import ProgramFailed, number
from heartbeat import Line

NOISE = 0.2  # CPUs that other processes may take in a round
STATISTICS = ("mean_ms", "p50_ms", "p99_ms", "stddev_ms")


class Progress:
    """Tells which point is being measured and about how long the rest will take."""

    def __init__(self, seconds):
        self.all_s, self.done_s, self.figure_s = seconds, 0.0, 0.0
        self.began = time.monotonic()
        self.line = Line()

    def step(self, text, seconds):
        """Says what begins now. `seconds`: about how long it will take."""
        done = self.done_s + self.figure_s
        spent = time.monotonic() - self.began
        pace = spent / done if done > 10 else 1.0
        self.figure_s += seconds
        self.line.say(f"{text}, about {max(0.0, self.all_s - done) * pace / 60:.1f} min left")

    def figure_done(self, seconds):
        """Replaces the seconds that were expected for this figure's steps by `seconds`."""
        self.done_s, self.figure_s = self.done_s + seconds, 0.0


class Pair:
    """Rounds of one load, in each of which our system and the bare client run in turns."""

    def __init__(self, title):
        self.title, self.ours, self.theirs = title, [], []
        self.our_problem = self.their_problem = None
        self.noisy = 0  # number of rounds that count although other processes took more than NOISE CPUs

    def round(self, ours, theirs, attempts=2):
        """Runs one round; which side begins alternates. If other processes took more than NOISE CPUs, the round is run
        again, and the quieter one counts. `ours` and `theirs` measure and return a line; `theirs` may be None."""
        tried = []
        for _ in range(attempts):
            turn = self.turn(ours, theirs)
            if self.our_problem:
                self.theirs += [line for line in turn if line]  # the bare client's line is kept
                return
            company = max(line["others_cpu"] for line in turn if line)
            tried.append((company, turn))
            if company <= NOISE:
                break
        company, (our_line, their_line) = min(tried, key=lambda one: one[0])
        self.noisy += company > NOISE
        self.ours.append(our_line)
        if their_line:
            self.theirs.append(their_line)

    def turn(self, ours, theirs):
        lines = {}
        order = [("ours", ours), ("theirs", theirs)]
        for name, measure in order if len(self.ours) % 2 == 0 else reversed(order):
            lines[name] = None
            if measure is None or (name == "theirs" and self.their_problem):
                continue
            try:
                lines[name] = measure()
            except ProgramFailed as failure:
                if name == "ours":
                    self.our_problem = str(failure)
                else:
                    self.their_problem, self.theirs = str(failure), []
        return lines["ours"], lines["theirs"]

    def compare(self, report, beside, statistic="mean_ms", **target):
        """Adds a line for this statistic to the report, or the reason why there is none. A lost message fails the run."""
        lost = sum(line["lost"] for line in self.ours)
        if lost:
            report.fail(f"{self.title}: {lost} of {sum(line['n'] for line in self.ours) + lost} did not come back")
        for who, problem in (("", self.our_problem), (f" {beside}:", self.their_problem)):
            if problem:
                report.fail(f"{self.title}:{who} NOT SERVED: {problem}")
        if self.noisy:
            print(f"{self.title}: other processes took more than {NOISE} of a CPU in {self.noisy} rounds", flush=True)
        if self.our_problem:
            return
        name = statistic.removesuffix("_ms").replace("stddev", "standard deviation")
        report.compare(f"{self.title}: {name}", "ms", [line[statistic] for line in self.ours], beside,
                       [line[statistic] for line in self.theirs], **target)


def point(x, lines, problem=None):
    """A point of a curve: the medians over the rounds, and the rounds themselves."""
    if problem or not lines:
        return {"x": x, "failed": problem or "it was not measured"}
    medians = {name: statistics.median(line[name] for line in lines) for name in STATISTICS}
    return {"x": x, **medians, "max_ms": max(line["max_ms"] for line in lines),
            "n": sum(line["n"] for line in lines), "lost": sum(line["lost"] for line in lines),
            "rounds": [{name: line[name] for name in (*STATISTICS, "max_ms", "n", "lost", "others_cpu")} for line in lines]}


def attempts(given):
    """How often a round is run at most when it is noisy; a quick run does not repeat rounds."""
    return 1 if given.scale == "quick" else 2


def asked_for(given, title):
    return not given.points or re.search(given.points, title) is not None


def series(name, kind, points):
    return {"name": name, "kind": kind, "points": points}


def bytes_text(size):
    return f"{size} B" if size < 1000 else f"{number(size / 1000)} KB" if size < 1_000_000 else f"{number(size / 1e6)} MB"

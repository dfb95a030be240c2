"""The figure of `./dev bench storm --soak`: does the memory of Storm's workers with components of C++ grow under load?"""

import os
import re
import statistics
import tempfile
import time
from pathlib import Path

from figures import ProgramFailed
from local_storm import build
from storm_board import FULL
from storm_cluster import CPP, LOADS, WORKER_JVM, Cluster
from storm_cluster_report import SUBMIT_S

LOAD, WORKERS, SHARE = "words", 2, 0.8
WARM_UP_S, MOST_S, PERIOD_S = 30, 10, 2
USUAL_MINUTES = 20
MOST_GROWTH_MB = 8  # target, as of ./dev bench soak
# The whole heap is resident from the start, so what grows is memory beside it; its collections say what stays in it.
JVM = WORKER_JVM + " -XX:+AlwaysPreTouch -Xlog:gc:file=artifacts/gc.log:uptime:filecount=0"
COLLECTION = re.compile(r"^\[(?P<at>[\d.]+)s\].* Pause .*->(?P<mb>\d+)M\(", re.M)


def growth(samples):
    """From the median of the second quarter to that of the last one; the first quarter is a warm-up. 0 for few samples."""
    quarter = len(samples) // 4
    return statistics.median(samples[3 * quarter:4 * quarter]) - statistics.median(samples[quarter:2 * quarter]) if quarter else 0


def slope(times, samples):
    """Of the straight line that fits the last three quarters best."""
    first = len(samples) // 4
    times, samples = times[first:], samples[first:]
    if len(set(times)) < 2:
        return 0
    return statistics.linear_regression(times, samples).slope


def resident_mb(process):
    return int(Path(f"/proc/{process}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def alive_mb(log):
    """What was in the heap after each collection, in the order of time."""
    return [int(found["mb"]) for found in COLLECTION.finditer(log)]


class Soak:
    """A topology in Storm's workers under a steady load. `now` and `sleep`: those of the module time."""

    def __init__(self, cluster, minutes, report, progress, now=time.monotonic, sleep=time.sleep):
        self.cluster, self.seconds, self.report, self.progress = cluster, minutes * 60, report, progress
        self.now, self.sleep = now, sleep

    def run(self):
        load = LOADS[LOAD]
        self.progress.step("warm-up", SUBMIT_S + WARM_UP_S + MOST_S)
        with self.cluster.phase(LOAD, WORKERS, True, WARM_UP_S, (CPP,)):
            most = self.cluster.turn(CPP, FULL, MOST_S)["per_second"]
            side = self.cluster.sides[CPP]
            pace = max(1, round(SHARE * most / load.results))
            times, memory, line = self.hold(side, pace)
            heap = [alive_mb(log) for log in self.cluster.logs("gc.log")]
        title = f"{load.name}, {WORKERS} workers, {100 * SHARE:.0f} % load"
        self.report.compare(f"{title}: carried", f"k {load.unit}s/s", [line["per_second"] / 1000], "sent",
                            [pace * load.results / 1000], ratio_at_least=0.99)
        self.report.compare(f"{title}: memory of a worker", "MB", [max(samples[-1] for samples in memory)])
        self.report.compare(f"{title}: growth of a worker's memory", "MB", [max(map(growth, memory))], at_most=MOST_GROWTH_MB)
        self.report.compare(f"{title}: slope of a worker's memory", "MB/h", [3600 * max(slope(times, each) for each in memory)])
        self.report.compare(f"{title}: growth of a heap after collections", "MB", [max(map(growth, heap), default=0)])
        return [{"title": f"Memory of Storm's workers, {title}", "x": "time", "x_unit": "s", "y": "resident", "y_unit": "MB",
                 "statistic": "mb", "series": [{"name": f"worker {number}", "kind": "ours",
                                                "points": [{"x": at, "mb": mb, "n": 1} for at, mb in zip(times, samples)]}
                                               for number, samples in enumerate(memory, 1)]}]

    def hold(self, side, pace):
        """Lets the topology carry the load. Returns the times, the memory of each worker at them, and what was carried."""
        side.go_on()
        side.board.send(pace)
        processes, times, began = side.processes(), [], self.now()
        memory, before = [[] for _ in processes], side.board.counts()
        while (at := self.now() - began) < self.seconds:
            self.progress.step(f"{pace}/s, {at / 60:.1f} min", PERIOD_S)
            self.sleep(PERIOD_S)
            times.append(self.now() - began)
            for samples, process in zip(memory, processes):
                samples.append(resident_mb(process))
        carried = (side.board.counts() - before).results / (self.now() - began)
        if sorted(side.processes()) != sorted(processes):
            raise ProgramFailed(f"a worker ended under load{self.cluster.errors()}")
        side.drain()
        return times, memory, {"per_second": carried}


class SoakFigure:
    """A figure of `./dev bench paper`, only when it is named."""

    name, title, broker, servers, alone = "storm-soak", "memory of Storm's workers", None, ("storm",), True

    def seconds(self, given):
        return SUBMIT_S + WARM_UP_S + MOST_S + 60 * minutes_of(given)

    def take(self, given, report, progress):
        class_path = build()
        with tempfile.TemporaryDirectory(prefix="iotcloud-bench-") as folder, \
                Cluster(given.build, Path(folder), class_path, JVM) as cluster:
            return Soak(cluster, minutes_of(given), report, progress).run()


def minutes_of(given):
    return getattr(given, "minutes", None) or USUAL_MINUTES


SOAK = SoakFigure()

"""The figure of `./dev bench storm --turtlebot`: the TurtleBot's loop with its topology on Apache Storm, in rounds with the same loop
on our own worker."""

import subprocess
import sys
import tempfile
from pathlib import Path

from figures import ProgramFailed
from paper.points import Pair, point, series
from paper.systems import StartError, Unavailable

from . import parts
from .figure import FRAMES, RATE, WARM_UP, Loop, changed_follower

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "servers"))
sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "peers"))
import private_server  # noqa: E402
import storm_jar  # noqa: E402
from storm import Storm  # noqa: E402
from storm_cluster import WORKER_JVM  # noqa: E402

DRIVER = "turtle_on_storm"  # a driver's messages go to the topologies that name it: those of the other loop to our worker alone
SUBMIT_S = 300
OWN = "our own worker"
AT_MOST = {"p50_ms": 4, "p99_ms": 12}


def topology_on_storm(library):
    """The example's own YAML for a driver of its own."""
    return changed_follower(library, [('topology.name: "turtlebot_follower"', 'topology.name: "follower_on_storm"', 1),
                                      ('driver: "turtle"', f'driver: "{DRIVER}"', 2)])


class StormLoop(Loop):
    """The cluster with the follower's worker, and a private Storm that runs the same topology; a context manager."""

    storm = None

    def __enter__(self):
        super().__enter__()
        try:
            self._begin_storm()
        except private_server.Unavailable as why:
            self.__exit__(None, None, None)
            raise Unavailable(str(why)) from why
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def _begin_storm(self):
        storm_jar.build()
        self.storm = Storm(self.folder / "storm", worker_jvm=WORKER_JVM)
        self.storm.start()
        file = self.folder / "on-storm.yaml"
        text = topology_on_storm(self.cluster.plugins / "turtlebot_follower.so")
        file.write_text(text.replace("{zookeeper}", self.cluster.zookeeper.removeprefix("zookeeper://")))
        done = subprocess.run([self.build / "bin" / "iotcloud-storm", "submit", file, "--nimbus", self.storm.url(), "--limit",
                               str(SUBMIT_S)], capture_output=True, text=True, check=False)
        if done.returncode:
            raise StartError(f"iotcloud-storm submit: {done.stderr.strip()}")

    def __exit__(self, *failure):
        try:
            if self.storm:
                self.storm.stop()
        finally:
            super().__exit__(*failure)

    def measure_on_storm(self):
        return self.measure_loop(DRIVER)


class Figure:
    name, broker, servers = "storm-turtlebot", "rabbitmq", ("rabbitmq", "zookeeper", "storm")
    title = "the TurtleBot's loop with its topology on Apache Storm, beside our own worker"
    alone = True

    @staticmethod
    def rounds(given):
        return given.rounds or (1 if given.scale == "quick" else 5)

    def seconds(self, given):
        return 60 + (2 * self.rounds(given) + 1) * self.round_s

    round_s = (WARM_UP + FRAMES) / RATE + 4

    def take(self, given, report, progress):
        with tempfile.TemporaryDirectory(prefix="iotcloud-bench-") as folder:
            loop, pair = StormLoop(given.build, folder), Pair("TurtleBot on Storm, 60 KB at 20/s")
            progress.step("the TurtleBot on Storm: starting", 60)
            with loop:
                progress.step("the TurtleBot on Storm: warm-up of the worker's JVM", self.round_s)
                loop.measure_on_storm()
                for number in range(self.rounds(given)):
                    progress.step(f"the TurtleBot on Storm, round {number + 1}", 2 * self.round_s)
                    pair.round(loop.measure_on_storm, loop.measure_loop)
            if pair.our_problem:
                raise ProgramFailed(pair.our_problem)
            return self.judge(pair, report)

    @staticmethod
    def judge(pair, report):
        for statistic in ("mean_ms", "p50_ms", "p99_ms", "stddev_ms"):
            pair.compare(report, OWN, statistic)
        frames = [frame for line in pair.ours for frame in line["frames"]]
        whole = parts.statistics_of([frame.whole_ms for frame in frames], sum(line["lost"] for line in pair.ours))
        for statistic, limit in AT_MOST.items():
            report.compare(f"{pair.title}, all {len(frames)} frames: {statistic.removesuffix('_ms')}", "ms",
                           [whole[statistic]], at_most=limit)
        return [{"title": "The TurtleBot's loop", "bars": ["p50_ms", "p99_ms"], "x": "engine", "y_unit": "ms",
                 "series": [series("on Storm", "ours", [point("in all", pair.ours)]),
                            series(OWN, "limit", [point("in all", pair.theirs, pair.their_problem)])]}]


FIGURE = Figure()

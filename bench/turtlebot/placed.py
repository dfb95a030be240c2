"""The TurtleBot's loop while other processes keep all cores busy: its worker placed as `runtime.placement` says, in rounds with
the same worker as it is by default; then with each key of the placement alone."""

import os
import tempfile

from figures import ProgramFailed
from paper.points import Pair, point, series
from paper.systems import StartError

from . import parts
from .figure import FRAMES, RATE, WARM_UP, Loop, stamped

DRIVER = "turtle_placed"  # a driver's messages go to the topologies that name it: those of the other loop to the usual worker alone
PLACEMENT = "{priority: 10, lock_memory: true}"
# Each key alone.
ALONE = {"cores": "{cores: [0]}", "priority": "{priority: 10}", "lock_memory": "{lock_memory: true}"}
PLACED, USUAL = "placed", "not placed"
BUSY = ["/bin/sh", "-c", "while :; do :; done"]
IN_WORKER = "in the worker"  # from when its spout was asked to the end of `follow`
MOST = 0.999


def quantile(values, share):
    """Of at least one value."""
    return sorted(values)[min(len(values) - 1, int(share * len(values)))]


def placed_topology(library, folder, placement=PLACEMENT):
    """The example's own YAML for a driver of its own, with a placement, and bolts that record time stamps."""
    text = stamped(library, folder, [('topology.name: "turtlebot_follower"', 'topology.name: "follower_placed"', 1),
                                     ('driver: "turtle"', f'driver: "{DRIVER}"', 2)])
    return f"{text}\nruntime: {{placement: {placement}}}\n"


class PlacedLoop(Loop):
    """The cluster with the follower's worker, and another one that is placed; a context manager."""

    def __init__(self, build, folder, placement):
        super().__init__(build, folder)
        self.placement = placement
        self.placed_stamps = self.folder / "placed-stamps"
        self.busy = 0

    def __enter__(self):
        super().__enter__()
        try:
            self.placed_stamps.mkdir()
            text = placed_topology(self.cluster.plugins / "bench_turtlebot_stamps.so", self.placed_stamps, self.placement)
            self.cluster.topology("placed", text)
            try:
                self.cluster.wait_until_ready()
            except StartError as why:
                raise StartError(f"the placed worker does not run; {self.cluster.log('placed')} says why: {why}") from why
            self.keep_cores_busy()
        except BaseException:
            self.__exit__(None, None, None)
            raise
        return self

    def keep_cores_busy(self):
        """For as long as the cluster runs."""
        for self.busy in range(1, (os.cpu_count() or 1) + 1):
            self.cluster.spawn(f"busy-{self.busy}", BUSY)

    def measure_placed(self):
        return self.measure_loop(DRIVER)

    @staticmethod
    def in_worker_ms(frames, folder):
        """How long each frame was in the worker that recorded these time stamps. Call it after the worker has ended."""
        decode, follow = (parts.read_stamps(folder, component) for component in ("decode", "follow"))
        known = [frame.time_ms for frame in frames if frame.time_ms in decode and frame.time_ms in follow]
        return [(follow[time_ms][2] - decode[time_ms][0]) / 1e6 for time_ms in known]


class Figure:
    name, broker, servers = "turtlebot-placed", "rabbitmq", ("rabbitmq", "zookeeper")
    title = "the TurtleBot's loop while other processes keep all cores busy: its worker placed, and not"
    alone = True

    @staticmethod
    def rounds(given, most=5):
        return given.rounds or (1 if given.scale == "quick" else most)

    def seconds(self, given):
        return 20 * (1 + len(ALONE)) + 2 * (self.rounds(given) + len(ALONE) * self.rounds(given, 3)) * self.round_s

    round_s = (WARM_UP + FRAMES) / RATE + 5

    def take(self, given, report, progress):
        pair, placed_ms, usual_ms = self.measure(given, PLACEMENT, self.rounds(given), progress)
        plots = self.judge(pair, report, placed_ms, usual_ms)
        for key, placement in ALONE.items():
            self.judge_alone(key, report, *self.measure(given, placement, self.rounds(given, 3), progress))
        return plots

    def measure(self, given, placement, rounds, progress):
        """Returns the rounds, and how long each frame was in the placed worker and in the usual one."""
        with tempfile.TemporaryDirectory(prefix="iotcloud-bench-") as folder:
            loop, pair = PlacedLoop(given.build, folder, placement), Pair("TurtleBot, all cores busy")
            progress.step(f"the TurtleBot while all cores are busy, {placement}: starting", 20)
            with loop:
                for number in range(rounds):
                    progress.step(f"the TurtleBot while all cores are busy, {placement}, round {number + 1}", 2 * self.round_s)
                    pair.round(loop.measure_placed, loop.measure_loop)
            if pair.our_problem or pair.their_problem:
                raise ProgramFailed(pair.our_problem or pair.their_problem)
            ours, theirs = ([frame for line in lines for frame in line["frames"]] for lines in (pair.ours, pair.theirs))
            return pair, loop.in_worker_ms(ours, loop.placed_stamps), loop.in_worker_ms(theirs, loop.stamps)

    @staticmethod
    def judge_alone(key, report, pair, placed_ms, usual_ms):
        """Of one key of the placement: the tails, of which it is about."""
        whole = [[frame.whole_ms for line in lines for frame in line["frames"]] for lines in (pair.ours, pair.theirs)]
        for name, (ours, theirs) in (("all frames", whole), (IN_WORKER, (placed_ms, usual_ms))):
            if not ours or not theirs:
                report.fail(f"{pair.title}, {key} alone, {name}: no frame has all time stamps")
                continue
            for word, share in (("p99", 0.99), ("p99.9", MOST)):
                report.compare(f"{pair.title}, {key} alone, {name} ({len(ours)}): {word}", "ms", [quantile(ours, share)], USUAL,
                               [quantile(theirs, share)])

    @staticmethod
    def judge(pair, report, placed_ms, usual_ms):
        """`placed_ms`, `usual_ms`: how long each frame was in the two workers."""
        for statistic in ("p50_ms", "p99_ms"):
            pair.compare(report, USUAL, statistic)
        for who, lines in ((PLACED, pair.ours), (USUAL, pair.theirs)):
            report.compare(f"{pair.title}: frames without a command, {who}", "frames", [sum(line["lost"] for line in lines)])
        whole = [[frame.whole_ms for line in lines for frame in line["frames"]] for lines in (pair.ours, pair.theirs)]
        for name, (ours, theirs) in (("all frames", whole), (IN_WORKER, (placed_ms, usual_ms))):
            if not ours or not theirs:
                report.fail(f"{pair.title}, {name}: no frame has all time stamps")
                continue
            for word, share in (("p50", 0.5), ("p99", 0.99), ("p99.9", MOST), ("max", 1)):
                report.compare(f"{pair.title}, {name} ({len(ours)}): {word}", "ms", [quantile(ours, share)], USUAL,
                               [quantile(theirs, share)])
        return [{"title": "The TurtleBot's loop while all cores are busy", "bars": ["p50_ms", "p99_ms"], "x": "worker",
                 "y_unit": "ms", "series": [series(PLACED, "ours", [point("in all", pair.ours)]),
                                            series(USUAL, "limit", [point("in all", pair.theirs)])]}]


FIGURE = Figure()

"""Figure 12: 1500 frames of a TurtleBot, 60 KB at 20/s over RabbitMQ, in rounds with the bare client's echo."""

import sys
import tempfile
import time
from pathlib import Path

from figures import ProgramFailed
from paper.points import Pair, point, series
from paper.systems import Company, StartError, System

from . import parts
from .tap import Tap

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent / "tests" / "servers"))
from private_cluster import PrivateCluster  # noqa: E402

FOLLOWER = Path(__file__).resolve().parent.parent.parent / "examples/turtlebot_follower/follower.yaml"
RATE, FRAMES, WARM_UP = 20, 300, 30  # frames a second; frames of a round; frames before it that do not count
SIZE, ECHOES = 60_000, 150  # SIZE in bytes; ECHOES: the bare client's messages in a round
BARE = "librabbitmq"
START_S = 30  # limit for a deployed robot's first command
AT_MOST = {"p50_ms": 2.5, "p99_ms": 5}
PAPER = [("the paper", {"mean_ms": 33.26, "stddev_ms": 2.91, "source": "section 5.4"}),
         ("the paper, without processing", {"mean_ms": 10, "source": "section 5.4, \"around 10ms\""})]


def changed_follower(library, changes):
    """The example's own YAML with another library, and with (old, new, how often it is there)."""
    text = FOLLOWER.read_text()
    for old, new, count in [('zk.servers: ["127.0.0.1:2181"]', 'zk.servers: ["{zookeeper}"]', 1),
                            ('topology.library: "turtlebot_follower.so"', f'topology.library: "{library}"', 1), *changes]:
        if text.count(old) != count:
            raise StartError(f"{FOLLOWER} has changed: it does not have {old!r} {count} times; change {__file__}, too")
        text = text.replace(old, new)
    return text


def stamped(library, folder, changes=()):
    """The example's own YAML with more changes, and with the bolts of the library that records time stamps."""
    decoder = "    class: \"turtlebot.Decoder\"\n"
    return changed_follower(library, [(decoder, f"{decoder}    conf: {{stamps: \"{folder}\"}}\n", 1),
                                      ("    conf: {goal_distance", f"    conf: {{stamps: \"{folder}\", goal_distance", 1), *changes])


class Loop(System):
    """A cluster of RabbitMQ, ZooKeeper, a master, two gateways and the follower's worker; a context manager."""

    def __init__(self, build, folder):
        super().__init__("rabbitmq", build, folder)
        self.stamps = self.folder / "stamps"
        self.rounds, self.tap = 0, None

    def __enter__(self):
        self.stamps.mkdir(parents=True)
        self.cluster = PrivateCluster(self.folder / "cluster", self.build / "bin", self.build / "plugins")
        self.cluster.__enter__()
        try:
            self.cluster.start(gateways=2)
            self.url = self.cluster.rabbitmq
            library = self.cluster.plugins / "bench_turtlebot_stamps.so"
            self.cluster.topology("topology", stamped(library, self.stamps))
            self.cluster.wait_until_ready()
            self._begin_tap()
        except BaseException:
            self.cluster.stop()
            raise
        return self

    def _begin_tap(self):
        try:
            self.tap = Tap(int(self.url.rstrip("/").rsplit(":", 1)[1])).__enter__()
        except PermissionError:
            print("figure 12: only root may look at the wire, so what is before and behind the broker is one part", flush=True)

    def __exit__(self, *failure):
        try:
            if self.tap:
                self.tap.__exit__(*failure)
        finally:
            self.cluster.__exit__(*failure)

    def measure_loop(self, driver="turtle"):
        """Deploys a robot, measures and undeploys it. Returns a line; its "frames" are those that count."""
        self.rounds += 1
        trace = self.folder / f"trace-{self.rounds}.csv"
        properties = {"rate": RATE, "seed": self.rounds, "codec": "reference", "trace": trace}
        self.cluster.cli("deploy", "turtle.so", "--gateway", f"gateway-{1 + self.rounds % 2}", "--driver", driver,
                         *(f"--property={name}={value}" for name, value in properties.items()))
        first = self._first_answered(trace)
        before = Company()
        time.sleep((WARM_UP + FRAMES) / RATE)
        company = Company().since(before)
        self._wait(trace, lambda frames: frames[-1].sequence >= first + WARM_UP + FRAMES, "its frames")
        self.cluster.undeploy_all()
        frames = [frame for frame in parts.read_trace(trace) if 0 <= frame.sequence - first - WARM_UP < FRAMES]
        planned = parts.note_lateness(frames, 1_000_000_000 // RATE)
        answered = [frame for frame in frames if frame.answered]
        line = parts.statistics_of([frame.whole_ms for frame in answered], planned - len(answered))
        if "failed" in line:
            raise ProgramFailed(line["failed"])
        return {**line, "frames": answered, "others_cpu": company}

    def _first_answered(self, trace):
        self._wait(trace, lambda frames: any(frame.answered for frame in frames), "a command")
        return next(frame.sequence for frame in parts.read_trace(trace) if frame.answered)

    def _wait(self, trace, condition, what):
        deadline = time.monotonic() + START_S
        while time.monotonic() < deadline:
            self.cluster.require_alive()
            frames = parts.read_trace(trace)
            if frames and condition(frames):
                return
            time.sleep(0.2)
        raise ProgramFailed(f"the robot did not have {what} within {START_S} s; logs are in {self.cluster.out}")

    def measure_echo(self):
        return self.measure_bare(SIZE, RATE, 1, ECHOES / RATE, 1)

    def broken_down(self, frames):
        """The parts of the frames that have all time stamps: [(frame, ({part: ms}, {detail: ms}))]. Call it after the
        worker has ended."""
        wire = parts.Wire(self.tap.packets) if self.tap and not self.tap.lost else None
        if self.tap and self.tap.lost:
            print(f"figure 12: the kernel dropped {self.tap.lost} packets of the wire's record, so what is before and behind "
                  "the broker is one part", flush=True)
        decode, follow = (parts.read_stamps(self.stamps, component) for component in ("decode", "follow"))
        found = [(frame, parts.parts_of(frame, decode, follow, wire)) for frame in frames]
        return [(frame, known) for frame, known in found if known]


class Figure:
    name, broker, servers = "12", "rabbitmq", ("rabbitmq", "zookeeper")
    title = "the TurtleBot's loop over RabbitMQ, 60 KB at 20/s, and where its time goes"

    @staticmethod
    def rounds(given):
        return 1 if given.scale == "quick" else 5

    def seconds(self, given):
        return 20 + self.rounds(given) * self.round_s

    round_s = (WARM_UP + FRAMES + ECHOES) / RATE + 5

    def take(self, given, report, progress):
        with tempfile.TemporaryDirectory(prefix="iotcloud-bench-") as folder:
            loop, pair = Loop(given.build, folder), Pair("figure 12, TurtleBot, 60 KB at 20/s")
            progress.step("figure 12: starting", 20)
            with loop:
                for number in range(self.rounds(given)):
                    progress.step(f"figure 12, round {number + 1}", self.round_s)
                    pair.round(loop.measure_loop, loop.measure_echo)
            if pair.our_problem:
                raise ProgramFailed(pair.our_problem)
            frames = [frame for line in pair.ours for frame in line["frames"]]
            return self.judge(pair, frames, loop.broken_down(frames), report)

    @staticmethod
    def judge(pair, frames, known, report):
        lost = sum(line["lost"] for line in pair.ours)
        whole = parts.statistics_of([frame.whole_ms for frame in frames], lost)
        whole["rounds"] = [{name: value for name, value in line.items() if name != "frames"} for line in pair.ours]
        for statistic in ("mean_ms", "p50_ms", "p99_ms", "stddev_ms"):
            pair.compare(report, BARE, statistic)
        for statistic, limit in AT_MOST.items():
            report.compare(f"{pair.title}, all {len(frames)} frames: {statistic.removesuffix('_ms')}", "ms",
                           [whole[statistic]], at_most=limit)
        report.compare(f"{pair.title}: bytes of a frame", "B", [sum(frame.size for frame in frames) / len(frames)])
        if len(known) < len(frames):
            print(f"figure 12: of {len(frames) - len(known)} of {len(frames)} frames a time stamp is missing", flush=True)
        columns = {}
        for _, (shares, closer) in known:
            for name, value in {**shares, **closer}.items():
                columns.setdefault(name, []).append(value)
        points = {name: parts.statistics_of(values) for name, values in columns.items()}
        for name, of_part in points.items():
            for statistic in ("p50_ms", "p99_ms"):
                report.compare(f"figure 12, {name}: {statistic.removesuffix('_ms')}", "ms", [of_part[statistic]])
        slowest = parts.slowest([frame for frame, _ in known], [each for _, each in known])
        for name, mean in slowest.items():
            report.compare(f"figure 12, {name}: of the slowest hundredth, mean", "ms", [mean])
            points[name]["slowest_ms"] = mean
        beside = [series("the whole loop", "ours", [{"x": "in all", **whole}]),
                  series(f"{BARE}, echo of 60 KB", "limit", [point("in all", pair.theirs, pair.their_problem)]),
                  *(series(name, "paper", [{"x": "in all", **values}]) for name, values in PAPER)]
        return [
            {"title": "Where the time of a frame goes", "bars": ["p50_ms", "p99_ms", "slowest_ms"], "x": "part", "y_unit": "ms",
             "series": [series(name, "part", [{"x": name, **points[name]}]) for name in slowest] + beside},
            {"title": "The same, more closely", "bars": ["p50_ms", "p99_ms"], "x": "part", "y_unit": "ms",
             "series": [series(name, "limit", [{"x": name, **points[name]}]) for name in points if name not in slowest]},
            {"title": "Every frame, from when it was to be captured to its command", "style": "dots", "statistic": "ms",
             "x": "frame", "y": "latency", "y_unit": "ms",
             "series": [series("the whole loop", "ours",
                               [{"x": index, "ms": round(frame.whole_ms, 4)} for index, frame in enumerate(frames)])]}]


FIGURE = Figure()

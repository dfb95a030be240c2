"""Figures 10 and 11 of the paper: the round trip by the number of drivers, messages of 100 B."""

import tempfile

from paper.points import Pair, asked_for, attempts, point, series
from paper.sizes import CONNECT_S, ORDER_S, START_S
from paper.systems import HOSTS, KINDS, StartError, system

SIZE = 100
# (drivers, messages a second of each); more than 1000 drivers only on shared channels.
STEPS = {"quick": [(4, 5), (1000, 5)],
         "usual": [(4, 5), (100, 5), (500, 5), (1000, 5), (2000, 1), (5000, 1), (10_000, 1)],
         "full": [(4, 5), (100, 5), (500, 5), (1000, 5), (2000, 1), (5000, 1), (10_000, 1)]}
MOST_EXCLUSIVE = 1000
ROUNDS = {"quick": 1, "usual": 2, "full": 5}
WINDOW_S = {"quick": 2, "usual": 6, "full": 12}
WARM_UP_S = {"quick": 1, "usual": 2, "full": 2}
# The warm-up uses the figure's own load, so that the server's JVM has compiled the code that serves it.
JVM_WARM_UP_S = {"quick": 20, "usual": 30, "full": 30}
JVM_WARM_UP = ("--drivers", 1000, "--rate", 5)
DEPLOYED_A_SECOND, UNDEPLOYED_A_SECOND = 150, 300
FEW, FLAT, FLAT_LIMIT = 4, 1000, 1.5  # target: p99 with FLAT drivers is at most FLAT_LIMIT times that with FEW
SERVED = 10_000  # target: with so many drivers no message may be lost
PARTITIONS = {"shared": 4, "shared, 1 partition": 1, "shared, 8 partitions": 8}  # of a Kafka topic; the paper has 4
# With other numbers of partitions than the paper's only these steps are measured.
FEW_STEPS = [(4, 5), (1000, 5), (10_000, 1)]


class ByDrivers:
    def __init__(self, name, broker, layouts):
        self.name, self.broker, self.layouts = name, broker, layouts
        self.servers = [broker, "zookeeper"]
        self.title = f"round trip by the number of drivers, {KINDS[broker][0]}"

    def steps(self, given, layout):
        return [step for step in STEPS[given.scale] if (layout != "exclusive" or step[0] <= MOST_EXCLUSIVE)
                and (PARTITIONS.get(layout, 4) == 4 or step in FEW_STEPS)
                and asked_for(given, self.title_of(*step, layout))]

    def title_of(self, drivers, rate, layout):
        return f"{KINDS[self.broker][0]}, {drivers} x {rate}/s, {layout}"

    def chosen_layouts(self, given):
        layouts = self.layouts[:1] if given.scale == "quick" else self.layouts
        return [layout for layout in layouts if self.steps(given, layout)]

    def point_seconds(self, given):
        return 2 * (WARM_UP_S[given.scale] + WINDOW_S[given.scale]) + ORDER_S + CONNECT_S[self.broker]

    @staticmethod
    def deploy_seconds(drivers):
        return 2 + drivers / DEPLOYED_A_SECOND

    @staticmethod
    def undeploy_seconds(drivers):
        return 2 + drivers / UNDEPLOYED_A_SECOND

    def seconds(self, given):
        warm_up = JVM_WARM_UP_S[given.scale] if self.broker == "kafka" else 0
        starts, rounds = len(self.runs(given)), 0
        for layout in self.chosen_layouts(given):
            steps = self.steps(given, layout)
            most = steps[-1][0]
            rounds += len(steps) * (self.point_seconds(given) + 2) + self.deploy_seconds(most) + self.undeploy_seconds(most)
        return starts * (START_S[self.broker] + warm_up) + (given.rounds or ROUNDS[given.scale]) * rounds

    def runs(self, given):
        """The layouts that one start of the system serves: all of them, but on Kafka each number of partitions has
        topics, and so a system, of its own."""
        layouts = self.chosen_layouts(given)
        return [[layout] for layout in layouts] if self.broker == "kafka" else [layouts]

    def take(self, given, report, progress):
        pairs = {}
        for layouts in self.runs(given):
            more = {}
            if self.broker == "kafka":
                number = PARTITIONS[layouts[0]]
                more = {"properties": f", properties: {{partitions: {number}}}", "server_options": ["--partitions", number]}
            with tempfile.TemporaryDirectory(prefix="iotcloud-bench-") as folder:
                progress.step(f"figure {self.name}: starting {KINDS[self.broker][0]}", START_S[self.broker])
                with system(self.broker, given.build, folder, **more) as running:
                    running.warm_up(JVM_WARM_UP_S[given.scale], JVM_WARM_UP)
                    for layout in layouts:
                        pairs[layout], read = self.progressions(running, given, progress, layout)
                        self.judge(running, report, pairs[layout])
                        if self.broker == "kafka":  # of each gateway's topic
                            report.compare(f"{KINDS[self.broker][0]}, {layout}: partitions read", "", read, "there are",
                                           [float(HOSTS * PARTITIONS[layout])] * len(read), ratio_at_least=1)
        return self.plots(pairs)

    def progressions(self, running, given, progress, layout):
        """Measures rounds that begin with 4 drivers and add more, as the paper did. Returns {(drivers, rate): Pair},
        and for Kafka how many partitions were read at the end of each round."""
        steps = self.steps(given, layout)
        pairs = {step: Pair(self.title_of(*step, layout)) for step in steps}
        read = []
        for round_number in range(given.rounds or ROUNDS[given.scale]):
            for (drivers, rate), pair in pairs.items():
                step = f"figure {self.name}: {pair.title}, round {round_number + 1}"
                progress.step(f"{step}, deploying", self.deploy_seconds(drivers - running.drivers))
                try:
                    running.deploy(drivers - running.drivers, layout != "exclusive")
                except StartError as failure:
                    pair.our_problem = str(failure)
                    break  # a system that cannot serve these cannot serve more drivers
                progress.step(step, self.point_seconds(given))
                shape = (SIZE, rate, WARM_UP_S[given.scale], WINDOW_S[given.scale])
                pair.round(lambda: running.measure(*shape), lambda: running.measure_bare(*shape, drivers, layout != "exclusive"),
                           attempts(given))
            if self.broker == "kafka":
                read.append(running.partitions_read())
            progress.step(f"figure {self.name}: undeploying {running.drivers} drivers", self.undeploy_seconds(running.drivers))
            running.undeploy()
        return pairs, read

    def judge(self, running, report, pairs):
        few = next((pair for (drivers, _), pair in pairs.items() if drivers == FEW), None)
        for (drivers, rate), pair in pairs.items():
            pair.compare(report, running.bare)
            if pair.our_problem or not pair.ours:
                continue
            p99 = [line["p99_ms"] for line in pair.ours]
            report.compare(f"{pair.title}: p99", "ms", p99, running.bare, [line["p99_ms"] for line in pair.theirs])
            if drivers == FLAT and few and few.ours:
                report.compare(f"{pair.title}: p99", "ms", p99, f"ours, {FEW} drivers",
                               [line["p99_ms"] for line in few.ours], ratio_at_most=FLAT_LIMIT)
            if drivers == SERVED:
                report.compare(f"{pair.title}: lost", "messages", [line["lost"] for line in pair.ours], at_most=0)
                report.compare(f"{pair.title}: carried", "msg/s", [line["carried"] for line in pair.ours], "sent",
                               [float(drivers * rate)] * len(pair.ours), ratio_at_least=0.99)

    @staticmethod
    def load_of(pairs):
        """What the points' drivers send, as in "messages of 100 B, 5/s each up to 1000 drivers"."""
        most = {}
        for drivers, rate in sorted(step for steps in pairs.values() for step in steps):
            most[rate] = drivers
        return ", ".join([f"messages of {SIZE} B", *(f"{rate}/s each up to {drivers} drivers" for rate, drivers in most.items())])

    def plots(self, pairs):
        label, bare = KINDS[self.broker][0], KINDS[self.broker][3]
        lines = []
        for layout, steps in pairs.items():
            for name, kind in (("IoTCloud", "ours"), (bare, "limit")):
                points = []
                for (drivers, rate), pair in steps.items():
                    measured, problem = ((pair.ours, pair.our_problem) if kind == "ours"
                                         else (pair.theirs, pair.their_problem))
                    points.append({**point(drivers, measured, problem), "rate": rate})
                lines.append(series(f"{name}, {layout}", kind, points))
        return [{"title": f"{label}: {text}, {self.load_of(pairs)}", "x": "drivers", "x_unit": "", "x_log": True, "y": text,
                 "y_unit": "ms", "y_log": True, "statistic": statistic, "series": lines}
                for text, statistic in (("mean round trip", "mean_ms"), ("p99 of the round trip", "p99_ms"))]


FIGURES = [ByDrivers("10", "rabbitmq", ("shared", "exclusive")), ByDrivers("11", "kafka", tuple(PARTITIONS))]

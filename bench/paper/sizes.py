"""Figures 7 to 9 of the paper: the round trip by message size and rate, with 4 drivers in two gateways."""

import json
import tempfile

from figures import ProgramFailed
from paper.points import Pair, asked_for, attempts, bytes_text, point, series
from paper.systems import KINDS, system

DRIVERS = 4
SIZES = {"quick": (100, 60_000, 1_000_000), "usual": (100, 1000, 10_000, 60_000, 200_000, 1_000_000),
         "full": (100, 1000, 10_000, 60_000, 200_000, 500_000, 1_000_000)}
RATES = {"quick": (20, 100), "usual": (10, 20, 50, 100), "full": (10, 20, 50, 100)}
ROUNDS = {"quick": 1, "usual": 3, "full": 5}
LEAST_S = {"quick": 2, "usual": 2, "full": 2}
MOST_S = {"quick": 2, "usual": 4, "full": 20}
MESSAGES = 200  # messages of each driver, as in the paper; fewer if that takes too long
WARM_UP_S = 0.5
JUDGED_SIZE = 200_000  # bytes; only smaller and equal sizes have targets
MEAN_LIMIT, DEVIATION_LIMIT = 1.2, 1.25  # targets on RabbitMQ: times the bare client's
START_S = {"rabbitmq": 8, "kafka": 8, "activemq": 7, "embedded": 2}
# how long the bare client needs to connect
CONNECT_S = {"rabbitmq": 0.3, "kafka": 4.0, "activemq": 0.5, "embedded": 0.2}
ORDER_S = 0.4  # from an order to its first message, and from the last one to the report
JVM_WARM_UP_S = {"quick": 3, "usual": 6, "full": 6}
# Values that the paper's text gives. Values are not read off its pictures.
PAPER = {"rabbitmq": [(20, {"x": 60_000, "mean_ms": 10, "source": "section 5.4: \"the best case latency without any "
                            "processing\" for messages of 60 KB at 20/s \"is around 10ms\" (one robot, university network)"})]}


def window(scale, rate):
    return min(MOST_S[scale], max(LEAST_S[scale], MESSAGES / rate))


class BySize:
    """A figure of mean latency by size, a curve for each rate."""

    def __init__(self, name, broker):
        self.name, self.broker = name, broker
        self.servers = [] if broker == "embedded" else [broker, "zookeeper"]
        self.shared = broker == "kafka"  # a Kafka topic is never exclusive
        self.title = f"mean round trip by message size, {KINDS[broker][0]}"

    def rates(self, given):
        rates = RATES[given.scale]
        return rates if self.name == "7" or given.scale != "quick" else rates[-1:]

    def sizes(self, given):
        sizes = SIZES[given.scale]
        return sizes if self.name == "7" or given.scale != "quick" else sizes[:-1]

    def title_of(self, size, rate):
        return f"{KINDS[self.broker][0]}, {bytes_text(size)}, {DRIVERS} x {rate}/s"

    def points(self, given):
        """The points to measure: {rate: [sizes]}."""
        points = {rate: [size for size in self.sizes(given) if asked_for(given, self.title_of(size, rate))]
                  for rate in self.rates(given)}
        return {rate: sizes for rate, sizes in points.items() if sizes}

    def point_seconds(self, given, rate):
        """Duration of one round of a point."""
        return 2 * (WARM_UP_S + window(given.scale, rate)) + ORDER_S + CONNECT_S[self.broker]

    def seconds(self, given):
        warm_up = JVM_WARM_UP_S[given.scale] if self.broker in ("kafka", "activemq") else 0
        once = sum(len(sizes) * self.point_seconds(given, rate) for rate, sizes in self.points(given).items())
        return START_S[self.broker] + warm_up + self.rounds(given) * once

    @staticmethod
    def rounds(given):
        return given.rounds or ROUNDS[given.scale]

    def take(self, given, report, progress):
        with tempfile.TemporaryDirectory(prefix="iotcloud-bench-") as folder:
            progress.step(f"figure {self.name}: starting {KINDS[self.broker][0]}", START_S[self.broker])
            with system(self.broker, given.build, folder) as running:
                running.deploy(DRIVERS, self.shared)
                running.warm_up(JVM_WARM_UP_S[given.scale])
                curves = {rate: [self.point(running, given, report, progress, size, rate) for size in sizes]
                          for rate, sizes in self.points(given).items()}
        return [self.plot(curves)]

    def point(self, running, given, report, progress, size, rate):
        pair = Pair(self.title_of(size, rate))
        seconds = window(given.scale, rate)
        for round_number in range(self.rounds(given)):
            progress.step(f"figure {self.name}: {pair.title}, round {round_number + 1}", self.point_seconds(given, rate))
            pair.round(lambda: running.measure(size, rate, WARM_UP_S, seconds),
                       lambda: running.measure_bare(size, rate, WARM_UP_S, seconds, DRIVERS, self.shared),
                       attempts(given))
            if pair.our_problem:
                break
        judged = self.broker == "rabbitmq" and size <= JUDGED_SIZE
        pair.compare(report, running.bare, **({"ratio_at_most": MEAN_LIMIT} if judged else {}))
        return size, rate, pair

    def plot(self, curves):
        label, bare = KINDS[self.broker][0], KINDS[self.broker][3]
        lines = []
        for rate, points in curves.items():
            lines.append(series(f"IoTCloud, {rate}/s", "ours", [
                {**point(size, pair.ours, pair.our_problem), "rate": rate} for size, _, pair in points]))
            lines.append(series(f"{bare}, {rate}/s", "limit", [
                {**point(size, pair.theirs, pair.their_problem), "rate": rate} for size, _, pair in points]))
        for rate, value in PAPER.get(self.broker, []):
            lines.append(series(f"paper, {rate}/s", "paper", [value]))
        return {"title": f"{label}: mean round trip, 4 drivers in 2 gateways", "x": "message size", "x_unit": "B",
                "x_log": True, "y": "mean round trip", "y_unit": "ms", "y_log": True, "statistic": "mean_ms",
                "series": lines}


class Deviation:
    """Figure 9, drawn from what figures 7 and 8 measured."""

    name, broker, servers = "9", None, []
    title = "standard deviation of the round trip by message size"
    SOURCES = ("7", "8")

    def seconds(self, _given):
        return 0

    def take(self, given, report, _progress):
        plots = []
        for source in self.SOURCES:
            file = given.out / f"figure-{source}.json"
            if file.exists():
                measured = json.loads(file.read_text())
                plots += [self.plot(plot, source, report) for plot in measured["plots"]]
                if measured.get("failed"):
                    report.fail(f"figure {source}, of which it is drawn: {measured['failed']}")
        if not plots:
            raise ProgramFailed(f"there is nothing to draw it from in {given.out}; run --figure 7 or --figure 8 first")
        return plots

    def plot(self, plot, source, report):
        lines = [line for line in plot["series"] if line["kind"] != "paper"]
        broker = plot["title"].split(":")[0]
        for ours, theirs in zip(lines[::2], lines[1::2]):
            for one, other in zip(ours["points"], theirs["points"]):
                if "failed" in one or "failed" in other:
                    continue  # figure 7 or 8 tells why it failed
                judged = source == "7" and one["x"] <= JUDGED_SIZE
                report.compare(f"{broker}, {bytes_text(one['x'])}, 4 x {one['rate']}/s: standard deviation", "ms",
                               [turn["stddev_ms"] for turn in one["rounds"]], theirs["name"].split(",")[0],
                               [turn["stddev_ms"] for turn in other["rounds"]],
                               **({"ratio_at_most": DEVIATION_LIMIT} if judged else {}))
        return {**plot, "title": f"{broker}: standard deviation of the round trip", "y": "standard deviation",
                "statistic": "stddev_ms", "series": lines}


FIGURES = [BySize("7", "rabbitmq"), BySize("8", "kafka"), BySize("7a", "activemq"), BySize("7e", "embedded"), Deviation()]

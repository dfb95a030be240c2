"""The figures of `./dev bench devices`: how long it takes until devices that announce themselves by MQTT are instances, and what
passes from them through gateway and broker into a topology, beside a bare subscriber."""

import collections
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from brokers_report import Report

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "servers"))
from house import House  # noqa: E402
from private_cluster import StartError, wait_for  # noqa: E402

DEVICES, RATE, SIZE = 1000, 5000, 100
ACTIVE_LIMIT_S = 10
WARM_UP_S = 3
SHARE_SENT = 0.99  # of RATE: with less the figures are not those of that load
BARE = "bare subscriber"
RULES = """
finders: {house: {plugin: mqtt_finder.so, properties: {url: "{mqtt}", find: homeassistant}}}
rules:
  devices:
    finder: house
    plugin: mqtt.so
    name: "{id:name}"
    properties:
      url: "{mqtt}"
      subscribe: "{subscribe:topics}"
      channel.reading.shared: "true"
      channel.publish.shared: "true"
    metadata: {model: "{model:text}"}
    grace: 5s
    most: 2000
    rate: 2000
"""
TOPOLOGY = """
zk.servers: ["{zookeeper}"]
topology.name: devices
topology.library: LIBRARY
spouts:
  receive: {broker: rabbitmq, driver: mqtt, channel: reading, fields: [data, driverID, time]}
bolts:
  note:
    class: bench.Readings
    conf: {boards: "BOARDS"}
    inputs: [{from: receive, grouping: fields, fields: [driverID]}]
"""


class Devices(House):
    def begin_all(self):
        """Starts the servers, a gateway with rules, and a worker."""
        self.begin(RULES, zookeeper=("--steady",), mosquitto=("--throughput",))
        self.boards = self.out / "boards"
        self.boards.mkdir()
        self.topology("worker", TOPOLOGY.replace("LIBRARY", str(self.plugins / "bench_devices_readings.so"))
                      .replace("BOARDS", str(self.boards)))
        wait_for("the finder looks", lambda: self.runs("mqtt_finder", 1))

    def play(self, *words, limit=600):
        done = subprocess.run([str(self.bin / "bench_devices"), words[0], str(self.mqtt_port), *map(str, words[1:])],
                              capture_output=True, text=True, timeout=limit)
        if done.returncode:
            raise StartError(f"bench_devices {words[0]}: {done.stderr.strip()}")
        return done.stdout

    def announce(self):
        """Seconds from the first announcement until the last instance was active."""
        began = time.time_ns() / 1e6
        self.play("announce", DEVICES)
        wait_for(f"{DEVICES} instances are active", lambda: self.runs("mqtt", DEVICES), 300)
        return (max(change["time_ms"] for change in self.instances("mqtt")) - began) / 1000

    def carry(self, seconds):
        """Sends for so long, after a warm-up, and returns what bench_devices has to say."""
        return json.loads(self.play("load", DEVICES, RATE, SIZE, WARM_UP_S, seconds, self.boards))

    def withdraw(self):
        """Seconds from the first withdrawal until no instance is left, the rule's grace among them."""
        began = time.monotonic()
        self.play("withdraw", DEVICES)
        wait_for("no instance is left", lambda: self.runs("mqtt", 0), 300)
        return time.monotonic() - began


class SenderLate(Exception):
    """The sender did not keep its rate, so that the run says nothing about the system."""


def measure(house, given, figures):
    """One round: adds a value to each of the figures that could be measured."""
    figures["active"].append(house.announce())
    house.carry(5)  # the topology reads all channels; what is lost before that is not counted
    told = house.carry(5 if given.quick else 20)
    rate = told["sent"] / told["seconds"]
    figures["rate"].append(rate)
    figures["late"].append(told["late"]["p99_us"] / 1000)
    figures["taken"].append(told["taken"]["p99_us"] / 1000)
    if rate < SHARE_SENT * RATE:
        raise SenderLate(f"the sender sent {rate:.0f} readings/s instead of {RATE}")
    for name in ("bare", "through"):
        figures[f"{name}_lost"].append(float(told["sent"] - told[f"{name}_heard"]))
        for quantile in ("p50", "p99"):
            figures[f"{name}_{quantile}"].append(told[name][f"{quantile}_us"] / 1000)
    figures["again"].append(float(told["through_again"]))
    figures["gone"].append(house.withdraw())


def run_devices(given):
    report, rounds = Report(), given.rounds or (1 if given.quick else 3)
    report.print_head()
    figures = collections.defaultdict(list)
    with tempfile.TemporaryDirectory(prefix="iotcloud-bench-") as folder:
        for number in range(rounds):
            try:
                with Devices(Path(folder) / f"run{number}", given.build / "bin", given.build / "plugins") as house:
                    house.begin_all()
                    measure(house, given, figures)
                    house.require_alive()
            except SenderLate as late:
                report.fail(f"round {number + 1}: INVALID: {late}; its figures do not count")
            except (StartError, subprocess.TimeoutExpired, SystemExit) as failure:  # wait_for() ends a test
                report.fail(f"round {number + 1}: GIVEN UP: {failure}")
    load = f"{RATE} readings/s of {DEVICES} devices"
    report.compare(f"{DEVICES} devices announced: all active", "s", figures["active"], at_most=ACTIVE_LIMIT_S)
    report.compare(f"{load}: sent", "msg/s", figures["rate"], at_least=SHARE_SENT * RATE)
    report.compare(f"{load}: sent late, p99", "ms", figures["late"])
    report.compare(f"{load}: taken by Mosquitto, p99", "ms", figures["taken"])
    report.compare(f"{load}: lost", "messages", figures["through_lost"], BARE, figures["bare_lost"], at_most=0)
    report.compare(f"{load}: twice", "messages", figures["again"])
    report.compare(f"{load}: in the topology, p50", "ms", figures["through_p50"], BARE, figures["bare_p50"])
    report.compare(f"{load}: in the topology, p99", "ms", figures["through_p99"], BARE, figures["bare_p99"])
    report.compare(f"{DEVICES} devices withdrawn: none left", "s", figures["gone"])
    return report, report.verdict()

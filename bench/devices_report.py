"""The figures of `./dev bench devices`: how long it takes until devices that announce themselves by MQTT are instances, and what
passes from them through gateway, broker and topology and back, beside a bare subscriber."""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from brokers_report import Report

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "servers"))
from private_cluster import PrivateCluster, StartError, free_port, wait_for  # noqa: E402

DEVICES, RATE, SIZE = 1000, 5000, 100
ACTIVE_LIMIT_S = 10
BARE = "bare subscriber"
RULES = """
finders: {{house: {{plugin: mqtt_finder.so, properties: {{url: "{mqtt}", find: homeassistant}}}}}}
rules:
  devices:
    finder: house
    plugin: mqtt.so
    name: "{{id:name}}"
    properties:
      url: "{mqtt}"
      subscribe: "{{subscribe:topics}}"
      publish_topic: "bench/{{id}}/echo"
      channel.reading.shared: "true"
      channel.publish.shared: "true"
    metadata: {{model: "{{model:text}}"}}
    grace: 5s
    most: 2000
    rate: 2000
"""
TOPOLOGY = """
zk.servers: ["{zookeeper}"]
topology.name: devices
spouts:
  receive: {broker: rabbitmq, driver: mqtt, channel: reading, fields: [data, driverID, time]}
bolts:
  send:
    broker: rabbitmq
    driver: mqtt
    channel: publish
    fields: [data, driverID, time]
    inputs: [{from: receive, grouping: fields, fields: [driverID]}]
"""


class House(PrivateCluster):
    def begin(self):
        """Starts the servers, a gateway with rules, and a worker."""
        self.zookeeper = self.server("zookeeper", "--steady")
        self.rabbitmq = self.server("rabbitmq")
        self.mqtt = self.server("mosquitto")
        rules = self.out / "rules.yaml"
        rules.write_text(RULES.format(mqtt=self.mqtt))
        self.state = self.out / "state"
        self.daemon("iotcloud-gateway", "gateway", f"""
id: house
registry: "{self.zookeeper}"
thrift: {{host: 127.0.0.1, port: {free_port()}}}
plugins: "{self.plugins}"
state: "{self.state}"
provisioning: "{rules}"
brokers:
  rabbitmq: {{type: rabbitmq, urls: ["{self.rabbitmq}"]}}
""")
        self.topology("worker", TOPOLOGY)
        wait_for("the finder looks", lambda: len(self.active("mqtt_finder")) == 1)

    def active(self, driver):
        """The instances of a driver that are active now, and since when (ms of wall time)."""
        file = self.state / "history.jsonl"
        if not file.exists():
            return {}
        last = {}
        for line in file.read_text().splitlines():
            try:
                change = json.loads(line)
            except ValueError:
                continue  # it is just being written
            last[change["instance"]] = change
        return {name: change["time_ms"] for name, change in last.items()
                if change["driver"] == driver and change["state"] == "active"}

    def play(self, *words, limit=600):
        port = self.mqtt.rsplit(":", 1)[1]
        done = subprocess.run([str(self.bin / "bench_devices"), words[0], port, *map(str, words[1:])], capture_output=True,
                              text=True, timeout=limit)
        if done.returncode:
            raise StartError(f"bench_devices {words[0]}: {done.stderr.strip()}")
        return done.stdout

    def announce(self):
        """Seconds from the first announcement until the last instance was active."""
        began = time.time_ns() / 1e6
        self.play("announce", DEVICES)
        wait_for(f"{DEVICES} instances are active", lambda: len(self.active("mqtt")) == DEVICES, 300)
        return (max(self.active("mqtt").values()) - began) / 1000

    def carry(self, seconds):
        return json.loads(self.play("load", DEVICES, RATE, SIZE, 3, seconds))

    def withdraw(self):
        """Seconds from the first withdrawal until no instance is left, the rule's grace among them."""
        began = time.monotonic()
        self.play("withdraw", DEVICES)
        wait_for("no instance is left", lambda: not self.active("mqtt"), 300)
        return time.monotonic() - began


def run_devices(given):
    report, rounds = Report(), given.rounds or (1 if given.quick else 3)
    report.print_head()
    figures = {name: [] for name in ("active", "lost", "rate", "p50", "bare_p50", "p99", "bare_p99", "gone")}
    with tempfile.TemporaryDirectory(prefix="iotcloud-bench-") as folder:
        for number in range(rounds):
            try:
                with House(Path(folder) / f"run{number}", given.build / "bin", given.build / "plugins") as house:
                    house.begin()
                    figures["active"].append(house.announce())
                    house.carry(5)  # the topology reads all channels; what is lost before that is not counted
                    told = house.carry(5 if given.quick else 20)
                    figures["lost"].append(float(told["sent"] - min(told["bare"]["count"], told["through"]["count"])))
                    figures["rate"].append(told["sent"] / told["seconds"])
                    for quantile in ("p50", "p99"):
                        figures[quantile].append(told["through"][f"{quantile}_us"] / 1000)
                        figures[f"bare_{quantile}"].append(told["bare"][f"{quantile}_us"] / 1000)
                    figures["gone"].append(house.withdraw())
                    house.require_alive()
            except (StartError, SystemExit) as failure:  # wait_for() ends a test
                report.fail(f"round {number + 1}: GIVEN UP: {failure}")
    load = f"{RATE} readings/s of {DEVICES} devices"
    report.compare(f"{DEVICES} devices announced: all active", "s", figures["active"], at_most=ACTIVE_LIMIT_S)
    report.compare(f"{load}: sent", "msg/s", figures["rate"], at_least=0.99 * RATE)
    report.compare(f"{load}: lost", "messages", figures["lost"], at_most=0)
    report.compare(f"{load}: there and back, p50", "ms", figures["p50"], BARE, figures["bare_p50"])
    report.compare(f"{load}: there and back, p99", "ms", figures["p99"], BARE, figures["bare_p99"])
    report.compare(f"{DEVICES} devices withdrawn: none left", "s", figures["gone"])
    return report, report.verdict()

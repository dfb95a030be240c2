"""A private cluster to do harm to: load generators through a topology of several workers, and what became of each
message in the end.
"""

import collections
import datetime
import json
import os
import re
import shutil
import signal
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "servers"))

from network_spaces import HERE as BRIDGE, page  # noqa: E402
from private_cluster import PrivateCluster, StartError, free_port, result_of, wait_for  # noqa: E402,F401

SESSION_S = 4  # the workers' registry.session_timeout
HEARTBEAT_S = 1
PAUSE_S = SESSION_S + 2  # by then a killed worker's drivers are usually read elsewhere

# How long something may take, by name. A test that runs beside others measures how busy the machine is: it prints the time,
# and only a test that is told to (`--judge`) fails for it.
LIMITS = json.loads((HERE / "limits.json").read_text())

TOPOLOGY = f"""
zk.servers: [{{zookeeper}}]
registry.session_timeout: {SESSION_S}s
topology.name: "echo"
{{library}}
metrics: {{address: "{{metrics}}"}}
brokers:
  {{broker}}: {{heartbeat: {HEARTBEAT_S}s{{urls}}}}
spouts:
  receive: {{broker: {{broker}}, driver: loadgen, channel: data, fields: [data, driverID, time], parallelism: 2}}
bolts:{{bolt}}
  send:
    broker: {{broker}}
    driver: loadgen
    channel: echo
    fields: [data, driverID, time]
    inputs: [{{from: {{last}}, grouping: fields, fields: [driverID]}}]
"""

# With a bolt that always holds a tuple (holding_bolt.cc).
HOLD = """
  between: {class: test.Holding, tick: 500ms, inputs: [{from: receive, grouping: fields, fields: [driverID]}]}"""


# `unit`: a driver instance, or on Kafka a gateway, and "#" with the partition if it is not the first
Event = collections.namedtuple("Event", "time worker what unit")
EVENTS = {"rabbitmq": (("leads", re.compile(r" leads \S+/instance-(\w+) \(epoch")),
                       ("reads", re.compile(r"\.(\w+)\.\w+: its first message is here"))),
          "kafka": (("leads", re.compile(r" leads \S+/gateway-(\S+) \(epoch")),
                    ("reads", re.compile(r" (gateway-\d+)\.loadgen\.data(#\d+)?: its first message is here")))}
PARTITIONS = 4  # of each topic on Kafka


def ours(line):
    """The time, in seconds, of a line in a log of this system."""
    return datetime.datetime.fromisoformat(line.split(" ", 1)[0]).timestamp()


class FaultCluster(PrivateCluster):
    """Workers and load generators by name, which may be killed, frozen and started again."""

    def __init__(self, build, name, registry="zookeeper", library=None, bolt="", broker="rabbitmq", guarded=False):
        """`library` and `bolt`: a component library, and the bolt `between` of it, as YAML. On Kafka the drivers share a
        topic on each gateway. `guarded`: all daemons have a user of the registry, without which they refuse one that is
        not on loopback."""
        build = Path(build).resolve()
        self.work = build / "cluster-tests" / name
        shutil.rmtree(self.work, ignore_errors=True)
        super().__init__(self.work, build / "bin", build / "plugins")
        self.registry_kind, self.library, self.bolt = registry, library, bolt
        self.broker, self.guarded = broker, guarded
        self.reports, self.started, self.pages = [], 0, {}
        self.password = self.out / "registry.password"
        self.password.write_text("secret\n")

    def start(self, *arguments, **options):
        if self.broker == "kafka":
            url = self.server("kafka")
            options["brokers"] = [f'kafka: {{type: kafka, urls: ["{url}"], properties: {{partitions: {PARTITIONS}}}}}']
        super().start(*arguments, **options)

    def server(self, kind, *options):
        return super().server(self.registry_kind if kind == "zookeeper" else kind, *options)

    def daemon(self, program, name, configuration, enter=(), options=()):
        if not self.guarded:
            return super().daemon(program, name, configuration, enter, options)
        user = f"registry.user: fleet\nregistry.password_file: {self.password}\nregistry.unencrypted: true\n"
        return super().daemon(program, name, configuration.lstrip() + "\n" + user, enter, options)

    def order(self, command):
        """A command to the registry's server; returns its answer."""
        return self.tell(self.registry_kind, command)

    def worker(self, isle=None):
        """Starts another worker, in the network `isle` if given; returns its name."""
        self.started += 1
        name = f"worker-{self.started}"
        servers = self.zookeeper.removeprefix("zookeeper://")
        urls = f", properties: {{partitions: {PARTITIONS}}}" if self.broker == "kafka" else ""
        if isle:
            servers = servers.replace("127.0.0.1", BRIDGE)
            urls = f', urls: ["{self.rabbitmq.replace("127.0.0.1", BRIDGE)}"]'
        address = f"127.0.0.1:{free_port()}"
        self.pages[name] = (address, isle)
        listed = ", ".join(f'"{server}"' for server in servers.split(","))
        configuration = TOPOLOGY
        library = f'topology.library: "{self.plugins / self.library}"' if self.library else ""
        for key, value in (("zookeeper", listed), ("urls", urls), ("metrics", address), ("library", library),
                           ("broker", self.broker), ("bolt", self.bolt),
                           ("last", "between" if self.bolt else "receive")):
            configuration = configuration.replace("{" + key + "}", value)
        self.daemon("iotcloud-topology", name, configuration, isle.enter if isle else (), ("--log-level", "debug"))
        return name

    def metric(self, worker, metric, label=""):
        """Sum of that metric over its labels, or over those with the given one (`reason="fenced"`)."""
        lines = page(self.pages[worker][0], "/metrics", self.pages[worker][1]).splitlines()
        return sum(float(line.rsplit(" ", 1)[1]) for line in lines
                   if line.startswith((metric + "{", metric + " ")) and label in line)

    def received(self, worker):
        return self.metric(worker, "iotcloud_spout_received_total")

    def lost(self, worker):
        """How many messages its bolts gave up, whatever the reason."""
        return sum(self.metric(worker, f"iotcloud_bolt_{name}_total") for name in ("lost", "unknown_driver"))

    def channels(self, worker):
        return self.metric(worker, "iotcloud_spout_channels")

    def said(self, worker, text):
        """How often the worker's log contains the text."""
        return self.log(worker).read_text(errors="replace").count(text)

    def process(self, name):
        return next(child for known, child in self.children if known == name)

    def kill(self, name):
        child = self.process(name)
        child.kill()
        child.wait()
        self.children = [entry for entry in self.children if entry[1] is not child]

    def kill_drivers(self):
        """Kills (SIGKILL) one driver host of a gateway of this cluster. Returns whether there was one."""
        for entry in Path("/proc").iterdir():
            if not entry.name.isdigit():
                continue
            try:
                command = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
                if "iotcloud-driver-host" in command and str(self.work) in command:
                    os.kill(int(entry.name), signal.SIGKILL)
                    return True
            except OSError:
                continue  # it ended meanwhile
        return False

    def drivers(self, number, count, rate, name="report"):
        """Deploys load generators; `name` begins the files of their reports."""
        for _ in range(number):
            report = self.work / f"{name}-{len(self.reports)}.json"
            gateway = len(self.reports) % self.gateways + 1
            self.reports.append(report)
            layout = {"broker": "kafka", "shared": "true"} if self.broker == "kafka" else {}
            self.deploy("loadgen.so", f"gateway-{gateway}", {"count": count, "rate": rate, "report": report, **layout})

    def readers(self):
        """Names of the units by the worker that leads them, according to the logs."""
        return {name: sum(event.what == "leads" for event in self.timeline([name])) for name in self.pages}

    def reading(self):
        """The worker to which the first message of a unit came last, by unit."""
        return {event.unit: event.worker for event in self.timeline() if event.what == "reads"}

    def timeline(self, workers=None):
        """The events of the drivers' units in the workers' logs, in order of time."""
        events = []
        for worker in workers or self.pages:
            for line in self.log(worker).read_text(errors="replace").splitlines():
                for what, pattern in EVENTS[self.broker]:
                    if found := pattern.search(line):
                        events.append(Event(ours(line), worker, what, "".join(part or "" for part in found.groups())))
        return sorted(events)

    def wait_for_workers(self, number):
        wait_for(f"{number} workers are known", lambda: any(
            len(topology["workers"]) == number for topology in json.loads(self.cli("topologies", "-o", "json"))))

    def wait_until_all_read(self):
        wait_for("every worker reads drivers", lambda: all(self.readers().values()))

    def totals(self, limit):
        """Waits until every message is back or the time is over, and adds up the drivers' reports."""
        deadline = time.monotonic() + limit
        while time.monotonic() < deadline and not all(map(result_of, self.reports)):
            time.sleep(0.2)
        if not all(map(result_of, self.reports)):
            self.undeploy_all()  # a closing driver writes its report
            wait_for("every driver reports", lambda: all(map(result_of, self.reports)))
        keys = ("sent", "received", "lost", "duplicated", "out_of_order", "damaged")
        results = [result_of(report) for report in self.reports]
        return {key: sum(each[key] for each in results) for key in keys} | {
            "furthest_back": max(each["furthest_back"] for each in results),
            "max_s": max(each["latency_us"]["max"] for each in results) / 1e6}


def sentence(name, totals):
    return (f"{name}: {totals['sent']} sent, {totals['lost']} lost, {totals['duplicated']} duplicated, "
            f"{totals['out_of_order']} out of order, {totals['damaged']} damaged; a message or duplicate came at most "
            f"{totals['furthest_back']} numbers late; the longest round trip took {totals['max_s']:.1f} s")


def add_judge(parser):
    parser.add_argument("--judge", action="store_true",
                        help="fail if something took longer than limits.json allows: only where no other test runs")


def judge(given, name, took, unit="s"):
    """Prints a time beside its limit; with `--judge`, ends the test if it is longer. `unit`: "x" if it is a multiple of
    another time."""
    limit, what = LIMITS[name]["limit"], LIMITS[name]["of"]
    print(f"{name} {took:.2f} {unit} of {limit} {unit} ({what})", flush=True)
    if given.judge and took > limit:
        raise SystemExit(f"{name}: {took:.2f} {unit} is longer than tests/cluster/limits.json allows")


def finish(name, totals):
    """Prints the losses; the exit status is 0 if there are none."""
    print(sentence(name, totals), flush=True)
    if totals["lost"] or totals["damaged"] or totals["out_of_order"] or not totals["sent"]:
        sys.exit(f"{name}: messages were lost or damaged, or overtook one another")

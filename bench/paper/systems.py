"""The systems that the paper's figures measure: its application on a private cluster or in one process, and the bare
client on the same broker."""

import json
import math
import os
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

from figures import ProgramFailed, Programs

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "tests" / "servers"))
from private_cluster import Children, PrivateCluster, StartError, Unavailable, children_of, free_port  # noqa: E402, F401

# By kind of broker: its name, the server's options, the bare client's program, and the bare client's name.
KINDS = {
    "rabbitmq": ("RabbitMQ", [], "rabbitmq", "librabbitmq"),
    "kafka": ("Kafka", ["--throughput"], "kafka", "librdkafka"),
    "activemq": ("ActiveMQ", ["--throughput"], "activemq", "qpid-proton"),
    "embedded": ("embedded", [], "iotcloud", "the broker alone"),
}
DRIVER = "paper_load"
HOSTS = 2  # gateways, with a driver host each
PATIENCE_S = 20  # how long to wait for late messages
READY_S = 60
ORDER_S = 300  # limit for a deployment


def topology(broker, registry="", connection=""):
    """The YAML of the paper's topology: 4 spout tasks that read, 4 bolt tasks that send back. `connection`: lines that
    say how it connects to the broker."""
    return f"""{registry}
topology.name: paper
{connection}
spouts:
  receive: {{broker: {broker}, driver: {DRIVER}, channel: data, fields: [data, driverID, time], parallelism: 4}}
bolts:
  send:
    broker: {broker}
    driver: {DRIVER}
    channel: echo
    fields: [data, driverID, time]
    parallelism: 4
    inputs: [{{from: receive, grouping: fields, fields: [driverID]}}]
"""


def descendants(process):
    found = [process]
    for one in found:
        found += children_of(one)
    return found


class Company:
    """CPU time that processes other than this script and those that it started have taken so far."""

    TICKS = os.sysconf("SC_CLK_TCK")

    def __init__(self):
        fields = [int(field) for field in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9]]
        self.at, self.machine, own = time.monotonic(), sum(fields[:3]) + sum(fields[5:8]), 0
        for process in descendants(os.getpid()):
            try:
                stat = Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()
            except OSError:
                continue
            own += int(stat[11]) + int(stat[12])
        self.others = (self.machine - own) / self.TICKS

    def since(self, before):
        """CPUs that other processes took, on average, since `before`."""
        return max(0.0, (self.others - before.others) / (self.at - before.at))


def quantile(counts, share):
    """A quantile of {value: how many}, computed as the measuring programs do."""
    rank, below = int(share * sum(counts.values())), 0
    for value, count in sorted(counts.items()):
        below += count
        if below > rank:
            return value
    return 0.0


def merge(reports, seconds):
    """Combines the reports of all hosts on an order into one line."""
    n = sum(report["n"] for report in reports)
    counts = {}
    for report in reports:
        for value, count in report["histogram_us"]:
            counts[value] = counts.get(value, 0) + count
    mean = sum(report["mean_us"] * report["n"] for report in reports) / max(1, n)
    squares = sum((report["stddev_us"] ** 2 + report["mean_us"] ** 2) * report["n"] for report in reports) / max(1, n)
    largest = max(report["max_us"] for report in reports)
    return {"mean_ms": mean / 1000, "stddev_ms": math.sqrt(max(0.0, squares - mean * mean)) / 1000,
            "p50_ms": min(quantile(counts, 0.5), largest) / 1000, "p99_ms": min(quantile(counts, 0.99), largest) / 1000,
            "max_ms": largest / 1000, "n": n, "lost": sum(r["planned"] - r["came_back"] for r in reports),
            "carried": sum(report["in_time"] for report in reports) / seconds if seconds else 0.0}


class Orders:
    """Tells the load drivers of all hosts what to send, and adds up what they report (bench/paper/conductor.h)."""

    def __init__(self, folder, hosts):
        self.folder, self.hosts, self.last = Path(folder), hosts, 0
        self.folder.mkdir(parents=True, exist_ok=True)

    def give(self, size, rate, drivers, warm_up, seconds, patience=PATIENCE_S):
        """Gives an order and waits for the hosts' reports. Returns them, and how many CPUs other processes took
        meanwhile."""
        self.last += 1
        start = time.monotonic_ns() + int((0.2 + drivers / 20_000) * 1e9)  # gives all drivers time to read the order
        begin = start + int(warm_up * 1e9)
        end = begin + int(seconds * 1e9)
        part = self.folder / "order.part"
        part.write_text(f"{self.last} {size} {rate} {drivers} {start} {begin} {end} {int(patience * 1e9)}\n")
        part.replace(self.folder / "order")
        self.sleep_until(begin)
        before = Company()
        self.sleep_until(end)
        company = Company().since(before)
        limit = end + int((patience + 10) * 1e9)
        while time.monotonic_ns() < limit:
            reports = self.reports()
            if len(reports) == self.hosts:
                return reports, company
            time.sleep(0.01)
        raise ProgramFailed(f"only {len(reports)} of {self.hosts} driver hosts reported what came back")

    @staticmethod
    def sleep_until(when_ns):
        time.sleep(max(0, when_ns - time.monotonic_ns()) / 1e9)

    def reports(self):
        found = [json.loads(file.read_text()) for file in self.folder.glob("*.json")]
        return [report for report in found if report["order"] == self.last]


class System:
    """The paper's application, a context manager. `drivers`: how many are deployed."""

    def __init__(self, kind, build, folder):
        self.kind, self.build, self.folder = kind, build, Path(folder)
        self.label, self.server_options, self.program, self.bare = KINDS[kind]
        self.programs = Programs(build / "bin", "brokers")
        self.drivers = 0

    def measure(self, size, rate, warm_up, seconds, drivers=None):
        """Has all drivers send messages of this size, each at this rate. Returns a line. Raises ProgramFailed."""
        drivers = drivers or self.drivers
        reports, company = self.orders.give(size, rate, drivers, warm_up, seconds)
        joined, wrong = sum(report["drivers"] for report in reports), sum(report["wrong"] for report in reports)
        if joined != drivers:
            raise ProgramFailed(f"only {joined} of {drivers} drivers took part")
        if wrong:
            raise ProgramFailed(f"{wrong} messages came back twice, out of order or changed")
        if any(report["overrun"] for report in reports):
            raise ProgramFailed("more than goes through: too much was under way, and sending was given up")
        line = merge(reports, seconds)
        if line["n"] == 0:
            raise ProgramFailed("nothing came back")
        return {**line, "others_cpu": company}

    def measure_bare(self, size, rate, warm_up, seconds, drivers, shared=False):
        """Runs the bare client with the same load on the same broker. Returns a line. Raises ProgramFailed."""
        words = ["--url", self.url, "--name", f"bare-{self.program}-{'shared' if shared else 'own'}", "--drivers", drivers, "--size", size,
                 "--rate", rate, "--warm-up", warm_up, "--seconds", seconds, *["--shared"] * shared]
        line = self.programs.run(self.program, *words, *self.servers())[0]
        if not line["sustained"]:
            raise ProgramFailed("more than goes through: too much was under way, and sending was given up")
        if line["count"] == 0:
            raise ProgramFailed("nothing came back in a whole round")
        figures = {name: line[name.replace("_ms", "_us")] / 1000
                   for name in ("mean_ms", "stddev_ms", "p50_ms", "p99_ms", "max_ms")}
        return {**figures, "n": line["count"], "lost": 0, "carried": line["per_second"], "others_cpu": line["others_cpu"]}

    def servers(self):
        """Options that name the processes that belong to the measurement, so that they do not count as others."""
        return [word for process in self.cluster.descendants() for word in ("--server", process)]

    def warm_up(self, seconds, load=("--under-way", 100)):
        """Runs the bare client until the server's JVM has compiled the code that it uses. `load`: the bare client's
        options."""
        if self.kind in ("kafka", "activemq"):
            self.programs.run(self.program, "--url", self.url, "--name", "warm-up", *load, "--seconds", seconds,
                              *["--shared"] * (self.kind == "kafka"), *self.servers())

    def wait_until_served(self, rate=50):
        """Waits until a message of every driver came back."""
        deadline = time.monotonic() + READY_S
        while time.monotonic() < deadline:
            reports, _ = self.orders.give(100, rate, self.drivers, 0, 1 / rate, 1 + self.drivers / 1000)
            if sum(report["came_back"] for report in reports) >= self.drivers:
                return
            self.cluster.require_alive()
        came = sum(report["came_back"] for report in reports)
        raise StartError(f"{came} of {self.drivers} drivers got their messages back within {READY_S} s")


class Cluster(System):
    """ZooKeeper, the broker, a master, two gateways with a driver host each, and a worker, as processes."""

    def __init__(self, kind, build, folder, properties="", server_options=()):
        super().__init__(kind, build, folder)
        self.properties, self.more_options = properties, list(server_options)
        self.deployments = 0

    def __enter__(self):
        self.cluster = PrivateCluster(self.folder / "cluster", self.build / "bin", self.build / "plugins")
        self.cluster.__enter__()
        try:
            self.url = self.cluster.server(self.kind, *self.server_options, *self.more_options)
            self.cluster.start(HOSTS, [f'{self.kind}: {{type: {self.kind}, urls: ["{self.url}"]{self.properties}}}'])
            # Whoever comes first makes a topic, so both sides say into how many partitions.
            self.page = f"127.0.0.1:{free_port()}"
            connection = "\n".join([f'brokers: {{{self.kind}: {{urls: ["{self.url}"]{self.properties}}}}}',
                                    f'metrics: {{address: "{self.page}"}}'])
            self.cluster.topology("worker", topology(self.kind, 'zk.servers: ["{zookeeper}"]', connection))
            self.cluster.wait_until_ready()
        except BaseException:
            self.cluster.stop()
            raise
        return self

    def __exit__(self, *failure):
        return self.cluster.__exit__(*failure)

    def deploy(self, drivers, shared):
        """Deploys more drivers, equally on all gateways, and waits until each gets its messages back."""
        if self.drivers == 0:
            self.deployments += 1
            self.orders = Orders(self.folder / f"orders-{self.deployments}", HOSTS)
        for host in range(HOSTS):
            properties = {"folder": self.orders.folder, "host": host, "hosts": HOSTS, "shared": str(shared).lower()}
            words = [word for name, value in properties.items() for word in ("--property", f"{name}={value}")]
            answer = self.cluster.answer("deploy", f"{DRIVER}.so", "--gateway", f"gateway-{host + 1}", "--count",
                                         drivers // HOSTS, "--wait", ORDER_S, *words, limit=ORDER_S + 60)
            if not answer["ok"]:
                raise StartError(f"{drivers} drivers were not deployed: {answer['text']}")
        self.drivers += drivers
        self.wait_until_served(50 if self.drivers <= 100 else 2)

    def partitions_read(self):
        """How many partitions the worker reads, of the topics of all gateways, as its page says; 0 when that does not answer."""
        try:
            with urllib.request.urlopen(f"http://{self.page}/metrics", timeout=PATIENCE_S) as answer:
                lines = answer.read().decode().splitlines()
        except OSError as error:
            print(f"the worker's page does not answer: {error}", flush=True)
            return 0.0
        return sum(float(line.rsplit(" ", 1)[1]) for line in lines if line.startswith("iotcloud_spout_channels{"))

    def undeploy(self):
        answer = self.cluster.answer("undeploy", "--all", "--wait", ORDER_S, limit=ORDER_S + 60)
        if not answer["ok"]:
            raise StartError(f"{self.drivers} drivers were not taken away: {answer['text']}")
        self.drivers = 0


class OneProcess(System):
    """Everything in one process, on the embedded broker."""

    url = "embedded://bare"

    def __enter__(self):
        self.folder.mkdir(parents=True, exist_ok=True)
        self.cluster = Children(self.folder)
        return self

    def __exit__(self, *failure):
        return self.cluster.__exit__(*failure)

    def deploy(self, drivers, _shared):
        self.orders = Orders(self.folder / "orders", 1)
        file = self.folder / "topology.yaml"
        file.write_text(topology("embedded", 'registry: "embedded://local"'))
        process = self.cluster.spawn("local", [self.build / "bin/bench_paper_local", file, self.orders.folder, drivers],
                                     stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        if process.stdout.readline().strip() != "READY":
            raise StartError(f"local mode did not start: {self.cluster.log('local').read_text()}")
        self.drivers = drivers
        self.wait_until_served()


def system(kind, build, folder, **options):
    return OneProcess(kind, build, folder) if kind == "embedded" else Cluster(kind, build, folder, **options)

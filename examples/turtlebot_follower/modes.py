"""The ways the demo runs: everything in one process, or a private cluster with a worker of ours or with Apache Storm."""

import re
import shutil
import subprocess
import sys
import time
import urllib.request
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent.parent / "tests/servers"))

from private_cluster import (Children, PrivateCluster, StartError, Unavailable, cpu_seconds,  # noqa: E402,F401
                             free_port)
import private_server  # noqa: E402
import storm_jar  # noqa: E402

# Roles of processes and the text that their command lines contain. The first match in this order counts, because command
# lines of our programs also name the servers.
ROLES = (("all in one process", "turtlebot-demo"), ("driver host", "iotcloud-driver-host"),
         ("Storm's daemons", "-Ddaemon.name="), ("topology", "org.apache.storm.daemon.worker.Worker"),
         ("gateways", "iotcloud-gateway"), ("topology", "iotcloud-topology"), ("master", "iotcloud-master"),
         ("zookeeper", "zookeeper"), ("rabbitmq", "rabbit"), ("kafka", "kafka"), ("activemq", "activemq"))


@dataclass
class Robot:
    """An instance of the turtle driver to deploy."""
    gateway: str
    properties: dict

    @property
    def trace(self):
        return self.properties["trace"]

    def words(self):
        return [f"{key}={value}" for key, value in self.properties.items()]


def slowest_tasks(times):
    """p50 and p99 of each bolt's execute in ms; of several tasks the slowest counts. `times`: (bolt, "p50" or "p99", ms)."""
    bolts = {}
    for bolt, key, value in times:
        slowest = bolts.setdefault(bolt, {"p50": 0, "p99": 0})
        slowest[key] = max(slowest[key], round(value, 4))
    return bolts


def times_on_page(metrics_address):
    """The times of a worker's tasks, from its metrics."""
    text = urllib.request.urlopen(f"http://{metrics_address}/metrics", timeout=60).read().decode()
    for labels, value in re.findall(r"^iotcloud_task_execute_seconds\{([^}]*)\} (\S+)$", text, re.M):
        fields = dict(re.findall(r'(\w+)="([^"]*)"', labels))
        key = {"0.5": "p50", "0.99": "p99"}.get(fields.get("quantile"))
        if key and float(value) == float(value):  # NaN: no measurement
            yield fields["component"], key, float(value) * 1000


def times_in_file(file):
    """The same, from the file that turtlebot-demo writes at its end: a line for each task."""
    for line in file.read_text().splitlines():
        bolt, p50, p99 = line.split("\t")
        yield bolt, "p50", float(p50)
        yield bolt, "p99", float(p99)


class Measurement:
    """CPU time of all processes of this demo, between begin and end."""

    def __init__(self, out):
        self.marker = str(out)
        self.begin, self.time = cpu_seconds(self.marker), time.monotonic()

    def finish(self, broker):
        elapsed = time.monotonic() - self.time
        cores = {}
        for pid, (command, seconds) in cpu_seconds(self.marker).items():
            name = next((role for role, pattern in ROLES if pattern in command), None)
            if name:
                before = self.begin.get(pid, (command, 0.0))[1]
                cores[name] = cores.get(name, 0) + (seconds - before) / elapsed
        cores = {name: round(value, 3) for name, value in sorted(cores.items())}
        cores["total"] = round(sum(cores.values()), 3)
        return {"broker": broker, "cpu_cores": cores}


class OneProcess(Children):
    """Gateway, master and topology in one process; the broker embedded, or a private server."""

    view = False  # whether it has a page, whose address is then in `page`

    def __init__(self, build, out, broker):
        super().__init__(out)
        self.build, self.broker = build.resolve(), broker

    def begin(self, robots):
        url = [] if self.broker == "embedded" else [f"--broker-url={self.server(self.broker)}"]
        program = "turtlebot-demo-view" if self.view else "turtlebot-demo"
        view = ["--view", "127.0.0.1:0", "--pages", HERE / "page"] if self.view else []
        self.times = self.out / "times.tsv"
        self.times.unlink(missing_ok=True)  # of an earlier run
        started = self.spawn("turtlebot-demo", [
            self.build / "bin" / program, *url, *view, "--plugins", self.build / "plugins",
            "--topology", HERE / "follower.yaml", "--times", self.times,
            *(word for robot in robots for word in ["--robot", robot.gateway, *robot.words()])], **({"stdout": subprocess.PIPE, "text": True} if self.view else {}))
        if self.view:
            self.page = started.stdout.readline().strip()
            if not self.page:
                raise StartError(f"turtlebot-demo has no page; see {self.log('turtlebot-demo')}")
        self.measurement = Measurement(self.out)

    def finish(self):
        self.require_alive()
        measured = self.measurement.finish(self.broker)
        self.stop()
        if not self.times.exists():
            raise StartError(f"turtlebot-demo did not write {self.times}; see {self.log('turtlebot-demo')}")
        return measured | {"bolts_ms": slowest_tasks(times_in_file(self.times))}


class Cluster(PrivateCluster):
    """RabbitMQ, ZooKeeper, one master, two gateways, a topology worker; drivers deployed by the CLI."""

    view = False  # whether it has a page, whose address is then in `page`

    def __init__(self, build, out, broker):
        super().__init__(out, build / "bin", build / "plugins")
        self.broker = broker

    def begin(self, robots):
        print("starting RabbitMQ, ZooKeeper, a master and two gateways ...", flush=True)
        port = free_port()
        self.page = f"http://127.0.0.1:{port}/"
        self.start(gateways=2, of_masters=f'console: {{address: "127.0.0.1:{port}", pages: {{folder: "{HERE / "page"}"}}}}' if self.view else "")
        topology = (HERE / "follower.yaml").read_text()
        topology = re.sub(r"(?m)^zk\.servers:.*$", 'zk.servers: ["{zookeeper}"]', topology)
        topology = re.sub(r"(?m)^topology\.library:.*$",
                          f'topology.library: "{self.plugins / "turtlebot_follower.so"}"', topology)
        self.metrics = self.run_topology(topology)
        self.wait_until_ready()
        print("deploying the turtle driver ...", flush=True)
        for robot in robots:
            self.deploy("turtle.so", robot.gateway, robot.properties)
        self.measurement = Measurement(self.out)

    def run_topology(self, topology):
        """Returns the address of the worker's metrics; None: it has none."""
        metrics = f"127.0.0.1:{free_port()}"
        print("starting the topology's worker ...", flush=True)
        self.topology("topology", f'{topology}\nmetrics: {{address: "{metrics}"}}\n')
        return metrics

    def finish(self):
        self.require_alive()
        measured = self.measurement.finish(self.broker)
        times = times_on_page(self.metrics) if self.metrics else ()
        measured["bolts_ms"] = slowest_tasks(times)
        self.undeploy_all()
        self.stop()
        return measured


class Storm(Cluster):
    """The same, with a private Apache Storm (Nimbus, a Supervisor, a worker, a ZooKeeper of its own) for the topology."""

    LIMIT_S = 300

    def run_topology(self, topology):
        try:
            storm_jar.build()
        except private_server.Unavailable as reason:
            raise Unavailable(str(reason)) from reason
        shutil.rmtree(self.out / "storm", ignore_errors=True)  # or a topology of the last run would run again
        print("starting Storm ...", flush=True)
        self.nimbus = self.server("storm")
        file = self.out / "topology.yaml"
        file.write_text(topology.replace("{zookeeper}", self.zookeeper.removeprefix("zookeeper://")))
        print("submitting the topology ...", flush=True)
        self.storm("submit", file, "--limit", self.LIMIT_S)

    def storm(self, *words):
        """Runs iotcloud-storm. Raises StartError with its message when it fails."""
        done = subprocess.run([str(word) for word in (self.bin / "iotcloud-storm", *words, "--nimbus", self.nimbus)],
                              capture_output=True, text=True, check=False)
        if done.returncode:
            raise StartError(f"iotcloud-storm {words[0]}: {done.stderr.strip()}")

"""The sides that take turns in `./dev bench storm`: our worker, our runtime and Storm, on the same private servers."""

import contextlib
import os
import resource
import sys
import time
import urllib.request
from pathlib import Path

from figures import ProgramFailed, Programs

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent / "tests" / "servers"))
from private_cluster import PrivateCluster, StartError, echo_topology, free_port  # noqa: E402
from local_storm import Storm, cpu_seconds_of  # noqa: E402

OURS, STORM, BARE = "ours", "storm", "bare"  # BARE: both ends on librabbitmq alone, in one process
DRIVERS = 4  # each has a spout task and a bolt task
PENDING = 4096  # tracked items under way, as in bench/runtime
SETTLE_S = {"echo": 1.0, "memory": 0.5}  # the first seconds of each turn, which do not count
WORKER_LIMIT_S = 30
# Heap and collector of the JVM: the echo needs short pauses, the runs in memory need throughput.
JVM_ECHO = ["-Xms1g", "-Xmx1g", "-XX:+UseG1GC", "-XX:MaxGCPauseMillis=20"]
JVM_MEMORY = ["-Xms2g", "-Xmx2g", "-XX:+UseG1GC"]
# The loads of the warm-up, in which the JVM compiles: (size, messages a second of each driver).
WARM_UP_LOADS = ((100, 500), (60_000, 100))
DEFAULTS, TUNED = "Storm, defaults", "Storm, tuned"
# Storm's performance guide for low latency: no batches (the default, too), and the wait strategy that parks for 100 us
# in place of the default one's sleep of a millisecond; fewer samples for its own statistics.
PARK = "org.apache.storm.policy.WaitStrategyPark"
LOW_LATENCY = {"topology.producer.batch.size": 1, "topology.transfer.batch.size": 1,
               "topology.spout.wait.strategy": PARK, "topology.spout.wait.park.microsec": 100,
               "topology.bolt.wait.strategy": PARK, "topology.bolt.wait.park.microsec": 100,
               "topology.disable.loadaware.messaging": "true", "topology.stats.sample.rate": 0.001}
# And for throughput: batches, which are flushed after a millisecond when they are not full.
HIGH_THROUGHPUT = {"topology.producer.batch.size": 1000, "topology.batch.flush.interval.millis": 1,
                   "topology.disable.loadaware.messaging": "true", "topology.stats.sample.rate": 0.001}


def settings_of(topology, tracked, setting):
    tuned = LOW_LATENCY if topology == "echo" else HIGH_THROUGHPUT
    pending = {"topology.max.spout.pending": PENDING} if tracked and topology != "echo" else {}
    return {**(tuned if setting == TUNED else {}), **pending}


def worker_yaml(name, tracked, page):
    """The YAML of our topology, which sends what comes from the channel `data` of the driver `name` to its channel
    `control`."""
    text = echo_topology(DRIVERS, DRIVERS, f'metrics: {{address: "{page}"}}')
    for ours, theirs in (("topology.name: echo", f"topology.name: {name}"), ("driver: loadgen", f"driver: {name}"),
                         ("channel: echo", "channel: control")):
        text = text.replace(ours, theirs)
    if tracked:
        return text
    # As in Storm without ackers, the broker forgets a message when it has sent it.
    text = text.replace(f"parallelism: {DRIVERS}}}", f"parallelism: {DRIVERS}, properties: {{ackMode: auto}}}}")
    return text + "runtime: {acking: false}\n"


class Turns:
    """The private servers and the sides that take turns on them; a context manager that ends all of them."""

    def __init__(self, programs, folder, class_path):
        self.devices, self.runtime, self.records = (Programs(programs, kind) for kind in ("brokers", "runtime", "peers"))
        self.class_path = class_path
        self.cluster = PrivateCluster(Path(folder), programs, programs)
        self.ends, self.storm, self.brokers = {BARE: ("bare", None)}, None, []

    def __enter__(self):
        self.cluster.zookeeper = self.cluster.server("zookeeper", "--steady")
        before = set(self.cluster.descendants())
        self.cluster.rabbitmq = self.cluster.server("rabbitmq")
        self.brokers = sorted(set(self.cluster.descendants()) - before)
        self.sentences = self.cluster.out / "sentences"
        self.sentences.write_text(self.runtime.output("iotcloud", "--print-sentences"))
        return self

    def __exit__(self, *_):
        self.cluster.stop()

    def start(self, topology, tracked, setting, options):
        zookeeper = self.cluster.zookeeper.removeprefix("zookeeper://")
        return Storm(self.cluster, self.class_path, JVM_ECHO if topology == "echo" else JVM_MEMORY, topology,
                     [("--zookeeper", zookeeper), *options, *[("--tracked",)] * tracked],
                     settings_of(topology, tracked, setting))

    @contextlib.contextmanager
    def echo(self, tracked, setting, warm_up_s):
        """Starts our worker and Storm's topology and warms both up; Storm is then stopped (SIGSTOP)."""
        kind = "tracked" if tracked else "untracked"
        self.ends[OURS] = (f"bench.ours-{kind}", self.worker(f"ours-{kind}", tracked))
        options = [("--url", self.cluster.rabbitmq.rstrip("/")), ("--name", f"storm-{kind}"), ("--drivers", DRIVERS)]
        with self.start("echo", tracked, setting, options) as self.storm:
            self.ends[STORM] = (f"storm-{kind}", self.storm.pid)
            for size, rate in WARM_UP_LOADS:
                self.measure_devices(STORM, size, rate, warm_up_s / len(WARM_UP_LOADS))
            self.storm.stand_still()
            self.measure_devices(OURS, *WARM_UP_LOADS[0], 1)
            yield

    @contextlib.contextmanager
    def memory(self, dag, tracked, setting, warm_up_s):
        """Starts Storm's topology, warms it up at full speed and stops it (SIGSTOP). At its end checks that all that it
        sent arrived."""
        with self.start(dag, tracked, setting, [("--sentences", self.sentences)]) as self.storm:
            time.sleep(warm_up_s)
            self.storm.stand_still()
            yield
            self.storm.go_on()
            self.storm.check_complete()

    def worker(self, name, tracked):
        """The process of our topology worker, started if it does not run yet."""
        for started, child in self.cluster.children:
            if started == name:
                return child.pid
        self.records.output("records", "--registry", self.cluster.zookeeper, "--broker", self.cluster.rabbitmq, "--name",
                            name, "--drivers", DRIVERS)
        page = f"127.0.0.1:{free_port()}"
        child = self.cluster.topology(name, worker_yaml(name, tracked, page))
        limit = time.monotonic() + WORKER_LIMIT_S
        while channels_read(page) < DRIVERS:
            self.cluster.require_alive()
            if time.monotonic() > limit:
                said = self.cluster.log(name).read_text(errors="replace").splitlines()[-1:]
                raise StartError(f"our worker did not read its channels within {WORKER_LIMIT_S} s: {' '.join(said)}")
            time.sleep(0.05)
        return child.pid

    @contextlib.contextmanager
    def storms_turn(self):
        self.storm.go_on()
        try:
            yield
        finally:
            self.storm.stand_still()

    def echo_turn(self, side, size, rate, seconds):
        if side != STORM:
            return self.measure_devices(side, size, rate, seconds)
        with self.storms_turn():
            return self.measure_devices(STORM, size, rate, seconds)

    def measure_devices(self, side, size, rate, seconds):
        """Runs the load of all drivers, which this side sends back. Returns a line of figures."""
        name, process = self.ends[side]
        others = [word for server in self.brokers for word in ("--server", server)]
        others += ["--devices-only", "--processor", process] if process else []
        line = self.devices.run(
            "rabbitmq", "--url", self.cluster.rabbitmq, "--name", name, "--drivers", DRIVERS, "--size",
            size, "--rate", rate, "--warm-up", SETTLE_S["echo"], "--seconds", seconds, *others)[0]
        if not line["sustained"] or not line["count"]:
            raise ProgramFailed(f"{side}: {size} B, {DRIVERS} x {rate}/s is more than goes through")
        return line

    def memory_turn(self, side, dag, tracked, seconds):
        """Measures one turn in memory. Returns {"per_second", "cpus", "others_cpu"}."""
        if side == OURS:
            before, own, began = machine_cpu_seconds(), ended_cpu_seconds(), time.monotonic()
            line = self.runtime.run("iotcloud", "--dag", dag, "--warm-up", SETTLE_S["memory"], "--seconds", seconds,
                                    *["--tracked"] * tracked)[0]
            others = machine_cpu_seconds() - before - (ended_cpu_seconds() - own)
            return {"per_second": line["per_second"], "cpus": line["cpu_percent"] / 100,
                    "others_cpu": max(0.0, others / (time.monotonic() - began))}
        with self.storms_turn():
            time.sleep(SETTLE_S["memory"])
            before, own, began = machine_cpu_seconds(), cpu_seconds_of(self.storm.pid), time.monotonic()
            line = self.storm.rate(seconds)
            others = machine_cpu_seconds() - before - (cpu_seconds_of(self.storm.pid) - own)
            return {**line, "others_cpu": max(0.0, others / (time.monotonic() - began))}


def channels_read(page):
    """Number of channels that our worker reads, by its metrics; 0 while it starts."""
    try:
        text = urllib.request.urlopen(f"http://{page}/metrics", timeout=10).read().decode()
    except OSError:
        return 0
    return sum(float(line.rsplit(" ", 1)[1]) for line in text.splitlines() if line.startswith("iotcloud_spout_channels{"))


def machine_cpu_seconds():
    """CPU seconds of the whole machine since it booted."""
    with open("/proc/stat", encoding="ascii") as file:
        ticks = list(map(int, file.readline().split()[1:9]))
    # leaves out idle time and time waiting for a disk
    return (sum(ticks) - ticks[3] - ticks[4]) / os.sysconf("SC_CLK_TCK")


def ended_cpu_seconds():
    """CPU seconds of the children that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime

"""The sides that take turns on a private Storm cluster in `./dev bench storm`: components of C++ in Storm's workers, the
same in plain Java, and our own worker with the library of the first."""

import contextlib
import dataclasses
import json
import os
import signal
import subprocess
import sys
import time
import zipfile
from pathlib import Path

from figures import ProgramFailed, Programs
from local_storm import cpu_seconds_of
from storm_board import FULL, NOTHING, Board
from storm_turns import machine_cpu_seconds

sys.path.insert(0, str(Path(__file__).resolve().parent.parent.parent / "tests" / "servers"))
import private_server  # noqa: E402
import storm_jar  # noqa: E402
from private_cluster import Children, StartError, Unavailable  # noqa: E402
from storm import Storm  # noqa: E402

CPP, JAVA, OWN = "C++ on Storm", "plain Java", "our own worker"
SLOTS = 4  # two topologies with two workers each
SETTLE_S = 1.0  # the first second of each turn, which does not count
READY_LIMIT_S, END_LIMIT_S, DRAIN_LIMIT_S = 300, 60, 60
BUSY = 4  # times its length that a warm-up takes at most
WORKER_JVM = "-Xms1g -Xmx1g -XX:+UseG1GC"
STANDSTILL_S = 600  # Storm does not take workers for dead while they are stopped
PATIENCE = {"supervisor.worker.timeout.secs": STANDSTILL_S, "nimbus.task.timeout.secs": STANDSTILL_S,
            "storm.zookeeper.session.timeout": 60_000, "storm.zookeeper.connection.timeout": 60_000}


@dataclasses.dataclass(frozen=True)
class Load:
    """A DAG with its items."""

    name: str
    unit: str
    bolts: str  # of the topology's file
    size: int = 0  # of a payload
    sentences: bool = False
    results: int = 1  # how many an item brings
    pending: int = 1000  # tracked items under way at most
    mailbox: int = 0  # tuples that wait for a task at most; 0: as many as usual


CHAIN = """
  pass: {class: bench.Pass, inputs: [{from: source}]}
  sink: {class: bench.Sink, inputs: [{from: pass}]}"""
WORDS = """
  split: {class: bench.Split, parallelism: 2, inputs: [{from: source}]}
  count: {class: bench.Count, parallelism: 2, inputs: [{from: split, grouping: fields, fields: [word]}]}"""
LOADS = {
    "chain": Load("chain of 3", "tuple", CHAIN),
    "words": Load("word count", "word", WORDS, sentences=True, results=10),
    "1 KiB": Load("1 KiB payload", "tuple", CHAIN, size=1024),
    # Storm's usual queues would hold more payloads than the heap does.
    "100 KB": Load("100 KB payload", "tuple", CHAIN, size=100_000, pending=100, mailbox=128)}


def topology_yaml(name, load, workers, items, library, more=""):
    """The topology's file, for Storm and for our worker. `items`: what its components are told; `more`: other lines."""
    conf = "".join(f"  {key}: {json.dumps(value)}\n" for key, value in items.items())
    runtime = {"acking": json.dumps(items["tracked"]), "max_spout_pending": load.pending,
               **({"mailbox_capacity": load.mailbox} if load.mailbox else {})}
    return f"""topology.name: {name}
topology.library: "{library}"
conf:
{conf}runtime: {{{", ".join(f"{key}: {value}" for key, value in runtime.items())}}}
engine: {{storm: {{workers: {workers}, ackers: 1}}}}
{more}spouts:
  source: {{class: bench.Source}}
bolts:{load.bolts}
"""


class Side:
    """One topology and its processes, which are stopped (SIGSTOP) while it is not their turn."""

    def __init__(self, cluster, name, load, workers, tracked):
        self.cluster, self.name, self.load, self.workers = cluster, name, load, workers
        self.submitted, self.stopped = False, []
        self.board = Board(cluster.out / name)
        self.items = {"board": str(self.board.folder), "tracked": tracked, "results": load.results, "size": load.size,
                      "sentences": str(cluster.sentences) if load.sentences else ""}
        self.file = cluster.out / f"{name}.yaml"
        self.file.write_text(topology_yaml(name, load, workers, self.items, cluster.library, self.more()))

    def more(self):
        return ""

    def begin(self):
        """Starts it and waits until results come."""
        self.submit()
        self.submitted = True
        self.board.send(FULL)
        limit = time.monotonic() + READY_LIMIT_S
        while not self.board.counts().results or len(self.processes()) < self.workers:
            if time.monotonic() > limit:
                raise StartError(f"{self.name}: no results within {READY_LIMIT_S} s{self.cluster.errors()}")
            time.sleep(0.1)
        self.drain()
        self.stand_still()

    def stand_still(self):
        self.stopped = self.processes()
        for process in self.stopped:
            os.kill(process, signal.SIGSTOP)
        while not all(map(is_stopped, self.stopped)):
            time.sleep(0.001)

    def go_on(self):
        for process in self.stopped:
            os.kill(process, signal.SIGCONT)
        self.stopped = []

    def warm_up(self, seconds):
        """Lets it run at full speed for so long, and on a busy machine until it has had so much of the CPU."""
        self.go_on()
        self.board.send(FULL)
        processes, began = self.processes(), time.monotonic()
        cpu = cpu_of(processes)
        time.sleep(seconds)
        while cpu_of(processes) - cpu < seconds and time.monotonic() - began < BUSY * seconds:
            time.sleep(0.1)
        self.drain()
        self.stand_still()

    def drain(self):
        """Lets nothing more be sent, and waits until all that was sent has arrived."""
        self.board.send(NOTHING)
        limit = time.monotonic() + DRAIN_LIMIT_S
        while (counts := self.board.counts()).results < counts.emitted * self.load.results:
            if time.monotonic() > limit:
                raise ProgramFailed(f"{self.name}: {counts.results} of {counts.emitted * self.load.results} results arrived"
                                    + self.cluster.errors())
            time.sleep(0.01)
        if counts.failed:
            raise ProgramFailed(f"{self.name}: {counts.failed} failed{self.cluster.errors()}")

    def turn(self, rate, seconds):
        """Measures one turn at this rate. Returns a line of figures."""
        self.go_on()
        try:
            self.board.send(rate)
            time.sleep(SETTLE_S)
            line = self.measure(seconds)
            self.drain()
            return line
        finally:
            self.board.send(NOTHING)
            self.stand_still()

    def measure(self, seconds):
        processes, daemons = self.processes(), self.cluster.daemons()
        counts, cpu, servers, machine, began = (self.board.counts(), cpu_of(processes), cpu_of(daemons), machine_cpu_seconds(),
                                                time.monotonic())
        time.sleep(seconds)
        took = time.monotonic() - began
        counts, cpu = self.board.counts() - counts, cpu_of(processes) - cpu
        others = machine_cpu_seconds() - machine - cpu - (cpu_of(daemons) - servers)
        if not counts.results:
            raise ProgramFailed(f"{self.name}: no results within {seconds} s{self.cluster.errors()}")
        return {"per_second": counts.results / took, "cpu_us": 1e6 * cpu / counts.results, "cpus": cpu / took,
                "others_cpu": max(0.0, others / took), "p50_us": counts.latency_us(0.5), "p99_us": counts.latency_us(0.99)}


class OnStorm(Side):
    def processes(self):
        return list(self.cluster.storm.running_workers(self.name).values())

    def end(self):
        self.go_on()
        self.cluster.ask("kill", self.name, "--wait", 0)
        limit = time.monotonic() + END_LIMIT_S
        while self.processes():
            if time.monotonic() > limit:
                raise StartError(f"{self.name}: its workers did not end within {END_LIMIT_S} s")
            time.sleep(0.1)


class Cpp(OnStorm):
    def submit(self):
        self.cluster.ask("submit", self.file, "--limit", 0)


class Java(OnStorm):
    def submit(self):
        """With the settings that our program gives Storm for the same topology."""
        jar = self.file.with_suffix(".jar")
        self.cluster.run([self.cluster.program("iotcloud-storm"), "pack", self.file, jar])
        with zipfile.ZipFile(jar) as packed:
            conf = json.loads(packed.read("iotcloud-job.json"))["conf"]
        jars, folder = Path(self.cluster.class_path).parent, self.cluster.storm.folder
        self.cluster.run(["java", *private_server.SMALL_JVM, f"-Dstorm.jar={next(jars.glob('storm-1.jar'))}",
                          "-Dlog4j2.configurationFile=classpath:bench-log4j2.xml", "-cp", f"{self.cluster.class_path}:{folder}/conf",
                          "iotcloud.bench.storm.OnWorkers", json.dumps({**conf, "topology.name": self.name}),
                          json.dumps(self.items)])


class Own(Side):
    process = None

    def more(self):
        return f"registry: embedded://{self.name}\n"

    def submit(self):
        self.process = self.cluster.spawn(self.name, [self.cluster.program("iotcloud-topology"), "--config", self.file])

    def processes(self):
        self.cluster.require_alive()
        return [self.process.pid]

    def end(self):
        self.go_on()
        self.process.terminate()
        self.process.wait(END_LIMIT_S)
        self.cluster.children.remove((self.name, self.process))


SIDES = {CPP: Cpp, JAVA: Java, OWN: Own}


class Cluster(Children):
    """A private Storm and the topologies on it; a context manager that ends all of them."""

    def __init__(self, build, folder, class_path, worker_jvm=WORKER_JVM):
        super().__init__(folder)
        self.build, self.class_path, self.worker_jvm, self.storm, self.number = build.resolve(), class_path, worker_jvm, None, 0
        self.library = self.build / "plugins" / "bench_storm_components.so"
        self.sides = {}

    def __enter__(self):
        self.sentences = self.out / "sentences"
        self.sentences.write_text(Programs(self.build / "bin", "runtime").output("iotcloud", "--print-sentences"))
        try:
            storm_jar.build()
            self.storm = Storm(self.out / "storm", slots=SLOTS, worker_jvm=self.worker_jvm, more=PATIENCE)
            self.storm.start()
        except private_server.Unavailable as why:
            raise Unavailable(str(why)) from why
        except RuntimeError as error:
            self.__exit__()
            raise StartError(str(error)) from error
        return self

    def __exit__(self, *_):
        self.stop()
        if self.storm:
            self.storm.stop()

    def program(self, name):
        return self.build / "bin" / name

    def run(self, command):
        done = subprocess.run(list(map(str, command)), capture_output=True, text=True, check=False,
                              env=private_server.java_environment())
        if done.returncode:
            raise StartError(f"{Path(command[0]).name} {command[1]}: {done.stderr.strip() or done.stdout.strip()}{self.errors()}")
        return done.stdout

    def ask(self, *words):
        return self.run([self.program("iotcloud-storm"), *words, "--nimbus", self.storm.url()])

    def daemons(self):
        return [part.process.pid for part in self.storm.parts.values()]

    def logs(self, pattern):
        """The texts of such files that the workers left."""
        files = sorted((Path(self.storm.folder) / "logs" / "workers-artifacts").rglob(pattern))
        return [file.read_text(errors="replace") for file in files]

    def errors(self):
        """The first error that a worker logged, for the text of a failure: the logs go with the benchmark."""
        said = [line for log in self.logs("worker.log*") for line in log.splitlines() if "[ERROR]" in line]
        return f"; a worker says: {said[0][:300]}" if said else ""

    @contextlib.contextmanager
    def phase(self, load, workers, tracked, warm_up_s, sides):
        """Starts the topology on these sides, and warms each up."""
        self.number += 1
        try:
            for side in sides:
                name = f"{side.split()[0].lower().replace('+', 'p')}-{self.number}"
                self.sides[side] = SIDES[side](self, name, LOADS[load], workers, tracked)
                self.sides[side].begin()
            for side in sides:
                self.sides[side].warm_up(warm_up_s)
            yield
        finally:
            while self.sides:
                side = self.sides.popitem()[1]
                if side.submitted:
                    side.end()

    def turn(self, side, rate, seconds):
        return self.sides[side].turn(rate, seconds)


def is_stopped(process):
    """Whether all threads of a process have stopped, or the process has ended."""
    try:
        threads = [Path(f"/proc/{process}/task/{thread}/stat").read_text() for thread in os.listdir(f"/proc/{process}/task")]
    except OSError:
        return False if Path(f"/proc/{process}").exists() else True
    return all(stat.rpartition(")")[2].split()[0] in "TtZX" for stat in threads)


def cpu_of(processes):
    """CPU seconds that these processes have used."""
    return sum(map(cpu_seconds_of, processes))

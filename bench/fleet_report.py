"""The figures of `./dev bench fleet`: how long deploying a fleet takes, its memory at rest, and how long listing it
takes."""

import socket
import statistics
import struct
import sys
import tempfile
import time
import urllib.request
from pathlib import Path

from brokers_report import Report

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "servers"))
from private_cluster import PrivateCluster, StartError, echo_topology, free_port, wait_for  # noqa: E402

LOADED, RATE, SIZE, CARRIED_S = 1000, 5, 100, 10  # the paper's load
DEPLOY_LIMIT_S, MEMORY_LIMIT_MB, LIST_LIMIT_MS = 20, 200, 200
ORDER_LIMIT_S = 300
LISTS = 9  # number of times that a list is taken; the figure is the median


class Fleet(PrivateCluster):
    def server(self, kind):
        return super().server(kind, *["--steady"] * (kind == "zookeeper"))

    def worker(self):
        self.page = f"127.0.0.1:{free_port()}"
        self.topology("worker", echo_topology(more=f'metrics: {{address: "{self.page}"}}'))

    def deploy_all(self, count, properties):
        """Deploys `count` load generators on each gateway. Returns the seconds until `iotcloud deploy` said that all
        are active."""
        words = [word for name, value in properties.items() for word in ("--property", f"{name}={value}")]
        began = time.monotonic()
        answer = self.answer("deploy", "loadgen.so", "--all", "--count", count, "--wait", ORDER_LIMIT_S, *words,
                             limit=ORDER_LIMIT_S + 60)
        took = time.monotonic() - began
        if not answer["ok"]:
            raise StartError(answer["text"])
        return took

    def received(self):
        """Number of messages that the topology has received so far."""
        text = urllib.request.urlopen(f"http://{self.page}/metrics", timeout=10).read().decode()
        return sum(float(line.rsplit(" ", 1)[1]) for line in text.splitlines()
                   if line.startswith("iotcloud_spout_received_total{"))

    def carried(self):
        """Messages that the topology receives in a second."""
        before, began = self.received(), time.monotonic()
        time.sleep(CARRIED_S)
        return (self.received() - before) / (time.monotonic() - began)

    def list_process_ms(self):
        """Median duration of the process `iotcloud drivers`, in ms."""
        return self.timed(lambda: self.cli("drivers"))

    def list_call_ms(self):
        """Median duration of the call that `iotcloud drivers` makes to the master, in ms: on an open connection, until
        the answer's last byte."""
        name = b"listDrivers"
        call = struct.pack("!iI", -0x7FFEFFFF, len(name)) + name + struct.pack("!ib", 0, 0)
        with socket.create_connection(("127.0.0.1", self.api_port), timeout=60) as master:
            def ask():
                master.sendall(struct.pack("!I", len(call)) + call)
                head = master.recv(4, socket.MSG_WAITALL)
                left = struct.unpack("!I", head)[0]
                while left:
                    left -= len(master.recv(min(left, 1 << 20)))
            return self.timed(ask)

    @staticmethod
    def timed(action):
        times = []
        for _ in range(LISTS):
            began = time.monotonic()
            action()
            times.append(1000 * (time.monotonic() - began))
        return statistics.median(times)

    def hosts_mb(self):
        """Resident memory of each driver host, in MB."""
        found = []
        for process in self.descendants():
            folder = Path("/proc", str(process))
            if b"iotcloud-driver-host" not in (folder / "cmdline").read_bytes():
                continue
            resident = next(line for line in (folder / "status").read_text().splitlines() if line.startswith("VmRSS:"))
            found.append(int(resident.split()[1]) * 1024 / 1e6)
        return found


class Bench:
    def __init__(self, given, folder):
        self.build, self.folder, self.runs = given.build, Path(folder), 0

    def fleet(self):
        self.runs += 1
        return Fleet(self.folder / f"run{self.runs}", self.build / "bin", self.build / "plugins")

    def loaded(self, shared):
        """Runs a round with 1000 instances on two gateways and a topology that sends all messages back. Returns its
        figures."""
        with self.fleet() as fleet:
            fleet.start(gateways=2)
            fleet.worker()
            fleet.wait_until_ready()
            figures = {"deployed": fleet.deploy_all(LOADED // 2, {"size": SIZE, "rate": RATE, "shared": shared})}
            wait_for("all that is sent comes through", lambda: fleet.carried() > 0.9 * LOADED * RATE, 60)
            figures.update(carried=fleet.carried(), process=fleet.list_process_ms(), call=fleet.list_call_ms())
            fleet.require_alive()
            return figures

    def idle(self, instances):
        """Runs a round with instances in one driver host that each send a message in 100 s. Returns its figures."""
        with self.fleet() as fleet:
            fleet.start(gateways=1)
            fleet.wait_until_ready()
            figures = {"deployed": fleet.deploy_all(instances, {"size": SIZE, "rate": 0.01, "shared": "true"})}
            hosts = fleet.hosts_mb()
            if len(hosts) != 1:
                raise StartError(f"there are {len(hosts)} driver hosts, not one")
            figures.update(memory=hosts[0], process=fleet.list_process_ms(), call=fleet.list_call_ms())
            fleet.require_alive()
            return figures


def listed(report, title, of):
    report.compare(f"{title}: `iotcloud drivers`", "ms", of("process"), at_most=LIST_LIMIT_MS)
    report.compare(f"{title}: of that the call", "ms", of("call"), at_most=LIST_LIMIT_MS)


def run_fleet(given):
    report, rounds = Report(), given.rounds or (1 if given.quick else 3)
    report.print_head()
    with tempfile.TemporaryDirectory(prefix="iotcloud-bench-") as folder:
        bench = Bench(given, folder)

        def figures(title, judge, turn):
            try:
                lines = [turn() for _ in range(rounds)]
            except (StartError, SystemExit) as failure:  # wait_for() ends a test
                report.fail(f"{title}: GIVEN UP: {failure}")
                return
            judge(title, lambda figure: [line[figure] for line in lines])

        def judge_loaded(title, of):
            report.compare(f"{title}: deployed", "s", of("deployed"), at_most=DEPLOY_LIMIT_S)
            report.compare(f"{title}: carried", "msg/s", of("carried"), "sent", [float(LOADED * RATE)] * rounds,
                           ratio_at_least=0.99)
            listed(report, title, of)

        def judge_idle(title, of):
            report.compare(f"{title}: deployed", "s", of("deployed"))
            report.compare(f"{title}: memory", "MB", of("memory"), at_most=MEMORY_LIMIT_MB)
            listed(report, title, of)

        for kind, shared in (("shared", "true"), ("exclusive", "false")):
            figures(f"{LOADED} in 2 gateways, {kind}", judge_loaded, lambda: bench.loaded(shared))
        figures(f"{given.instances} idle in one host", judge_idle, lambda: bench.idle(given.instances))
    return report, report.verdict()

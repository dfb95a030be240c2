"""The figures of `./dev bench discovery`: a topology before a large fleet of drivers, beside bare clients."""

import sys
import tempfile
from pathlib import Path

from brokers_report import NOISE, Report
from figures import ProgramFailed, Programs

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "servers"))
from private_cluster import Children, StartError  # noqa: E402

READY_LIMIT_S = {"shared": 5, "exclusive": 30}
BARE_READ, BARE_DECLARE = "zookeeper C client", "librabbitmq"


class Bench:
    """Runs the rounds: each has private servers and a fleet in a registry of its own."""

    def __init__(self, programs, servers, instances, fresh):
        self.programs, self.servers = programs, servers
        self.instances, self.fresh = instances, fresh
        self.zookeeper = self.rabbitmq = None
        self.runs = 0

    def options(self, registry, broker, shared):
        return ["--registry", registry, "--broker", broker, "--instances", self.instances] + ["--shared"] * shared

    def turn(self, kind):
        """Runs a round with real servers, which have a registry and queues of their own. Returns {figure: line of the
        program}."""
        self.runs += 1
        with Children(Path(self.servers) / f"run{self.runs}") as children:
            zookeeper, rabbitmq = children.server("zookeeper", "--steady"), children.server("rabbitmq")
            options = self.options(f"{zookeeper}/bench", rabbitmq, kind == "shared")
            lines = {"fill": self.programs.run("bare", "fill", *options)[0],
                     "read": self.programs.run("bare", "read", *options)[0],
                     "declare": self.programs.run("bare", "declare", *options)[0]}
            watched = [word for process in children.descendants() for word in ("--server", process)]
            for line in self.programs.run("iotcloud", *options, "--fresh", self.fresh, "--rest", 5, *watched):
                lines[line["figure"]] = line
            return lines

    def embedded(self, kind):
        """Runs the same in one process, which shows the limit that the topology's own code sets."""
        self.runs += 1
        name = f"embedded://bench-{self.runs}"
        lines = self.programs.run("iotcloud", *self.options(name, name, kind == "shared"), "--fresh", self.fresh,
                                  "--rest", 2)
        return {line["figure"]: line for line in lines}


def newcomers(report, title, lines):
    """Reports how soon a new driver is read. `lines` has a line for each round. A round in which other processes took
    more than NOISE CPUs is left out, because it shows how long threads wait for a CPU. If no round is left, the
    target is not judged."""
    quiet = [line for line in lines if line["others_cpu"] <= NOISE]
    title = f"{title}: a new driver is read"

    def compare(figure, unit, key, **target):
        report.compare(f"{title}, {figure}", unit, [line[key] for line in quiet or lines], **target)

    compare("p50", "ms", "p50_ms")
    compare("p99", "ms", "p99_ms", **({"at_most": 200} if quiet else {}))
    compare("that one's waits for a CPU", "ms", "p99_waited_ms")
    compare("other processes meanwhile", "CPUs", "others_cpu")
    compare("requests", "", "requests_each")
    if len(quiet) < len(lines):
        left_out = "left out" if quiet else "not judged: no round was quiet"
        print(f"{title}: in {len(lines) - len(quiet)} of {len(lines)} rounds other processes took more than {NOISE} of "
              f"a CPU; {left_out}", flush=True)


def figures(bench, report, kind, rounds):
    title = f"{bench.instances} instances, {kind}"
    real = [bench.turn(kind) for _ in range(rounds)]
    alone = [bench.embedded(kind) for _ in range(rounds)]

    def of(lines, figure, key):
        return [line[figure][key] for line in lines if figure in line]

    ready = of(real, "ready", "seconds")
    beside, theirs = ((BARE_DECLARE, of(real, "declare", "seconds")) if kind == "exclusive"
                      else (BARE_READ, of(real, "read", "seconds")))
    report.compare(f"{title}: ready", "s", ready, beside, theirs, at_most=READY_LIMIT_S[kind])
    report.compare(f"{title}: ready, embedded", "s", of(alone, "ready", "seconds"), at_most=READY_LIMIT_S[kind])
    report.compare(f"{title}: worker's CPU until ready", "s", of(real, "ready", "cpu_seconds"))
    report.compare(f"{title}: servers' CPU until ready", "s", of(real, "ready", "server_cpu_seconds"))
    report.compare(f"{title}: requests to ZooKeeper until ready", "", of(real, "ready", "requests"))
    report.compare(f"{title}: of these, writes", "", of(real, "ready", "writes"))
    report.compare(f"{title}: worker's memory", "MB", of(real, "ready", "resident_mb"))
    newcomers(report, title, [line["new"] for line in real if "new" in line])
    report.compare(f"{title}: worker at rest", "% CPU", of(real, "rest", "cpu_percent"), at_most=1)
    report.compare(f"{title}: servers at rest", "% CPU", of(real, "rest", "server_cpu_percent"))


def selection(programs, report, rounds):
    """Evaluates an expression on many drivers, beside the same conditions in plain C++."""
    lines = programs.run("selection", 100_000, max(rounds, 3) * 3)
    report.compare("100 000 drivers chosen by an expression", "ms", [line["seconds"] * 1000 for line in lines],
                   "plain C++", [line["plain_seconds"] * 1000 for line in lines], at_most=50)


def run_discovery(given):
    programs, report = Programs(given.build / "bin", "discovery"), Report()
    rounds = given.rounds or (1 if given.quick else 3)
    report.print_head()
    selection(programs, report, rounds)
    with tempfile.TemporaryDirectory(prefix="iotcloud-bench-") as folder:
        bench = Bench(programs, folder, given.instances, 50 if given.quick else 200)
        for kind in ("shared", "exclusive"):
            try:
                figures(bench, report, kind, rounds)
            except (ProgramFailed, StartError) as failure:
                report.fail(f"{kind}: GIVEN UP: {failure}")
    return report, report.verdict()

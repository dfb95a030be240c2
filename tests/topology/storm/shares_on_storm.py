#!/usr/bin/python3
"""A thousand drivers, each with a topic of its own on a private RabbitMQ, are shared by a hundred spout tasks in four workers
of a private Storm: the numbers of any two tasks differ by one at most, and a new driver is read within a second.

usage: shares_on_storm.py BUILD LIBRARY [--json FILE]
       (BUILD: build/release; LIBRARY: the library of components.cc; FILE: gets what was seen as figures)
"""
import argparse
import os
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "tests" / "servers"))
sys.path.insert(0, str(ROOT / "bench"))
import figures  # noqa: E402
import private_server  # noqa: E402
import storm_jar  # noqa: E402
import versions  # noqa: E402
from echo_on_storm import storm_program  # noqa: E402
from private_cluster import PrivateCluster, StartError, require, wait_for  # noqa: E402
from storm import Storm  # noqa: E402

SKIPPED = 77
DRIVERS, TASKS, WORKERS = 1000, 100, 4
NEW, NEW_LIMIT_S = 20, 1.0
LIMIT_S = 600
# Long waits: spouts are woken, and a hundred of them share the cores with all else.
YAML = """
zk.servers: ["{zookeeper}"]
topology.name: shares
topology.library: {library}
conf: {{out: "{out}"}}
runtime: {{max_spout_pending: 100, message_timeout: 60s}}
engine: {{storm: {{workers: {workers}, ackers: 1, spout_wait: 100ms, bolt_wait: 5ms, back_pressure_wait: 5ms}}}}
spouts:
  receive: {{broker: rabbitmq, driver: loadgen, channel: data, fields: [data, driverID, time], parallelism: {tasks}}}
bolts:
  readers: {{class: test.Readers, tick: 100ms, inputs: [{{from: receive, grouping: global}}]}}
"""


def deploy(cluster, count, rate):
    answer = cluster.answer("deploy", "loadgen.so", "--all", "--count", count, "--wait", LIMIT_S, "--property", "size=100",
                            "--property", f"rate={rate}", limit=LIMIT_S + 60)
    if not answer["ok"]:
        raise StartError(answer["text"])


class Shares:
    """What the bolt has written."""

    def __init__(self, folder):
        self.folder = folder

    def read(self):
        """The numbers of drivers by task, and the ages of first messages in ms by driver."""
        files = [file for file in self.folder.glob("readers.[0-9]*") if file.suffix != ".partial"]
        words = dict(line.split() for line in files[0].read_text().splitlines()) if files else {}
        return tuple({word: int(number) for word, number in words.items() if word.startswith(kind)} for kind in ("task-", "driver-"))

    def are_even(self, drivers):
        tasks, _ = self.read()
        counts = tasks.values()
        return len(tasks) == TASKS and sum(counts) == drivers and max(counts) - min(counts) <= 1

    def newcomer(self, known):
        """The driver that is not among those that were known, and how old its first message was; None as long as there is
        none."""
        ages = self.read()[1]
        return next(((driver, age / 1000) for driver, age in ages.items() if driver not in known), None)


def one_more(cluster, shares):
    """Deploys a driver. Returns after how many seconds it was read: since it was active, or since it sent its first message,
    whichever is more."""
    known = shares.read()[1]
    deploy(cluster, 1, 20)
    active = time.monotonic()
    limit = active + LIMIT_S
    while (found := shares.newcomer(known)) is None:
        require(time.monotonic() < limit, f"a new driver is read within {LIMIT_S} s")
        time.sleep(0.01)
    return max(time.monotonic() - active, found[1])


def measure(build, library, folder):
    storm, shares = Storm(folder / "storm", slots=WORKERS), Shares(folder)
    try:
        with PrivateCluster(folder / "cluster", build / "bin", build / "plugins") as cluster:
            cluster.start(gateways=1)
            storm.start()
            cluster.wait_until_ready()
            file = folder / "shares.yaml"
            file.write_text(YAML.format(zookeeper=cluster.zookeeper.removeprefix("zookeeper://"), library=library, out=folder,
                                        workers=WORKERS, tasks=TASKS))
            print(storm_program(build, storm, "submit", file, "--limit", LIMIT_S), end="", flush=True)
            began = time.monotonic()
            deploy(cluster, DRIVERS, 0.5)
            print(f"{DRIVERS} drivers are active after {time.monotonic() - began:.1f} s", flush=True)
            wait_for(f"{TASKS} tasks read {DRIVERS} drivers", lambda: shares.are_even(DRIVERS), LIMIT_S)
            even_s = time.monotonic() - began
            require(len(storm.running_workers()) == WORKERS, f"{WORKERS} workers run: {storm.running_workers()}")
            print(f"and shared evenly after {even_s:.1f} s", flush=True)
            read_s = sorted(one_more(cluster, shares) for _ in range(NEW))
            print("a new driver was read after " + " ".join(f"{each:.2f}" for each in read_s) + " s", flush=True)
            wait_for("the new ones are shared, too", lambda: shares.are_even(DRIVERS + NEW), LIMIT_S)
            counts = shares.read()[0].values()
            storm_program(build, storm, "kill", "shares", "--wait", "1")
    finally:
        storm.stop()
    return even_s, read_s, max(counts) - min(counts)


def figures_of(even_s, read_s, spread):
    """What was seen in the form of a benchmark's results."""
    title = f"{DRIVERS} topics, {TASKS} tasks, {WORKERS} workers"
    return [{"name": f"{title}: deployed, read and even", "value": even_s, "unit": "s", "met": None},
            {"name": f"{title}: difference between two tasks", "value": spread, "unit": "topics", "target": "<= 1", "met": spread <= 1},
            {"name": f"{title}: a new driver is read, median", "value": read_s[len(read_s) // 2], "unit": "s", "met": None},
            {"name": f"{title}: a new driver is read, at most", "value": read_s[-1], "unit": "s", "target": f"<= {NEW_LIMIT_S:g}",
             "met": read_s[-1] <= NEW_LIMIT_S}]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("build", type=Path)
    parser.add_argument("library", type=Path)
    parser.add_argument("--json", type=Path, help="writes what was seen to this file")
    given = parser.parse_args()
    begun = figures.begin(ROOT)
    try:
        storm_jar.build()
        with tempfile.TemporaryDirectory(prefix="iotcloud-storm-") as folder:
            seen = measure(given.build.resolve(), given.library.resolve(), Path(folder))
    except private_server.Unavailable as reason:
        print(reason)
        return 1 if os.environ.get("CI") == "true" else SKIPPED
    if given.json:
        figures.write(given.json, "./dev test --long -R storm_tasks_share", begun,
                      {"versions": versions.asked(given.build, "rabbitmq", "zookeeper", "storm")},
                      figures_of(*seen))
    require(seen[1][-1] <= NEW_LIMIT_S, f"a new driver is read within {NEW_LIMIT_S:g} s: {seen[1]}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

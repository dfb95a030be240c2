#!/usr/bin/python3
"""Messages counted while harm is done to a private Storm: a worker is killed, a bolt segfaults, the Supervisor and Nimbus
are killed and started again, a rebalance goes from two workers to one and to four. Each time load generators on a private
RabbitMQ must get back all that they send.

usage: faults_on_storm.py BUILD LIBRARY [--json FILE]
       (BUILD: build/release; LIBRARY: the library of components.cc; FILE: gets the counts as figures)
"""
import argparse
import os
import signal
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "tests" / "servers"))
sys.path.insert(0, str(ROOT / "bench"))
import figures  # noqa: E402
import private_server  # noqa: E402
import storm_jar  # noqa: E402
import versions  # noqa: E402
from echo_on_storm import lines_about_units, storm_program, topology_of  # noqa: E402
from private_cluster import PrivateCluster, require, result_of, wait_for  # noqa: E402
from storm import Storm  # noqa: E402

SKIPPED = 77
DRIVERS = 4
COUNT = 800
RATE = 20
LIMIT_S = 600
# RabbitMQ drops the queue of another channel when nobody has read it for a minute, as while Storm rebalances on a busy machine.
DURABLE = {"channel.data.durable": "true", "channel.echo.durable": "true"}
COUNTED = ("sent", "received", "lost", "duplicated", "damaged")
MORE = """topology.library: {library}
conf: {{out: "{out}"}}
runtime: {{max_spout_pending: 200, message_timeout: 20s}}
engine: {{storm: {{workers: 2, spout_wait: 5ms, bolt_wait: 5ms, back_pressure_wait: 5ms}}}}"""
CRASH = "  crash: {class: test.Crash, inputs: {from: receive}}\n"


class Faults:
    """The topology on a private Storm, and what is done to it."""

    def __init__(self, build, library, folder, cluster, storm):
        self.build, self.folder, self.cluster, self.storm = build, folder, cluster, storm
        self.drivers = 0
        file = folder / "echo.yaml"
        file.write_text(topology_of(cluster, more=MORE.format(library=library, out=folder)) + CRASH)
        print(storm_program(build, storm, "submit", file, "--limit", LIMIT_S), end="", flush=True)

    def has_workers(self, count):
        workers = self.storm.running_workers()
        return workers if len(workers) == count else None

    def wait_for_another(self, before, count):
        """Waits until `count` workers run, not all of which ran before."""
        wait_for("%d workers, with a new one" % count,
                 lambda: (now := self.has_workers(count)) and set(now.values()) != set(before.values()), LIMIT_S)

    def nothing(self):
        pass

    def kill_worker(self):
        before = self.storm.running_workers()
        os.kill(next(iter(before.values())), signal.SIGKILL)
        self.wait_for_another(before, len(before))

    def crash(self):
        before = self.storm.running_workers()
        (self.folder / "crash").touch()
        self.wait_for_another(before, len(before))

    def restart(self, part):
        """Another driver is served while a part is away."""
        self.storm.kill(part)
        report = self.folder / ("report-without-%s.json" % part)
        self.cluster.deploy("loadgen.so", "gateway-1", {"rate": RATE, "count": RATE, "report": report})
        wait_for("messages without %s" % part, lambda: result_of(report), LIMIT_S)
        self.storm.start(part)

    def rebalance(self, count):
        storm_program(self.build, self.storm, "rebalance", "echo", "--workers", count, "--wait", "2")
        wait_for("%d workers" % count, lambda: self.has_workers(count), LIMIT_S)

    def counted(self, harm):
        """The load generators' counts of messages that were under way while harm was done."""
        first, self.drivers = self.drivers, self.drivers + DRIVERS
        reports = [self.folder / ("report-%d.json" % number) for number in range(first, self.drivers)]
        read = len(lines_about_units(self.storm))
        for report in reports:
            self.cluster.deploy("loadgen.so", "gateway-1",
                                {"size": 200, "rate": RATE, "count": COUNT, "report": report, **DURABLE})
        wait_for("the drivers are read", lambda: len(lines_about_units(self.storm)) > read, LIMIT_S)
        require(not any(result_of(report) for report in reports), "messages are under way when the harm is done")
        harm()
        wait_for("all messages are back", lambda: all(result_of(report) for report in reports), LIMIT_S)
        results = [result_of(report) for report in reports]
        self.cluster.undeploy_all()
        return {key: sum(result[key] for result in results) for key in COUNTED}


def figures_of(table):
    """The counts in the form of a benchmark's results."""
    for harm, counts in table.items():
        yield {"name": harm, "value": counts["received"], "unit": "messages", "baseline": "sent", "baseline_value": counts["sent"],
               "ratio": counts["received"] / counts["sent"], "target": "all", "met": counts["received"] == counts["sent"]}
        yield {"name": harm + ": lost", "value": counts["lost"], "unit": "messages", "target": "none", "met": counts["lost"] == 0}
        yield {"name": harm + ": came again", "value": counts["duplicated"], "unit": "messages", "met": None}


def measure(build, library, folder):
    storm = Storm(folder / "storm")
    table = {}
    try:
        with PrivateCluster(folder / "cluster", build / "bin", build / "plugins") as cluster:
            cluster.start(gateways=1)
            storm.start()
            cluster.wait_until_ready()
            faults = Faults(build, library, folder, cluster, storm)
            for name, harm in (("nothing", faults.nothing), ("a worker is killed", faults.kill_worker),
                               ("a bolt segfaults", faults.crash),
                               ("the Supervisor is killed", lambda: faults.restart("supervisor")),
                               ("Nimbus is killed", lambda: faults.restart("nimbus")),
                               ("rebalance from 2 to 1", lambda: faults.rebalance(1)),
                               ("rebalance from 1 to 4", lambda: faults.rebalance(4))):
                table[name] = faults.counted(harm)
                print("%-26s %s" % (name, "  ".join("%s %d" % each for each in table[name].items())), flush=True)
            storm_program(build, storm, "kill", "echo", "--wait", "1")
    finally:
        storm.stop()
    return table


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("build", type=Path)
    parser.add_argument("library", type=Path)
    parser.add_argument("--json", type=Path, help="writes the counts to this file")
    given = parser.parse_args()
    begun = figures.begin(ROOT)
    try:
        storm_jar.build()
        with tempfile.TemporaryDirectory(prefix="iotcloud-storm-") as folder:
            table = measure(given.build.resolve(), given.library.resolve(), Path(folder))
    except private_server.Unavailable as reason:
        print(reason)
        return 1 if os.environ.get("CI") == "true" else SKIPPED
    if given.json:
        figures.write(given.json, "./dev test --long -R storm_under_faults", begun,
                      {"versions": versions.asked(given.build, "rabbitmq", "zookeeper", "storm")},
                      list(figures_of(table)))
    wrong = {name: counts for name, counts in table.items() if counts["received"] != counts["sent"] or counts["damaged"]}
    require(not wrong, "messages are lost or damaged: %s" % wrong)
    return 0


if __name__ == "__main__":
    sys.exit(main())

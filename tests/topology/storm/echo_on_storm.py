#!/usr/bin/python3
"""Spouts and bolts that face brokers, on a private Storm: load generators on a private broker get back all that they
send, through two workers with four spout tasks; a driver that comes later is read, too; messages are counted while a
worker is killed.

usage: echo_on_storm.py BUILD [--broker rabbitmq|kafka|activemq]     (BUILD: build/release)
"""
import argparse
import os
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "tests" / "servers"))
import private_server  # noqa: E402
import storm_jar  # noqa: E402
from private_cluster import PrivateCluster, echo_topology, require, result_of, wait_for  # noqa: E402
from storm import Storm  # noqa: E402

SKIPPED = 77
DRIVERS = 12
COUNT = 1500
RATE = 50
LIMIT_S = 300
MORE = """runtime: {max_spout_pending: 200, message_timeout: 20s}
engine: {storm: {workers: 2, spout_wait: 5ms, bolt_wait: 5ms, back_pressure_wait: 5ms}}"""
# More of a broker in the files of gateways and topology, and of a driver there. Kafka has no exclusive channels.
OF_BROKERS = {"rabbitmq": ("", {}), "activemq": ("", {"broker": "activemq"}),
              "kafka": ("properties: {partitions: 4}", {"broker": "kafka", "shared": "true"})}


def topology_of(cluster, broker="rabbitmq", more=MORE):
    """YAML of the topology, with four spout tasks. A message that was in a lost worker, or on the way to it, costs a try each
    message time-out, so it needs many tries on a busy machine, where a worker takes long to come back."""
    text = echo_topology(4, 2, more, broker).replace("{zookeeper}", cluster.zookeeper.removeprefix("zookeeper://"))
    return text.replace("parallelism: 4}", "parallelism: 4, properties: {maxTries: 1000}}")


def storm_program(build, storm, *words):
    done = subprocess.run([build / "bin" / "iotcloud-storm", *map(str, words), "--nimbus", storm.url()], text=True,
                          capture_output=True, check=False)
    require(done.returncode == 0, "iotcloud-storm %s: %s" % (" ".join(map(str, words)), done.stderr))
    return done.stdout


def lines_about_units(storm):
    """What the workers' logs say of units of channels that were taken or given up."""
    logs = (Path(storm.folder) / "logs" / "workers-artifacts").rglob("worker.log")
    return [line for log in logs for line in log.read_text(errors="replace").splitlines()
            if "receive: units taken" in line]


def deploy(cluster, folder, broker, first, count):
    reports = [folder / ("report-%d.json" % number) for number in range(first, first + count)]
    for report in reports:
        cluster.deploy("loadgen.so", "gateway-1", {"size": 200, "rate": RATE, "count": COUNT, "report": report,
                                                 **OF_BROKERS[broker][1]})
    return reports


def refuse_a_worker_of_ours(build, file):
    """Storm has the topology's name: a worker of ours ends, and says so."""
    done = subprocess.run([build / "bin" / "iotcloud-topology", "--config", file], capture_output=True, text=True,
                          timeout=LIMIT_S, check=False)
    require(done.returncode != 0 and "Apache Storm runs a topology echo already" in done.stderr, "it runs beside Storm's: %s" % done)


def run(build, folder, broker):
    properties = OF_BROKERS[broker][0]
    storm = Storm(folder / "storm")
    try:
        with PrivateCluster(folder / "cluster", build / "bin", build / "plugins") as cluster:
            cluster.start(gateways=1, brokers=[
                f'{broker}: {{type: {broker}, urls: ["{cluster.server(broker)}"], {properties}}}'])
            storm.start()
            cluster.wait_until_ready()
            file = folder / "echo.yaml"
            more = f"{MORE}\nbrokers: {{{broker}: {{{properties}}}}}" if properties else MORE
            file.write_text(topology_of(cluster, broker, more))
            print(storm_program(build, storm, "submit", file), end="")
            reports = deploy(cluster, folder, broker, 0, DRIVERS)
            wait_for("both workers read", lambda: len(lines_about_units(storm)) >= 2, LIMIT_S)
            refuse_a_worker_of_ours(build, file)
            late = deploy(cluster, folder, broker, DRIVERS, 1)
            workers = storm.running_workers()
            require(len(workers) == 2, "two workers run: %s" % workers)
            os.kill(next(iter(workers.values())), signal.SIGKILL)
            read = len(lines_about_units(storm))
            wait_for("the worker that was started again reads", lambda: len(storm.running_workers()) == 2 and
                     len(lines_about_units(storm)) > read + 1, LIMIT_S)
            wait_for("all reports", lambda: all(result_of(report) for report in reports + late), LIMIT_S)
            results = [result_of(report) for report in reports + late]
            total = {key: sum(result[key] for result in results) for key in ("sent", "received", "lost", "duplicated", "damaged")}
            print(total)
            require(total["sent"] == total["received"] == COUNT * (DRIVERS + 1), "nothing is lost: %s" % total)
            require(total["lost"] == total["damaged"] == 0, "nothing is lost or damaged: %s" % total)
            storm_program(build, storm, "kill", "echo", "--wait", "1")
    finally:
        storm.stop()


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("build", type=Path)
    parser.add_argument("--broker", choices=OF_BROKERS, default="rabbitmq")
    given = parser.parse_args()
    try:
        storm_jar.build()
        with tempfile.TemporaryDirectory(prefix="iotcloud-storm-") as folder:
            run(given.build.resolve(), Path(folder), given.broker)
    except private_server.Unavailable as reason:
        print(reason)
        return 1 if os.environ.get("CI") == "true" else SKIPPED
    return 0


if __name__ == "__main__":
    sys.exit(main())

#!/usr/bin/python3
"""Workers share drivers over real servers; one is killed and replaced, another is stopped in order: no message is lost, and
none overtakes another of its driver. On Kafka the drivers of a gateway share a topic of two partitions.

usage: scale_out_test.py BUILD_DIR [--broker kafka] [--drivers N] [--workers N]
"""

import argparse
import shutil
import signal
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "servers"))

from private_cluster import PATIENT_STOP, PrivateCluster, echo_topology, result_of, wait_for  # noqa: E402

COUNT, RATE = 2000, 100
PARTITIONS = 2


def reads_drivers(cluster, worker):
    return " receive: units taken " in cluster.log(worker).read_text()


def all_read(cluster, names):
    return all(reads_drivers(cluster, name) for name in names)


def received(cluster):
    return next(entry["sum"]["emitted"] for entry in cluster.json("topology", "metrics", "echo")["components"]
                if entry["component"] == "receive")


def workers(cluster):
    return [worker for topology in cluster.json("topologies") for worker in topology["workers"]]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("build")
    parser.add_argument("--broker", choices=("rabbitmq", "kafka"), default="rabbitmq")
    parser.add_argument("--drivers", type=int, default=4)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    build, kafka = Path(given.build).resolve(), given.broker == "kafka"
    work = build / ("scale-out-kafka" if kafka else "scale-out")
    shutil.rmtree(work, ignore_errors=True)
    properties = f"properties: {{partitions: {PARTITIONS}}}"
    topology = echo_topology(spouts=2, broker=given.broker, more=f"brokers:\n  kafka: {{{properties}}}" if kafka else "")
    layout = {"broker": "kafka", "shared": "true"} if kafka else {}
    with PrivateCluster(work, build / "bin", build / "plugins") as cluster:
        brokers = [f'kafka: {{type: kafka, urls: ["{cluster.server("kafka")}"], {properties}}}'] if kafka else None
        cluster.start(gateways=2, brokers=brokers)
        names = [f"worker-{number}" for number in range(1, given.workers + 1)]
        victim, leaver = [cluster.topology(name, topology, PATIENT_STOP) for name in names][:2]
        cluster.wait_until_ready()
        wait_for("all workers are listed", lambda: len(workers(cluster)) == given.workers)
        reports = [work / f"report-{number}.json" for number in range(given.drivers)]
        for number, report in enumerate(reports):
            cluster.deploy("loadgen.so", f"gateway-{number % 2 + 1}", {"count": COUNT, "rate": RATE, "report": report, **layout})
        wait_for("all workers read drivers", lambda: all_read(cluster, names))

        wait_for("messages flow", lambda: received(cluster) >= given.drivers * RATE)
        victim.kill()
        victim.wait()
        cluster.children = [entry for entry in cluster.children if entry[1] is not victim]
        cluster.topology("in-its-place", topology)
        wait_for("the worker in its place reads drivers", lambda: reads_drivers(cluster, "in-its-place"))
        begin = time.monotonic()
        leaver.send_signal(signal.SIGTERM)
        if leaver.wait(120) != 0:
            sys.exit(f"the worker that was asked to stop ended with status {leaver.returncode}")
        stopped_in = time.monotonic() - begin
        cluster.children = [entry for entry in cluster.children if entry[1] is not leaver]

        wait_for("all drivers have everything back", lambda: all(map(result_of, reports)), 180)
        cluster.require_alive()
        for report in reports:
            result = result_of(report)
            wrong = {key: result[key] for key in ("lost", "damaged", "foreign", "out_of_order") if result[key]}
            if wrong or result["sent"] != COUNT:
                sys.exit(f"{report.name}: {wrong or result}")
    print(f"{given.workers} workers, {given.drivers} drivers x {COUNT} messages over {given.broker}, all back in order; a worker "
          f"stopped in {stopped_in:.1f} s")


if __name__ == "__main__":
    main()

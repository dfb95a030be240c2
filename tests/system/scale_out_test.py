#!/usr/bin/python3
"""Two workers share four drivers over real servers; one is killed, one is stopped in order: no message is lost. On Kafka the
drivers of a gateway share a topic of two partitions.

usage: scale_out_test.py BUILD_DIR [--broker kafka]
"""

import argparse
import shutil
import signal
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "servers"))

from private_cluster import PrivateCluster, echo_topology, result_of, wait_for  # noqa: E402

COUNT, RATE = 2000, 100
PARTITIONS = 2


def reads_drivers(cluster, worker):
    return " receive: units taken " in cluster.log(worker).read_text()


def workers(cluster):
    return [worker for topology in cluster.json("topologies") for worker in topology["workers"]]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("build")
    parser.add_argument("--broker", choices=("rabbitmq", "kafka"), default="rabbitmq")
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
        victim = cluster.topology("worker-1", topology)
        leaver = cluster.topology("worker-2", topology)
        cluster.wait_until_ready()
        wait_for("two workers are listed", lambda: len(workers(cluster)) == 2, 30)
        reports = [work / f"report-{number}.json" for number in range(4)]
        for number, report in enumerate(reports):
            cluster.deploy("loadgen.so", f"gateway-{number % 2 + 1}", {"count": COUNT, "rate": RATE, "report": report, **layout})
        wait_for("both workers read drivers",
                 lambda: reads_drivers(cluster, "worker-1") and reads_drivers(cluster, "worker-2"), 30)

        time.sleep(2)  # messages flow
        victim.kill()
        victim.wait()
        cluster.children = [entry for entry in cluster.children if entry[1] is not victim]
        time.sleep(2)
        cluster.topology("worker-3", topology)
        wait_for("the third worker reads drivers", lambda: reads_drivers(cluster, "worker-3"), 30)
        begin = time.monotonic()
        leaver.send_signal(signal.SIGTERM)
        if leaver.wait(10) != 0:
            sys.exit(f"the worker that was asked to stop ended with status {leaver.returncode}")
        stopped_in = time.monotonic() - begin
        cluster.children = [entry for entry in cluster.children if entry[1] is not leaver]

        wait_for("all four drivers have everything back", lambda: all(map(result_of, reports)), 90)
        cluster.require_alive()
        for report in reports:
            result = result_of(report)
            wrong = {key: result[key] for key in ("lost", "damaged", "foreign") if result[key]}
            if wrong or result["sent"] != COUNT:
                sys.exit(f"{report.name}: {wrong or result}")
        if stopped_in > 5.5:
            sys.exit(f"the worker took {stopped_in:.1f} s to stop")
    print(f"4 drivers x {COUNT} messages over {given.broker}, all back; a worker stopped in {stopped_in:.1f} s")


if __name__ == "__main__":
    main()

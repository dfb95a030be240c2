#!/usr/bin/python3
"""State in Redis, while workers come and go, are killed (kill -9) and frozen past their session at random, and Redis is
killed and started again: a bolt counts the messages of each driver, and every count must be exact.

usage: state_test.py BUILD_DIR [--seconds N] [--seed N] [--broker kafka] [--json FILE]
       (./dev bench state builds, and runs this file)

On Kafka the drivers of a gateway share topics of four partitions, so that what moves between workers are partitions.

A message that comes again is recognised by its number, of which the bolt keeps a record in the same state
(counting_bolt.cc). Prints the seed; `--seed N` repeats the choices. `./dev bench state` writes the counts as figures
(`./dev bench keep state`).
"""

import argparse
import random
import signal
import socket
import sys
import time
from pathlib import Path

from fault_cluster import PAUSE_S, SESSION_S, FaultCluster, finish, wait_for
from private_server import freeze

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "bench"))

import figures  # noqa: E402
import versions  # noqa: E402

WORKERS, DRIVERS, RATE = 3, 6, 50

BOLT = """
  between:
    class: test.Counting
    parallelism: 2
    conf: {state.store: "%s", state.checkpoint: 200ms}
    inputs: [{from: receive, grouping: fields, fields: [driverID]}]"""


class Store:
    """What the state of a topology's bolt `between` has, as Redis answers."""

    def __init__(self, url, topology="echo"):
        self.address, self.of_bolt = ("127.0.0.1", int(url.rsplit(":", 1)[1])), f"iotcloud:state:1:{topology}:between:"

    def value(self, key):
        words = [b"HGET", (self.of_bolt + key).encode(), b"v"]
        request = b"*%d\r\n" % len(words) + b"".join(b"$%d\r\n%s\r\n" % (len(word), word) for word in words)
        with socket.create_connection(self.address, timeout=60) as connection:
            connection.sendall(request)
            with connection.makefile("rb") as answer:
                size = int(answer.readline()[1:])
                return int(answer.read(size)) if size >= 0 else 0


class Faults:
    def __init__(self, cluster, choose):
        self.cluster, self.choose = cluster, choose
        self.workers = [cluster.worker() for _ in range(WORKERS)]
        self.done = dict.fromkeys(("killed", "stopped", "frozen", "Redis killed"), 0)

    def redis(self, command):
        child = self.cluster.process("redis")
        child.stdin.write(command + "\n")
        child.stdin.flush()
        answer = child.stdout.readline()
        if answer.startswith("ERROR"):
            raise SystemExit(f"redis {command}: {answer}")

    def one(self, kind):
        place = self.choose.randrange(WORKERS)
        victim = self.workers[place]
        if kind == "Redis killed":
            self.redis("kill")
            time.sleep(self.choose.uniform(0, 2))
            self.redis("start")
        elif kind == "frozen":
            process = self.cluster.process(victim)
            freeze(process)
            time.sleep(SESSION_S + self.choose.uniform(0, 2))
            process.send_signal(signal.SIGCONT)
        else:
            if kind == "killed":
                self.cluster.kill(victim)
            else:
                self.cluster.end(victim, signal.SIGTERM)
            time.sleep(self.choose.uniform(0, PAUSE_S))
            self.workers[place] = self.cluster.worker()
        self.done[kind] += 1


def figures_of(faults, sent, counted, again, totals):
    """The counts in the form of a benchmark's results. `counted`: of each driver's instance."""
    for kind, number in faults.done.items():
        yield {"name": f"faults: {kind}", "value": number, "unit": "", "met": None}
    wrong = sum(number != sent for number in counted)
    yield {"name": "counted", "value": sum(counted), "unit": "messages", "baseline": "sent", "baseline_value": sent * len(counted),
           "ratio": sum(counted) / (sent * len(counted)), "target": "all", "met": not wrong}
    yield {"name": f"counts of {len(counted)} drivers that are not exact", "value": wrong, "unit": "", "target": "none",
           "met": not wrong}
    yield {"name": "came again and were recognised", "value": again, "unit": "messages", "met": None}
    yield {"name": "lost on the way back to the driver", "value": totals["lost"], "unit": "messages", "target": "none",
           "met": not totals["lost"]}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("build")
    parser.add_argument("--seconds", type=int, default=20)
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--broker", choices=("rabbitmq", "kafka"), default="rabbitmq")
    parser.add_argument("--json", type=Path, help="writes the counts to this file")
    given = parser.parse_args()
    begun = figures.begin(ROOT)
    choose = random.Random(given.seed)
    print(f"seed {given.seed}", flush=True)
    on_kafka = given.broker == "kafka"
    name = "state-kafka" if on_kafka else "state"
    with FaultCluster(given.build, name, library="counting_bolt.so", broker=given.broker) as cluster:
        url = cluster.server("redis")
        cluster.bolt = BOLT % url
        cluster.start(gateways=2)
        faults = Faults(cluster, choose)
        cluster.wait_until_ready()
        cluster.wait_for_workers(WORKERS)
        count = (given.seconds + 2 * PAUSE_S) * RATE
        cluster.drivers(DRIVERS, count, RATE)
        cluster.wait_until_all_read()
        instances = [driver["instance"] for driver in cluster.json("drivers")]
        begin = time.monotonic()
        kinds = ["killed", "frozen", "Redis killed"]  # each once at least
        while (spent := time.monotonic() - begin) < given.seconds or kinds:
            kind = kinds.pop() if kinds else choose.choice(list(faults.done))
            print(f"after {spent:.0f} of {given.seconds} s: {kind}", flush=True)
            faults.one(kind)
            time.sleep(choose.uniform(1, 4))
        store = Store(url)

        def counts():
            return [store.value("count of " + instance) for instance in instances]

        print("no more faults; waiting until every message is counted", flush=True)
        wait_for("every message is counted", lambda: sum(counts()) >= DRIVERS * count, given.seconds + 180)
        totals = cluster.totals(120)
        found, again = counts(), sum(store.value("again of " + instance) for instance in instances)
        cluster.require_alive()
    print(", ".join(f"{number} x {kind}" for kind, number in faults.done.items()))
    print(f"{DRIVERS} drivers, {count} messages each; counted: {found}; {again} came again and were recognised", flush=True)
    if given.json:
        command = f"./dev bench state --seconds {given.seconds} --seed {given.seed}" + (" --broker kafka" if on_kafka else "")
        figures.write(given.json, command, begun,
                      {"versions": versions.asked(given.build, "redis", given.broker, "zookeeper")},
                      list(figures_of(faults, count, found, again, totals)))
    if found != [count] * DRIVERS:
        raise SystemExit("a count is not exact")
    finish("state in Redis", totals)


if __name__ == "__main__":
    main()

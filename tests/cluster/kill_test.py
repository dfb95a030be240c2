#!/usr/bin/python3
"""Random kill -9 of workers, of the processes that run drivers, and of the ZooKeeper server (its leader, in the long
form), under load. Nothing may be lost, and what a killed worker read is read elsewhere. How long that took is printed, and
judged with --judge.

usage: kill_test.py BUILD_DIR [--seconds N] [--long] [--seed N] [--broker kafka] [--judge]

Killing a driver's process ends that driver's run; the new process counts anew, so that what is reported is the last
run's. Therefore drivers' processes are killed in the first half only.

How long a take-over took comes from the workers' own logs: from the kill to the first message that another worker has of
the driver. Other kills meanwhile begin the wait anew: a worker that dies is named by the registry as a reader for as long
as its session lives, and a ZooKeeper server that starts, or a new leader, gives every session its full time again.
"""

import argparse
import random
import statistics
import time

from fault_cluster import PAUSE_S, FaultCluster, add_judge, finish, judge

WORKERS, DRIVERS, RATE = 3, 6, 100


def take_overs(events, kills, disturbances):
    """(seconds since the last disturbance, of these from the election on, whether the kill was the only one) for each
    driver that a killed worker read. kills: (time, worker)."""
    found = []
    for killed, victim in kills:
        reader = {}
        for event in events:
            if event.what == "reads" and event.time < killed:
                reader[event.unit] = event.worker
        for unit in (each for each, worker in reader.items() if worker == victim):
            later = [event for event in events if event.unit == unit and event.time > killed]
            read = next((event.time for event in later if event.what == "reads"), None)
            if read is None:
                continue  # the driver was done; finish() checks whether all messages came back
            last = max(moment for moment in disturbances if moment <= read)
            elected = max((event.time for event in later if event.what == "leads" and event.time <= read), default=read)
            found.append((read - max(killed, last), read - elected, last <= killed))
    return found


def report(given, found):
    alone = [total for total, _, only in found if only]
    meanwhile = [total for total, _, only in found if not only]
    starts = [start for _, start, _ in found]
    for name, times in (("after the kill alone", alone), ("after the last of several faults", meanwhile),
                        ("of that from the election on", starts)):
        if times:
            print(f"{len(times)} drivers read elsewhere {name}: median {statistics.median(times):.2f} s, longest "
                  f"{max(times):.2f} s", flush=True)
    if not found:
        raise SystemExit("no worker was killed that read a driver: nothing was shown")
    judge(given, "read_elsewhere_s", statistics.median(alone or meanwhile))
    judge(given, "read_after_election_s", max(starts))


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("build")
    parser.add_argument("--seconds", type=int, default=15)
    parser.add_argument("--long", action="store_true", help="three ZooKeeper servers, of which the leader is killed")
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--broker", choices=("rabbitmq", "kafka"), default="rabbitmq")
    add_judge(parser)
    given = parser.parse_args()
    choose = random.Random(given.seed)
    print(f"seed {given.seed}", flush=True)
    registry = "zookeeper_cluster" if given.long else "zookeeper"
    killed = {"worker": 0, "driver host": 0, "ZooKeeper": 0}
    kills, disturbances = [], []
    name = ("kill-long" if given.long else "kill") + ("-kafka" if given.broker == "kafka" else "")
    with FaultCluster(given.build, name, registry, broker=given.broker) as cluster:
        # The test kills hosts more often, and faster, than a gateway by default restarts hosts that fail.
        cluster.start(gateways=2, more="host_restart: {longest: 1s, give_up_after: 0}")
        workers = [cluster.worker() for _ in range(WORKERS)]
        cluster.wait_until_ready()
        cluster.wait_for_workers(WORKERS)
        cluster.drivers(DRIVERS, (given.seconds + 2 * PAUSE_S) * RATE, RATE)
        cluster.wait_until_all_read()
        begin = time.monotonic()
        kinds = ["worker"]  # first only workers
        while (passed := time.monotonic() - begin) < given.seconds:
            kind = choose.choice(kinds)
            if kind == "worker":
                victim = choose.choice(workers)
                cluster.kill(victim)
                kills.append((time.time(), victim))
                disturbances.append(kills[-1][0])
                workers[workers.index(victim)] = cluster.worker()
            elif kind == "ZooKeeper":
                cluster.order("kill leader" if given.long else "kill")
                time.sleep(choose.uniform(0, 1))
                cluster.order("start")
            elif not cluster.kill_drivers():
                continue
            killed[kind] += 1
            pause = PAUSE_S if len(kinds) == 1 else choose.uniform(0.5, 3)
            if kind != "worker":
                disturbances.append(time.time())
            time.sleep(pause)
            kinds = ["worker", "worker", "ZooKeeper"] + (["driver host"] if passed < given.seconds / 2 else [])
        totals = cluster.totals(given.seconds + 90)
        cluster.require_alive()
        events = cluster.timeline()
    print("killed: " + ", ".join(f"{count} x {kind}" for kind, count in killed.items()))
    finish("random kill -9", totals)
    report(given, take_overs(events, kills, disturbances))


if __name__ == "__main__":
    main()

#!/usr/bin/python3
"""Random kill -9 of workers, of the processes that run drivers, and of the ZooKeeper server (its leader, in the long
form), under load.

usage: kill_test.py BUILD_DIR [--seconds N] [--long] [--seed N]

Killing a driver's process ends that driver's run; the new process counts anew, so that what is reported is the last
run's. Therefore drivers' processes are killed in the first half only.
"""

import argparse
import random
import time

from fault_cluster import FaultCluster, finish

WORKERS, DRIVERS, RATE = 3, 6, 100


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("build")
    parser.add_argument("--seconds", type=int, default=12)
    parser.add_argument("--long", action="store_true", help="three ZooKeeper servers, of which the leader is killed")
    parser.add_argument("--seed", type=int, default=int(time.time()))
    given = parser.parse_args()
    choose = random.Random(given.seed)
    registry = "zookeeper_cluster" if given.long else "zookeeper"
    killed = {"worker": 0, "driver host": 0, "ZooKeeper": 0}
    with FaultCluster(given.build, "kill-long" if given.long else "kill", registry) as cluster:
        cluster.start(gateways=2)
        workers = [cluster.worker() for _ in range(WORKERS)]
        cluster.wait_until_ready()
        cluster.drivers(DRIVERS, given.seconds * RATE, RATE)
        cluster.wait_until_all_read()
        begin = time.monotonic()
        while (passed := time.monotonic() - begin) < given.seconds:
            kinds = ["worker", "worker", "ZooKeeper"] + (["driver host"] if passed < given.seconds / 2 else [])
            kind = choose.choice(kinds)
            if kind == "worker":
                victim = choose.choice(workers)
                cluster.kill(victim)
                workers[workers.index(victim)] = cluster.worker()
            elif kind == "ZooKeeper":
                cluster.order("kill leader" if given.long else "kill")
                time.sleep(choose.uniform(0, 1))
                cluster.order("start")
            elif not cluster.kill_drivers():
                continue
            killed[kind] += 1
            time.sleep(choose.uniform(0.5, 3))
        totals = cluster.totals(given.seconds + 60)
        cluster.require_alive()
    print(f"seed {given.seed}; killed: " + ", ".join(f"{count} x {kind}" for kind, count in killed.items()))
    finish("random kill -9", totals)


if __name__ == "__main__":
    main()

#!/usr/bin/python3
"""The way between one of two workers and ZooKeeper is cut for longer than its session lives; the broker stays. The worker
reads on, since the broker keeps a second reader out, so that no message waits for the session; when the way is back its
drivers are shared again.

usage: cut_test.py BUILD_DIR [--rounds N]
"""

import argparse
import time

from fault_cluster import GRACE_S, SESSION_S, FaultCluster, finish
from silent_way import SilentWay

DRIVERS, RATE, CUT_S, PAUSE_S = 4, 100, SESSION_S + GRACE_S + 1, 4


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("build")
    parser.add_argument("--rounds", type=int, default=1)
    given = parser.parse_args()
    with FaultCluster(given.build, "cut") as cluster:
        cluster.start(gateways=1)
        way = SilentWay(cluster.zookeeper.removeprefix("zookeeper://"))
        cluster.worker(way.address)
        other = cluster.worker()
        cluster.wait_until_ready()
        cluster.drivers(DRIVERS, (given.rounds * (CUT_S + PAUSE_S) + 2) * RATE, RATE)
        cluster.wait_until_all_read()
        for _ in range(given.rounds):
            time.sleep(PAUSE_S / 2)
            before = cluster.readers()[other]
            way.cut()
            time.sleep(CUT_S)
            if cluster.readers()[other] == before:
                raise SystemExit(f"{other} was not elected within {CUT_S} s")
            way.mend()
            time.sleep(PAUSE_S / 2)
        totals = cluster.totals(60)
        cluster.require_alive()
    finish("cut off from ZooKeeper", totals)
    if totals["max_s"] > SESSION_S + GRACE_S:
        raise SystemExit(f"a message took {totals['max_s']:.1f} s; {SESSION_S + GRACE_S} s are allowed")


if __name__ == "__main__":
    main()

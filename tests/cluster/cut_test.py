#!/usr/bin/python3
"""One of two workers stands in a network of its own, and its packets to and from ZooKeeper vanish for longer than its
session lives; the broker stays in reach. The worker reads its drivers on, since the broker keeps the other one out, which
is elected meanwhile. When the way is back it comes with a new session, and the drivers are shared evenly again. The longest
round trip is printed, and judged with --judge: the broker was there all the time.

usage: cut_test.py BUILD_DIR [--rounds N] [--judge]
"""

import argparse
import time

from fault_cluster import SESSION_S, FaultCluster, add_judge, finish, judge, wait_for
from network_spaces import Isle, in_own_network

DRIVERS, RATE = 4, 100
ROUND_S = 30  # the drivers send for so long in each round
SPARE_S = 20  # and so much longer in all: the last round takes longer on a busy machine


def cut_and_mend(cluster, isle, cut_off, other):
    port = cluster.zookeeper.rsplit(":", 1)[1]
    renewed = cluster.said(cut_off, "has dropped the session")
    elected = cluster.readers()[other]
    own = cluster.channels(cut_off)
    isle.cut(port)
    cut = time.monotonic()
    wait_for(f"{other} is elected for the drivers of {cut_off}", lambda: cluster.readers()[other] >= elected + own)
    took = time.monotonic() - cut
    # The other one may read now, as far as the registry knows. For a whole session more nothing changes.
    others_before, before = cluster.received(other), cluster.received(cut_off)
    read = own * RATE * SESSION_S
    wait_for(f"{cut_off} reads {read:.0f} messages without ZooKeeper",
             lambda: cluster.received(cut_off) >= before + read)
    elsewhere = cluster.received(other) - others_before
    passed = time.monotonic() - cut
    isle.mend()
    wait_for(f"{cut_off} has a new session", lambda: cluster.said(cut_off, "has dropped the session") > renewed)
    wait_for("the drivers are shared evenly", lambda: cluster.channels(cut_off) == cluster.channels(other) == own)
    for worker in (cut_off, other):
        start = cluster.received(worker)
        wait_for(f"{worker} reads its share", lambda: cluster.received(worker) > start + own * RATE / 2)
    print(f"cut for {passed:.1f} s: the other worker was elected after {took:.1f} s; from then on {read:.0f} messages were "
          f"read by the worker that is cut off, {elsewhere:.0f} of its own drivers by the other one", flush=True)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("build")
    parser.add_argument("--rounds", type=int, default=1)
    add_judge(parser)
    given = parser.parse_args()
    in_own_network("cut_test.py")
    with Isle() as isle, FaultCluster(given.build, "cut", guarded=True) as cluster:
        cluster.start(gateways=1)
        cut_off, other = cluster.worker(isle), cluster.worker()
        cluster.wait_until_ready()
        cluster.wait_for_workers(2)
        seconds = given.rounds * ROUND_S + SPARE_S
        cluster.drivers(DRIVERS, seconds * RATE, RATE)
        wait_for("both read two drivers", lambda: [cluster.channels(each) for each in (cut_off, other)] == [2, 2])
        for _ in range(given.rounds):
            cut_and_mend(cluster, isle, cut_off, other)
        totals = cluster.totals(seconds + 60)
        cluster.require_alive()
    finish("cut off from ZooKeeper", totals)
    judge(given, "without_zookeeper_s", totals["max_s"])


if __name__ == "__main__":
    main()

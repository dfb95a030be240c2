#!/usr/bin/python3
"""A worker frozen past its session's time-out, and continued: its drivers go to others, which start only after the broker
cut it off, and it comes back as one of several.

usage: freeze_test.py BUILD_DIR [--rounds N]
"""

import argparse
import signal
import time

from fault_cluster import GRACE_S, SESSION_S, FaultCluster, finish

DRIVERS, RATE, FROZEN_S = 4, 100, SESSION_S + GRACE_S + 2


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("build")
    parser.add_argument("--rounds", type=int, default=1)
    given = parser.parse_args()
    with FaultCluster(given.build, "freeze") as cluster:
        cluster.start(gateways=1)
        workers = [cluster.worker() for _ in range(2)]
        cluster.wait_until_ready()
        cluster.drivers(DRIVERS, (given.rounds * (FROZEN_S + 4) + 2) * RATE, RATE)
        cluster.wait_until_all_read()
        for round_number in range(given.rounds):
            victim, other = workers[round_number % 2], workers[1 - round_number % 2]
            time.sleep(2)
            before = cluster.readers()[other]
            cluster.process(victim).send_signal(signal.SIGSTOP)
            time.sleep(FROZEN_S)
            taken = cluster.readers()[other] - before
            cluster.process(victim).send_signal(signal.SIGCONT)
            if not taken:
                raise SystemExit(f"{other} took over nothing within {FROZEN_S} s")
            time.sleep(2)
        totals = cluster.totals(60)
        cluster.require_alive()
    finish("frozen and continued", totals)
    if totals["max_s"] > SESSION_S + GRACE_S:
        raise SystemExit(f"a message took {totals['max_s']:.1f} s; {SESSION_S + GRACE_S} s are allowed")


if __name__ == "__main__":
    main()

#!/usr/bin/python3
"""A worker frozen (SIGSTOP) past its session's time-out, and continued (SIGCONT). The events' own times must show that
the broker cut it off before anybody else read its drivers. What it had in hand (each driver's last message, in a bolt that
holds it) went to its successor, so it must not be sent when the worker goes on.

usage: freeze_test.py BUILD_DIR [--rounds N]
"""

import argparse
import datetime
import re
import signal
import subprocess
import time

from fault_cluster import LIMIT_S, SESSION_S, FaultCluster, finish, wait_for
from private_server import freeze as freeze_process

DRIVERS, RATE = 4, 100
ROUND_S = 25  # the drivers send for so long in each round, and at least until it is over

CUT = re.compile(r"^(\S+ \S+) \[error\] <\S+> closing AMQP connection <\S+> \(127\.0\.0\.1:(\d+) ")


def ports(process):
    """The local ports of a process's TCP connections."""
    lines = subprocess.run(["ss", "-Htnp"], capture_output=True, text=True, check=True).stdout.splitlines()
    return {int(line.split()[3].rsplit(":", 1)[1]) for line in lines if f"pid={process}," in line}


def cuts(cluster, of_ports, since):
    """When the broker closed those consuming connections because heartbeats were missing."""
    times, candidate = [], None
    for line in (cluster.work / "rabbitmq/log/rabbit.log").read_text(errors="replace").splitlines():
        if "iotcloud consuming" in line and (found := CUT.match(line)) and int(found[2]) in of_ports:
            candidate = datetime.datetime.fromisoformat(found[1]).timestamp()
        elif candidate and "missed heartbeats" in line:
            times.append(candidate)
            candidate = None
    return [moment for moment in times if moment >= since]


def kept(cluster, worker):
    return cluster.metric(worker, "iotcloud_bolt_lost_total", 'reason="fenced"')


def freeze(cluster, victim, other):
    """Runs one round; returns how many commands the victim held back."""
    process = cluster.process(victim)
    own = {}
    for event in cluster.timeline():
        if event.what == "reads":
            own[event.instance] = event.worker
    own = {instance for instance, worker in own.items() if worker == victim}
    connections, kept_back = ports(process.pid), kept(cluster, victim)
    freeze_process(process)
    frozen = time.time()

    def taken_over():
        return {event.instance: event.time for event in reversed(cluster.timeline([other]))
                if event.what == "reads" and event.time > frozen and event.instance in own}

    wait_for(f"{other} reads the drivers of {victim}", lambda: set(taken_over()) == own, 60)
    first = min(taken_over().values())
    cut = cuts(cluster, connections, frozen)
    if not cut or max(cut) > first:
        raise SystemExit(f"{other} read a driver of {victim} before the broker had cut that one off")
    while time.time() < frozen + SESSION_S + 1:  # the successor is far beyond the frozen worker's messages
        time.sleep(0.1)
    process.send_signal(signal.SIGCONT)
    wait_for(f"{victim} keeps back what it has in hand",
             lambda: kept(cluster, victim) >= kept_back + len(own), 30)
    wait_for("the drivers are shared again",
             lambda: cluster.channels(victim) == cluster.channels(other) == DRIVERS / 2, 30)
    for worker in (victim, other):
        before = cluster.received(worker)
        wait_for(f"{worker} reads its share", lambda: cluster.received(worker) > before + RATE, 30)
    kept_back = kept(cluster, victim) - kept_back
    print(f"frozen with {len(own)} drivers: cut off by the broker after {max(cut) - frozen:.2f} s, read elsewhere after "
          f"{first - frozen:.2f} s; continued: {kept_back:.0f} messages in hand were not sent", flush=True)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("build")
    parser.add_argument("--rounds", type=int, default=1)
    given = parser.parse_args()
    with FaultCluster(given.build, "freeze", holding=True) as cluster:
        cluster.start(gateways=1)
        workers = [cluster.worker() for _ in range(2)]
        cluster.wait_until_ready()
        cluster.wait_for_workers(2)
        cluster.drivers(DRIVERS, given.rounds * ROUND_S * RATE, RATE)
        wait_for("both read two drivers", lambda: [cluster.channels(each) for each in workers] == [2, 2], 30)
        for worker in workers:
            wait_for(f"{worker} reads", lambda: cluster.received(worker) > RATE, 30)
        for number in range(given.rounds):
            freeze(cluster, workers[number % 2], workers[1 - number % 2])
        totals = cluster.totals(given.rounds * ROUND_S + 60)
        cluster.require_alive()
    finish("frozen and continued", totals)
    if totals["furthest_back"] >= RATE * SESSION_S:
        raise SystemExit(f"a message came {totals['furthest_back']} numbers late: it was sent by the worker that was frozen")
    if totals["max_s"] > LIMIT_S:
        raise SystemExit(f"a message took {totals['max_s']:.1f} s; {LIMIT_S} s are allowed")


if __name__ == "__main__":
    main()

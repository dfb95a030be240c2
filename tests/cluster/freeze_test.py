#!/usr/bin/python3
"""A worker frozen (SIGSTOP) past its session's time-out, and continued (SIGCONT). The events' own times must show that
the broker cut it off before anybody else read its drivers. What it had in hand (each driver's last message, in a bolt that
holds it) went to its successor, so it must not be sent when the worker goes on. It goes on when its successor has caught up.
How long its drivers were read by nobody is printed, and judged with --judge. The longest round trip is only printed: it has in it
how long a busy successor takes to catch up, and how long the drivers wait again while they are given back.

usage: freeze_test.py BUILD_DIR [--rounds N] [--broker kafka] [--judge]
"""

import argparse
import datetime
import os
import re
import signal
import subprocess
import time

from fault_cluster import HOLD, PARTITIONS, SESSION_S, FaultCluster, add_judge, finish, judge, result_of, wait_for
from private_server import freeze as freeze_process
from slowness import Slowness

DRIVERS, RATE = {"rabbitmq": 4, "kafka": 16}, {"rabbitmq": 100, "kafka": 25}
HELD_S = 0.4  # the bolt holds a tuple for 0.5 s at least: until the second of its ticks
ROUND_S = {"rabbitmq": 25, "kafka": 35}  # the drivers send for so long in each round, and at least until it is over

CUT = re.compile(r"^(\S+ \S+) \[error\] <\S+> closing AMQP connection <\S+> \(127\.0\.0\.1:(\d+) ")
OUT_OF_GROUP = re.compile(r"^(\S+ \S+) .*Member \S+ in group (echo\S*) has failed, removing it from the group")


def removals(cluster, since):
    """When Kafka removed a member that gave no sign of life from each consumer group."""
    times = {}
    for line in (cluster.work / "kafka/server.log").read_text(errors="replace").splitlines():
        if found := OUT_OF_GROUP.match(line):
            moment = datetime.datetime.fromisoformat(found[1]).timestamp()
            if moment >= since:
                times.setdefault(found[2], moment)
    return times


def cut_off_late(cluster, connections, frozen, taken_over):
    """The last time at which the broker cut the frozen worker off. Ends the test if another worker read before."""
    if cluster.broker == "kafka":
        cut = removals(cluster, frozen)
        groups = {unit: "echo" + unit[unit.find("#"):] if "#" in unit else "echo" for unit in taken_over}
        early = [unit for unit, read in taken_over.items() if cut.get(groups[unit], read) >= read]
        times = list(cut.values())
    else:
        times = cuts(cluster, connections, frozen)
        early = not times or max(times) > min(taken_over.values())
    if early:
        raise SystemExit("a driver of the frozen worker was read before the broker had cut that one off")
    return max(times)


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


def wait_until_fresh(cluster, worker):
    """Waits until the worker has read its half for two seconds, in the last of which no message came late, or all messages are back.
    Of one that is frozen with a backlog, the successor sends again what it had sent and not settled: numbers nearly as late as
    those looked for."""
    until = cluster.received(worker) + RATE[cluster.broker] * DRIVERS[cluster.broker]
    wait_for(f"{worker} has caught up", lambda: all(map(result_of, cluster.reports)) or (
        cluster.received(worker) >= until and cluster.metric(worker, "iotcloud_spout_arrival_age_seconds") < 1))


def on_its_way(cluster, worker):
    """How many messages the worker has sent of which it does not know yet what became. They are counted last, so none is on its way
    if that is 0."""
    known = cluster.metric(worker, "iotcloud_broker_outcomes_total", 'outcome="confirmed"') + cluster.lost(worker)
    return cluster.metric(worker, "iotcloud_task_executed_total", 'component="send"') - known


def freeze_with_nothing_on_its_way(cluster, worker):
    """Freezes the worker when the broker has all that it sent: what is on its way arrives when it goes on, because nobody can
    take it back (brokers/kafka/README.md). So the drivers' processes stand still meanwhile, for a shorter time than that for
    which the worker's bolt holds what it has in hand. If that is too short, as on a busy machine, it is tried again."""
    def frozen():
        hosts = [host for gateway in range(1, cluster.gateways + 1) for host in cluster.hosts_of(f"gateway-{gateway}")]
        try:
            for host in hosts:
                os.kill(host, signal.SIGSTOP)
            deadline, before = time.monotonic() + HELD_S, None
            while time.monotonic() < deadline:
                now = cluster.received(worker)
                if on_its_way(cluster, worker) == 0 and now == before and time.monotonic() < deadline:
                    freeze_process(cluster.process(worker))
                    return True
                before = now
                time.sleep(0.02)
            return False
        finally:
            for host in hosts:
                os.kill(host, signal.SIGCONT)

    wait_for(f"nothing that {worker} sent is on its way", frozen)


def freeze(cluster, victim, other):
    """Runs one round; returns from when to when some driver of the victim was read by nobody."""
    process = cluster.process(victim)
    own = {unit for unit, worker in cluster.reading().items() if worker == victim}
    connections, kept_back = ports(process.pid), kept(cluster, victim)
    freeze_with_nothing_on_its_way(cluster, victim)
    frozen, began = time.time(), time.monotonic()  # the timeline has the time of day
    received = cluster.received(other)

    def taken_over():
        return {event.unit: event.time for event in reversed(cluster.timeline([other]))
                if event.what == "reads" and event.time > frozen and event.unit in own}

    wait_for(f"{other} reads the drivers of {victim}", lambda: set(taken_over()) == own)
    first, last = min(taken_over().values()), max(taken_over().values())
    cut = cut_off_late(cluster, connections, frozen, taken_over())

    def caught_up():
        """Whether the successor, which reads all drivers, is far beyond the frozen worker's messages."""
        passed = time.monotonic() - began
        sent = (passed - 1) * RATE[cluster.broker] * DRIVERS[cluster.broker]  # but for what is on its way
        return passed > SESSION_S + 2 and (cluster.received(other) - received >= sent or all(map(result_of, cluster.reports)))

    wait_for(f"{other} has caught up", caught_up)
    process.send_signal(signal.SIGCONT)
    wait_for(f"{victim} keeps back what it has in hand",
             lambda: kept(cluster, victim) >= kept_back + len(own))
    wait_for("the drivers are shared again",
             lambda: cluster.channels(victim) == cluster.channels(other) == units(cluster) / 2)
    for worker in (victim, other):
        wait_until_fresh(cluster, worker)
    kept_back = kept(cluster, victim) - kept_back
    print(f"frozen with {len(own)} units: cut off by the broker after {cut - frozen:.2f} s, read elsewhere after "
          f"{first - frozen:.2f} s to {last - frozen:.2f} s; continued: {kept_back:.0f} messages in hand were not sent", flush=True)
    return frozen, last


def units(cluster):
    return PARTITIONS if cluster.broker == "kafka" else DRIVERS["rabbitmq"]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("build")
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--broker", choices=("rabbitmq", "kafka"), default="rabbitmq")
    add_judge(parser)
    given = parser.parse_args()
    drivers, rate = DRIVERS[given.broker], RATE[given.broker]
    name = "freeze-kafka" if given.broker == "kafka" else "freeze"
    slowness, spans = Slowness(), []
    with slowness, FaultCluster(given.build, name, library="holding_bolt.so", bolt=HOLD, broker=given.broker) as cluster:
        cluster.start(gateways=1)
        workers = [cluster.worker() for _ in range(2)]
        cluster.wait_until_ready()
        cluster.wait_for_workers(2)
        cluster.drivers(drivers, given.rounds * ROUND_S[given.broker] * rate, rate)
        wait_for("both read two units", lambda: [cluster.channels(each) for each in workers] == [2, 2])
        for worker in workers:
            wait_until_fresh(cluster, worker)
        for number in range(given.rounds):
            spans.append(freeze(cluster, workers[number % 2], workers[1 - number % 2]))
        totals = cluster.totals(given.rounds * ROUND_S[given.broker] + 60)
        cluster.require_alive()
    finish("frozen and continued", totals)
    if totals["furthest_back"] >= rate * SESSION_S:
        raise SystemExit(f"a message came {totals['furthest_back']} numbers late: it was sent by the worker that was frozen")
    judge(given, "frozen_worker_s", max(slowness.without(*span, idle=SESSION_S) for span in spans))


if __name__ == "__main__":
    main()

#!/usr/bin/python3
"""Random kill -9 of workers, of the processes that run drivers, and of the ZooKeeper server (its leader, in the long
form), under load. Nothing may be lost, and what a killed worker read is read elsewhere. How long that took is printed, and
judged with --judge.

usage: kill_test.py BUILD_DIR [--seconds N | --once] [--long] [--seed N] [--broker kafka] [--judge]

With --once, on Kafka, only one of two workers is killed, and it is said who read what.

The first to be killed is a worker that reads: of the order that the seed gives, the first to which messages come (a worker may
have partitions that no driver's messages are in). Nothing else is killed before others read what it read.

Killing a driver's process ends that driver's run; the new process counts anew, so that what is reported is the last
run's. Therefore drivers' processes are killed in the first half only.

How long a take-over took comes from the workers' own logs: from the kill to the first message that another worker has of
the driver. Other kills meanwhile begin the wait anew: a worker that dies is named by the registry as a reader for as long
as its session lives, and a ZooKeeper server that starts, or a new leader, gives every session its full time again.
"""

import argparse
import collections
import random
import statistics
import time

from fault_cluster import PARTITIONS, PAUSE_S, SESSION_S, FaultCluster, add_judge, finish, judge, result_of, wait_for
from slowness import Slowness

WORKERS, DRIVERS, RATE = 3, 6, 100

# When a driver that a killed worker had read lost its reader (by the last disturbance), when another worker was elected for it,
# when that one read it, and whether the kill was the only disturbance.
TakeOver = collections.namedtuple("TakeOver", "lost elected read alone")


def take_overs(events, kills, disturbances):
    """Those of all killed workers. kills: (time, worker)."""
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
            found.append(TakeOver(max(killed, last), elected, read, last <= killed))
    return found


def report(given, slowness, found):
    alone = [(each.lost, each.read) for each in found if each.alone]
    meanwhile = [(each.lost, each.read) for each in found if not each.alone]
    starts = [(each.elected, each.read) for each in found]
    for name, spans in (("after the kill alone", alone), ("after the last of several faults", meanwhile),
                        ("of that from the election on", starts)):
        if spans:
            times = [end - begin for begin, end in spans]
            print(f"{len(times)} drivers read elsewhere {name}: median {statistics.median(times):.2f} s, longest "
                  f"{max(times):.2f} s", flush=True)
    judge(given, "read_elsewhere_s", statistics.median(slowness.without(*span, idle=SESSION_S) for span in alone or meanwhile))
    judge(given, "read_after_election_s", max(slowness.without(*span) for span in starts))


def first_victim(cluster, workers, choose, messages=DRIVERS * RATE):
    """A worker that reads: the death of another one would show nothing."""
    order = choose.sample(workers, len(workers))
    wait_for(f"the workers have read {messages:.0f} messages",
             lambda: cluster.reading() and sum(map(cluster.received, workers)) >= messages)
    read = cluster.reading().values()
    return next(worker for worker in order if worker in read)


def kill_one(given, choose):
    """Kills one of two workers once, on Kafka. On a busy machine the drivers of a partition may have sent everything before the kill, so
    that nothing is left by which it is seen to be read elsewhere. Then other drivers send, until some of them is in that partition."""
    drivers, rate = 8, 50
    with FaultCluster(given.build, f"kill-once-{given.broker}", broker=given.broker) as cluster:
        cluster.start(gateways=1)
        workers = [cluster.worker() for _ in range(2)]
        cluster.wait_until_ready()
        cluster.wait_for_workers(2)
        cluster.drivers(drivers, PAUSE_S * rate, rate)
        wait_for("both workers have half of the partitions",
                 lambda: [cluster.channels(each) for each in workers] == [PARTITIONS / 2] * 2)
        victim = first_victim(cluster, workers, choose, drivers * rate / 2)
        other, = set(workers) - {victim}
        before = cluster.reading()
        cluster.kill(victim)
        killed = time.time()
        wait_for(f"{other} has all partitions", lambda: cluster.channels(other) == PARTITIONS)

        def taken_over():
            after = cluster.reading()
            if all(after[unit] == other for unit in before):
                return True
            if all(map(result_of, cluster.reports)):
                cluster.drivers(1, rate, rate)
            return False

        wait_for(f"{other} gets a message of each partition that {victim} had read", taken_over)
        totals = cluster.totals(120)
        cluster.require_alive()
        after, events = cluster.reading(), cluster.timeline()
    for unit, worker in sorted(before.items()):
        print(f"{unit}: read by {worker}, after the death of {victim} by {after[unit]}")
    finish("kill -9 of one worker", totals)
    print(f"{len(take_overs(events, [(killed, victim)], [killed]))} partitions read elsewhere")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("build")
    parser.add_argument("--seconds", type=int, default=15)
    parser.add_argument("--once", action="store_true", help="kill one worker of two once, and nothing else; with --broker kafka")
    parser.add_argument("--long", action="store_true", help="three ZooKeeper servers, of which the leader is killed")
    parser.add_argument("--seed", type=int, default=int(time.time()))
    parser.add_argument("--broker", choices=("rabbitmq", "kafka"), default="rabbitmq")
    add_judge(parser)
    given = parser.parse_args()
    if given.once and given.broker != "kafka":
        parser.error("--once needs --broker kafka: with RabbitMQ a driver that has sent everything leaves nothing to read elsewhere")
    choose = random.Random(given.seed)
    print(f"seed {given.seed}", flush=True)
    if given.once:
        return kill_one(given, choose)
    registry = "zookeeper_cluster" if given.long else "zookeeper"
    killed = {"driver host": 0, "ZooKeeper": 0}
    kills, disturbances = [], []
    name = ("kill-long" if given.long else "kill") + ("-kafka" if given.broker == "kafka" else "")
    slowness = Slowness()
    with slowness, FaultCluster(given.build, name, registry, broker=given.broker) as cluster:
        # The test kills hosts more often, and faster, than a gateway by default restarts hosts that fail.
        cluster.start(gateways=2, more="host_restart: {longest: 1s, give_up_after: 0}")
        workers = [cluster.worker() for _ in range(WORKERS)]
        cluster.wait_until_ready()
        cluster.wait_for_workers(WORKERS)
        cluster.drivers(DRIVERS, (given.seconds + 2 * PAUSE_S) * RATE, RATE)
        cluster.wait_until_all_read()

        def kill(victim):
            cluster.kill(victim)
            kills.append((time.time(), victim))
            disturbances.append(kills[-1][0])
            workers[workers.index(victim)] = cluster.worker()

        begin = time.monotonic()
        kill(first_victim(cluster, workers, choose))
        time.sleep(PAUSE_S)
        wait_for("what the killed worker read is read elsewhere",
                 lambda: take_overs(cluster.timeline(), kills, disturbances))
        while (passed := time.monotonic() - begin) < given.seconds:
            kind = choose.choice(["worker", "worker", "ZooKeeper"] + ["driver host"] * (passed < given.seconds / 2))
            if kind == "worker":
                kill(choose.choice(workers))
            elif kind == "ZooKeeper":
                cluster.order("kill leader" if given.long else "kill")
                time.sleep(choose.uniform(0, 1))
                cluster.order("start")
            elif not cluster.kill_drivers():
                continue
            if kind != "worker":
                killed[kind] += 1
                disturbances.append(time.time())
            time.sleep(choose.uniform(0.5, 3))
        totals = cluster.totals(given.seconds + 90)
        cluster.require_alive()
        events = cluster.timeline()
    print("killed: " + ", ".join(f"{count} x {kind}" for kind, count in {"worker": len(kills), **killed}.items()))
    finish("random kill -9", totals)
    report(given, slowness, take_overs(events, kills, disturbances))


if __name__ == "__main__":
    main()

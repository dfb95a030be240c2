#!/usr/bin/python3
"""Three masters, of which the leader is killed (kill -9), or frozen past its session's time-out (SIGSTOP) and continued,
again and again, while orders are given through the CLI and load generators run through a topology.

usage: leaders_test.py BUILD_DIR [--kills N] [--stops N] [--seed N] [--judge]

Checked: that another one leads; that the orders of a leader that was frozen, given to it before it knew better, are followed
by nobody and stand nowhere; that the CLI, which is told of all masters, finds the one that leads by itself; and that the data
plane loses no message. Printed, and judged with --judge: how long until another one leads, and the longest round trip of the
data plane.
"""

import argparse
import json
import random
import signal
import statistics
import threading
import time

from fault_cluster import (PAUSE_S, SESSION_S, FaultCluster, StartError, add_judge, finish, judge, sentence,
                           wait_for)
from master_api import MasterApi, compile_idl
from private_server import freeze

DRIVERS, RATE = 4, 100
KILL_S, STOP_S = PAUSE_S + 2, PAUSE_S + 6  # how long the drivers send for each fault
LEADERLESS_S = 120  # how long the test waits for the next leader
ORDER_S = 60  # how long the CLI waits for an order's outcome
GATEWAYS_SESSION_S = 30  # a gateway that gets no CPU for a while is no gateway that was lost with a master
STALE = 5  # orders to each frozen leader


class Orders(threading.Thread):
    """Deploys on both gateways, stops, starts and undeploys there, one order after the other, until the block ends. An
    order that is under way when its master freezes is waited for until that goes on."""

    def __init__(self, cluster):
        super().__init__()
        self.cluster, self.over = cluster, threading.Event()
        self.done = 0
        self.failed = []  # the CLI's error texts
        self.looks, self.not_ready = 0, 0  # checks of the gateways

    def __enter__(self):
        self.start()
        return self

    def __exit__(self, *_):
        self.over.set()
        self.join()

    def order(self, *words):
        """The CLI's answer; None when the order failed or its outcome is unknown."""
        try:
            answer = self.cluster.cli(*words, "--wait", ORDER_S, "-o", "json")
        except StartError as error:
            self.failed.append(str(error))
            return None
        self.done += 1
        return json.loads(answer)

    def deploy(self):
        """The ids of the instances deployed on both gateways; empty when unknown."""
        deployed = self.order("deploy", "loadgen.so", "--all", "--property", "rate=1", "--metadata", "purpose=orders")
        return [outcome["instance"] for outcome in deployed["outcomes"]] if deployed else []

    def run(self):
        while not self.over.is_set():
            instances = self.deploy()
            for verb in ("stop", "start", "undeploy") if instances else ():
                self.order(verb, *instances)
            try:
                states = [gateway["state"] for gateway in json.loads(self.cluster.cli("gateways", "-o", "json"))]
                self.looks += 1
                self.not_ready += states != ["ready"] * self.cluster.gateways
            except StartError:
                continue  # the master that it asked died

    def follow(self):
        """A new command must find the new leader at once. Its order tells the gateways the new epoch."""
        instances = self.deploy()
        if not instances:
            raise SystemExit(f"an order to the new leader was not done: {self.failed[-1]}")
        self.order("undeploy", *instances)


class Masters(FaultCluster):
    def status_of(self, name):
        """Returns None when the master does not answer. Do not ask one that is frozen: it holds the connection."""
        from thrift.Thrift import TException

        try:
            api = MasterApi(self.apis[name])
            try:
                return api.status()
            finally:
                api.close()
        except (TException, OSError):
            return None

    def leader(self, among=None, above=0):
        """(name, epoch) of the master that claims to lead; None when none does."""
        for name in among or self.apis:
            status = self.status_of(name)
            if status and status.leading and status.epoch > above:
                return name, status.epoch
        return None

    def known_leader(self):
        """(name, epoch) of the leader, once there is one."""
        found = []

        def leads():
            found[:] = self.leader() or []
            return found

        wait_for("one master leads", leads, LEADERLESS_S)
        return tuple(found)

    def next_leader(self, former, epoch, since):
        """The next leader, and how long the change took."""
        others, found = [name for name in self.apis if name != former], []
        deadline = since + LEADERLESS_S
        while not found and time.monotonic() < deadline:
            time.sleep(0.02)
            found = self.leader(others, epoch) or []
        if not found:
            raise SystemExit(f"no other master led within {LEADERLESS_S} s; see {self.out}")
        return found, time.monotonic() - since

    def purposes(self):
        return [driver["metadata"].get("purpose") for driver in json.loads(self.cli("drivers", "-o", "json"))]

    def ordered_purposes(self):
        """The epochs of all orders in the registry."""
        name, _ = self.known_leader()
        api = MasterApi(self.apis[name])
        try:
            return [order.metadata.get("purpose") for order in api.orders()]
        finally:
            api.close()

    def ignored_by_gateways(self):
        return sum(self.said(f"gateway-{number}", "its master no longer leads") for number in range(1, self.gateways + 1))


def kill_leader(cluster, orders, leader):
    name, epoch = leader
    since = time.monotonic()
    cluster.kill(name)
    following, took = cluster.next_leader(name, epoch, since)
    orders.follow()
    cluster.again(name)
    wait_for(f"{name} is back", lambda: cluster.status_of(name))
    return following, took


def stop_leader(cluster, orders, leader):
    """Returns the next leader, how long the change took, and the outcomes of the stale orders."""
    name, epoch = leader
    stale = [MasterApi(cluster.apis[name]) for _ in range(STALE)]
    for api in stale:
        api.status()
    process = cluster.process(name)
    since = time.monotonic()
    freeze(process)
    try:
        for number, api in enumerate(stale):  # it reads them when it resumes, before it knows that it no longer leads
            api.send_deploy("loadgen.so", f"gateway-{number % cluster.gateways + 1}", "stale", 2)
        following, took = cluster.next_leader(name, epoch, since)
        orders.follow()
    finally:
        process.send_signal(signal.SIGCONT)
    answers = []
    for api in stale:
        answers.append(api.answer(120))
        api.close()
    wait_for(f"{name} knows that it leads no more",
             lambda: (status := cluster.status_of(name)) and not status.leading and status.leader)
    return following, took, answers


def report(given, name, times):
    if not times:
        return
    print(f"{name} {len(times)} times: another one led after {statistics.median(times):.2f} s (median)", flush=True)
    judge(given, "next_leader_s", max(times))


def judge_stale(cluster, answers):
    if not answers:
        return
    refused = sum(refusal != "NONE" for refusal, _ in answers)
    done = sum("DONE" in outcomes for _, outcomes in answers)
    print(f"stale orders: {len(answers)}, refused by the former leader {refused}, by the registry or the gateways "
          f"{len(answers) - refused - done} (ignored by a gateway for their epoch: {cluster.ignored_by_gateways()}), "
          f"followed {done}", flush=True)
    if done or "stale" in cluster.purposes():
        raise SystemExit("an order of a master that led no more was followed")
    if "stale" in cluster.ordered_purposes():
        raise SystemExit("an order of a master that led no more stands in the registry: a gateway that starts follows it")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("build")
    parser.add_argument("--kills", type=int, default=2)
    parser.add_argument("--stops", type=int, default=1)
    parser.add_argument("--seed", type=int, default=int(time.time()))
    add_judge(parser)
    given = parser.parse_args()
    compile_idl(given.build)
    choose = random.Random(given.seed)
    print(f"seed {given.seed}", flush=True)
    killed, stopped, answers = [], [], []
    with Masters(given.build, "leaders") as cluster:
        cluster.start(gateways=2, more=f"registry.session_timeout: {GATEWAYS_SESSION_S}s", masters=3,
                      of_masters=f"registry.session_timeout: {SESSION_S}s")
        cluster.worker()
        cluster.known_leader()
        cluster.wait_until_ready()
        cluster.drivers(DRIVERS, 5 * RATE, RATE)
        usual = cluster.totals(60)
        cluster.undeploy_all()
        cluster.reports = []
        seconds = given.kills * KILL_S + given.stops * STOP_S
        cluster.drivers(DRIVERS, seconds * RATE, RATE, "faults")
        leader = cluster.known_leader()
        faults = ["kill"] * given.kills + ["stop"] * given.stops
        choose.shuffle(faults)
        with Orders(cluster) as orders:
            for fault in faults:
                time.sleep(choose.uniform(0, 1))  # in the middle of some order
                if fault == "kill":
                    leader, took = kill_leader(cluster, orders, leader)
                    killed.append(took)
                else:
                    leader, took, answered = stop_leader(cluster, orders, leader)
                    stopped.append(took)
                    answers += answered
        cluster.require_alive()
        judge_stale(cluster, answers)
        totals = cluster.totals(seconds + 60)
    report(given, "leader killed", killed)
    report(given, "leader frozen", stopped)
    print(f"orders meanwhile: {orders.done} done, {len(orders.failed)} not, or not known" + (", such as:" if orders.failed else ""))
    for text in orders.failed[:5]:
        print("  " + " ".join(text.split())[:240])
    print(f"gateways: all ready at {orders.looks - orders.not_ready} of {orders.looks} looks")
    if orders.not_ready:
        raise SystemExit("a gateway was lost with a master")
    print(sentence("with nothing wrong", usual))
    finish("masters killed and frozen", totals)
    judge(given, "without_a_master_s", totals["max_s"])


if __name__ == "__main__":
    main()

#!/usr/bin/python3
"""Commands on a shared channel while instances move from one driver host to another (updates, one at a time and all at
once), while a gateway has two hosts of one driver (two plugin files), and while these hosts are killed (SIGKILL) with all
instances. Each command that the topology sent comes to its instance, in order, and no daemon gives one up. A command that
is under way or held back when its channel ends is counted as `unknown` or `closed`: its tuple fails, and it is sent again.

usage: commands_test.py BUILD_DIR
"""

import os
import shutil
import signal
import sys
import urllib.request
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE), str(HERE.parent / "servers")]

import ledger  # noqa: E402
from checks import LABEL  # noqa: E402
from cluster import copy_plugins, ledger_topology  # noqa: E402
from private_cluster import PrivateCluster, free_ports, require, wait_for  # noqa: E402

UPDATED, OTHERS, RATE = 6, 14, 25
FIRST, SECOND = "chaos_ledger_driver.so", "chaos_ledger_driver-2.so"
# Of commands; those of the driver's own messages end with the host that is killed.
SENT_AGAIN = ("unknown", "closed")
DROPS = ("iotcloud_driver_lost_total", "iotcloud_bolt_lost_total", "iotcloud_bolt_unknown_driver_total")


class Fleet(PrivateCluster):
    def __init__(self, build, out):
        super().__init__(out, build / "bin", out / "plugins")
        copy_plugins(build, self.plugins)
        self.books = self.out / "books"
        self.books.mkdir()
        self.pages = dict(zip(("gateway-1", "worker"), free_ports(2)))
        self.instances = []

    def begin(self):
        self.rabbitmq = self.server("rabbitmq")
        self.start(gateways=1, brokers=[f'main: {{type: rabbitmq, urls: ["{self.rabbitmq}"]}}'], more=
                   "host_restart: {first: 200ms, longest: 1s, give_up_after: 0}\n"
                   f"metrics: {{address: \"127.0.0.1:{self.pages['gateway-1']}\"}}")
        self.topology("worker", ledger_topology(
            ("blocked",), registry=self.zookeeper, metrics=self.pages["worker"], url=self.rabbitmq, books=self.books,
            library=self.plugins / "chaos_ledger_bolt.so"))
        self.wait_until_ready()
        (self.books / "go").touch()

    def add(self, plugin, name, count):
        answer = self.answer("deploy", plugin, "--gateway", "gateway-1", "--name", name, "--count", count,
                             *(f"--property={word}" for word in (f"folder={self.books}", "kind=blocked", f"rate={RATE}")))
        outcomes = answer["outcomes"]
        require(all(outcome["outcome"] == "done" for outcome in outcomes), f"not deployed: {outcomes}")
        self.instances += [outcome["instance"] for outcome in outcomes]

    def update(self, plugin, *options):
        done = self.run_cli("update", "--plugin", plugin, "--name", "updated", *options, limit=120)
        require(done.returncode == 0, f"the update to {plugin} failed: {done}")

    def accounts(self):
        return [ledger.account(self.books, instance, ledger.BLOCKED, True, second_reader=False) for instance in self.instances]

    def heard(self):
        """How many commands each instance has got."""
        return {instance: len(ledger.lines(self.books / f"{instance}.heard")) for instance in self.instances}

    def all_hear(self, when, more=2 * RATE):
        """Waits until each instance got so many more commands."""
        before = self.heard()
        wait_for(f"each instance hears its commands {when}",
                 lambda: all(now >= before[instance] + more for instance, now in self.heard().items()))

    def runs(self):
        return sum(len(account.runs) for account in self.accounts())

    def count(self, when):
        sent = sum(len(ledger.commands(account).runs[0].sent) for account in self.accounts())
        print(f"{when}: {sent} commands sent so far, {sum(self.heard().values())} came", flush=True)

    def dropped(self):
        found = {}
        for name, port in self.pages.items():
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=60) as answer:
                for line in answer.read().decode().splitlines():
                    key, _, value = line.rpartition(" ")
                    labels = dict(LABEL.findall(key))
                    sent_again = key.startswith("iotcloud_bolt_lost_total") and labels["reason"] in SENT_AGAIN
                    if key.startswith(DROPS) and labels.get("channel") != "blocked" and not sent_again and float(value):
                        found[f"{name}: {key}"] = value
        return found


def main():
    build = Path(sys.argv[1]).resolve()
    out = build / "commands"
    shutil.rmtree(out, ignore_errors=True)
    with Fleet(build, out) as fleet:
        fleet.begin()
        fleet.add(FIRST, "updated", UPDATED)
        fleet.all_hear("before the update")
        fleet.update(SECOND, "--at-once", "1")
        fleet.all_hear("after the update")
        fleet.count(f"{UPDATED} instances were updated, one at a time")
        fleet.update(FIRST)
        fleet.all_hear("after the update of all")
        fleet.count(f"{UPDATED} instances were updated at once")
        fleet.update(SECOND)
        fleet.all_hear("after another one")

        fleet.add(FIRST, "others", OTHERS)
        wait_for("the gateway has two hosts", lambda: len(fleet.hosts_of("gateway-1")) == 2)
        fleet.all_hear("with two hosts of one driver")
        fleet.count("a gateway had two hosts of one driver")

        for number, host in enumerate(fleet.hosts_of("gateway-1"), 1):
            runs = fleet.runs()
            os.kill(host, signal.SIGKILL)
            wait_for("the instances of the killed host run again", lambda: fleet.runs() >= runs + UPDATED)
            fleet.all_hear(f"after host {number} was killed")
        fleet.count("both hosts were killed")

        (fleet.books / "go").unlink()
        wrong = []

        def all_is_well():
            wrong[:] = ledger.check(fleet.accounts())
            return not wrong

        try:
            wait_for("all commands came, in order", all_is_well)
        finally:
            for text in wrong:
                print(text)
        fleet.count("in the end")
        require(not fleet.dropped(), f"dropped: {fleet.dropped()}")
        fleet.require_alive()


if __name__ == "__main__":
    main()

#!/usr/bin/python3
"""ZooKeeper loses all its data under a fleet. Nothing is undeployed: driver hosts go on, and gateways are frozen. A backup
is imported, the gateways adopt it, and then everything is as ordered before: instances that run, that are stopped, that run
a plugin which was sent, a gateway that drains, a topology that is deactivated. Each gateway's /healthz says meanwhile that
it is frozen. Masters answer again within the session's time-out (printed, and judged with --judge), and say what they wait
for. Then an older copy of ZooKeeper's data is put back: gateways that followed newer orders are frozen, what runs goes on as those
orders said, and after the adoption they follow the orders of the copy, and new ones.

usage: wiped_registry_test.py BUILD_DIR [--judge]
"""

import argparse
import shutil
import threading
import time
import urllib.error
import urllib.request

from fault_cluster import FaultCluster, add_judge, judge
from private_cluster import StartError, free_port, require, wait_for

TIMEOUT_S = 10
WELL = 3 * [(200, "ok\n")]


class Fleet(FaultCluster):
    def daemon(self, program, name, configuration, enter=(), options=()):
        if program == "iotcloud-gateway":
            port = free_port()
            self.probes[name] = f"http://127.0.0.1:{port}/healthz"
            configuration += f'metrics: {{address: "127.0.0.1:{port}"}}\n'
        return super().daemon(program, name, configuration, enter, options)

    def health(self):
        """(status, text) of each gateway."""
        return [self.probe(url) for url in self.probes.values()]

    @staticmethod
    def probe(url):
        try:
            with urllib.request.urlopen(url, timeout=60) as answer:
                return answer.status, answer.read().decode()
        except urllib.error.HTTPError as error:
            return error.code, error.read().decode()

    def begin(self):
        self.probes = {}
        session = f"registry.session_timeout: {TIMEOUT_S}s"
        self.start(gateways=3, more=session, masters=2, of_masters=session)
        self.worker()
        self.wait_until_ready()
        # Other bytes than those in the gateways' folders: nobody reads what is behind a library.
        sent = self.work / "loadgen-sent.so"
        sent.write_bytes((self.plugins / "loadgen.so").read_bytes() + b"sent")
        for words in (("deploy", "loadgen.so", "--gateway", "gateway-1", "--name", "meter", "--count", "2", "--metadata",
                       "site=lab"),
                      ("deploy", "--plugin", sent, "--gateway", "gateway-2", "--name", "sent"),
                      ("deploy", "loadgen.so", "--gateway", "gateway-2", "--name", "stopped"),
                      ("deploy", "loadgen.so", "--gateway", "gateway-3", "--name", "drained"),
                      ("stop", "--name", "stopped"), ("drain", "gateway-3"), ("topology", "deactivate", "echo")):
            self.cli(*words)

    def ordered(self):
        """What people ordered, as the command line shows it."""
        drivers = {driver["instance"]: {key: driver.get(key) for key in ("gateway", "name", "index", "state", "metadata", "plugin")}
                   for driver in self.json("drivers")}
        drains = {gateway["gateway"]: gateway.get("draining", False) for gateway in self.json("gateways")}
        return drivers, drains, [topology["state"] for topology in self.json("topologies")]

    def order_done(self, *words):
        """Gives an order until the answer is that it is done; returns it. A gateway that is lost just then follows later."""
        answers = []

        def done():
            answers.append(self.cli(*words))
            return True

        wait_for(f"{' '.join(words)} is done", done)
        return answers[-1]

    def hosts(self):
        return sorted(host for number in (1, 2, 3) for host in self.hosts_of(f"gateway-{number}"))

    def wipe(self):
        """Begins to start ZooKeeper without its data: masters say what they wait for in the first seconds in which it serves,
        so they are to be asked before. `serves_since` says when it did, after `starting` has ended."""
        self.order("kill")
        shutil.rmtree(self.work / "zookeeper/data")
        (self.work / "zookeeper/data").mkdir()

        def start():
            self.order("start")
            self.serves_since = time.monotonic()

        self.starting = threading.Thread(target=start)
        self.starting.start()

    def copy(self):
        """Keeps a copy of the registry's data."""
        self.order("pause")
        shutil.copytree(self.work / "zookeeper/data", self.work / "older")
        self.order("resume")

    def put_back(self):
        """The registry's data are those of the copy."""
        self.order("kill")
        shutil.rmtree(self.work / "zookeeper/data")
        shutil.copytree(self.work / "older", self.work / "zookeeper/data")
        self.order("start")

    def frozen(self):
        """The gateways that live and do not follow the registry's orders."""
        return [gateway["gateway"] for gateway in self.json("gateways") if gateway["state"] == "ready" and gateway["frozen"]]

    def states(self):
        """(name, state) of all instances."""
        return sorted((driver["name"], driver["state"]) for driver in self.json("drivers"))


def check_older_copy(fleet):
    """All instances are active. The third gateway gets no order between the copy and its return."""
    older = fleet.states()
    fleet.copy()
    fleet.cli("stop", "--name", "meter")
    fleet.cli("deploy", "loadgen.so", "--gateway", "gateway-2", "--name", "later")
    newer, hosts = fleet.states(), fleet.hosts()
    require(("meter", "inactive") in newer and ("later", "active") in newer, f"before the copy is put back: {newer}")
    fleet.put_back()
    wait_for("the gateways that followed newer orders are frozen", lambda: fleet.frozen() == ["gateway-1", "gateway-2"])
    wait_for("all goes on as the newer orders said", lambda: fleet.states() == newer)
    require(fleet.hosts() == hosts, f"the hosts were {hosts} and are {fleet.hosts()}")

    def two_are_ill():
        ill = fleet.health()
        return [status for status, _ in ill] == [503, 503, 200] and all(
            "put back to an earlier state" in text for _, text in ill[:2])

    # They come back one after the other, and each is lost for a moment when the session ends that is in the copy.
    wait_for("the two are ill, and say why", two_are_ill)
    fleet.order_done("stop", "--name", "drained")  # on the third
    wait_for("the two are frozen without an adoption", lambda: fleet.frozen() == ["gateway-1", "gateway-2"])
    print(fleet.order_done("registry", "adopt", "--all").strip())
    fleet.order_done("start", "--name", "drained")
    wait_for("all is as the copy says", lambda: fleet.states() == older)
    fleet.order_done("stop", "--all")
    wait_for("new orders are followed", lambda: {state for _, state in fleet.states()} == {"inactive"})
    wait_for("all gateways are well", lambda: fleet.health() == WELL)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("build")
    add_judge(parser)
    given = parser.parse_args()
    with Fleet(given.build, "wiped") as fleet:
        fleet.begin()
        before, hosts = fleet.ordered(), fleet.hosts()
        require(len(before[0]) == 5 and list(before[1].values()).count(True) == 1 and before[2] == ["inactive"], f"at first: {before}")
        require(len(hosts) >= 3, f"the hosts are {hosts}")
        wait_for("all gateways are well", lambda: fleet.health() == WELL)
        backup = fleet.work / "backup.json"
        print(fleet.cli("registry", "export", backup).strip())

        fleet.wipe()
        said = set()

        def answers():
            try:
                fleet.json("gateways")
                return any(fleet.json("status")["master"][key] for key in ("leading", "leader"))
            except StartError as error:
                said.add(str(error))
                raise

        wait_for("a master leads again", answers)
        led = time.monotonic()
        fleet.starting.join()
        took = led - fleet.serves_since
        require(any("A new session begins within" in text for text in said), f"nobody said what they wait for: {said}")
        # A gateway without instances, and one whose instances are stopped, are as frozen as the others.
        wait_for("all gateways are frozen", lambda: len(fleet.frozen()) == 3)
        require(fleet.hosts() == hosts, f"the hosts were {hosts} and are {fleet.hosts()}")
        ill = fleet.health()
        require(all(status == 503 and "iotcloud registry adopt" in text for status, text in ill), f"the gateways' health: {ill}")

        print(fleet.cli("registry", "import", backup).strip())
        require(len(fleet.frozen()) == 3, "gateways follow orders that nobody has adopted")
        require(all(status == 503 for status, _ in fleet.health()), f"the gateways' health: {fleet.health()}")
        print(fleet.cli("registry", "adopt", "--all").strip())
        wait_for("all is as ordered", lambda: fleet.ordered() == before)
        wait_for("all gateways are well", lambda: fleet.health() == WELL)
        require(fleet.hosts() == hosts, f"the hosts were {hosts} and are {fleet.hosts()}: something was undeployed meanwhile")
        fleet.cli("topology", "activate", "echo")
        fleet.cli("start", "--name", "stopped")
        fleet.cli("undrain", "gateway-3")
        wait_for("all instances run", lambda: {driver["state"] for driver in fleet.json("drivers")} == {"active"})
        check_older_copy(fleet)
        fleet.require_alive()
    print(f"a master led again {took:.1f} s after ZooKeeper had lost its data; {len(before[0])} instances as ordered")
    judge(given, "without_the_registrys_data_s", took)


if __name__ == "__main__":
    main()

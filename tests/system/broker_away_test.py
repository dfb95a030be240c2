#!/usr/bin/python3
"""A broker that is away is told everywhere, with since when and why, until it is back: `iotcloud gateways`, `status`, `topology
show`, `channel list`, and the pages of gateway and worker. A topology whose only worker died is not shown as active.

usage: broker_away_test.py BUILD_DIR
"""

import re
import shutil
import signal
import sys
import urllib.error
import urllib.request
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "servers"))

from private_cluster import PrivateCluster, StartError, echo_topology, require, wait_for  # noqa: E402
from private_server import free_ports  # noqa: E402

AWAY = re.compile(r"the broker rabbitmq \(amqp://\S+\) is away since \d{4}-\d\d-\d\dT\d\d:\d\d:\d\dZ: \S")
# A line of `topology show` or `channel list`: the state, since when, and why.
ROW = re.compile(r"rabbitmq +amqp://\S+ +away +\S+ +\S")
CHANNEL = re.compile(r"away: \S")


def page(address, path):
    try:
        return urllib.request.urlopen(f"http://{address}{path}", timeout=60).read().decode()
    except urllib.error.HTTPError as error:
        return f"{error.code} {error.read().decode()}"


class Told:
    """What each place says of the broker."""

    def __init__(self, cluster, gateway, worker):
        self.cluster, self.gateway, self.worker = cluster, gateway, worker
        self.instance = cluster.json("drivers")[0]["instance"]

    def line(self, begin, *words):
        """The lines of a command's output with `begin`."""
        return "\n".join(line for line in self.cluster.run_cli(*words).stdout.splitlines() if begin in line)

    def places(self):
        """(place, what it says, the pattern of it while the broker is away)"""
        yield "gateways", self.line("gateway-1", "gateways"), AWAY
        for whose in ("gateway gateway-1", "echo"):
            trouble = [line for line in self.cluster.json("status")["trouble"] if line.startswith(f"{whose}: ")]
            yield f"status, of {whose}", "\n".join(trouble), AWAY
        yield "topology show, of the worker", self.line("active", "topology", "show", "echo"), AWAY
        yield "topology show, of the broker", self.line("amqp://", "topology", "show", "echo"), ROW
        yield "channel list", self.line("rabbitmq", "channel", "list", self.instance), CHANNEL
        for name, address in (("gateway", self.gateway), ("worker", self.worker)):
            yield f"/healthz of the {name}", page(address, "/healthz"), AWAY

    def away(self):
        """How many drivers' and topologies' connections the metrics call away."""
        def count(address, name):
            return sum(float(line.split()[-1]) for line in page(address, "/metrics").splitlines() if line.startswith(name + "{"))

        return count(self.gateway, "iotcloud_driver_broker_away"), count(self.worker, "iotcloud_broker_away")

    def all_tell(self):
        return all(pattern.search(text) for _, text, pattern in self.places()) and min(self.away()) > 0

    def none_tells(self):
        return not any("away" in text for _, text, _ in self.places()) and max(self.away()) == 0

    def wait_until(self, what, condition):
        try:
            wait_for(what, condition)
        except SystemExit:
            print("\n".join(f"{place}: {text.strip()}" for place, text, _ in self.places()), self.away())
            raise


def check_broker(cluster, told):
    told.wait_until("nobody says that something is wrong", told.none_tells)
    require(page(told.gateway, "/healthz") == "ok\n" and page(told.worker, "/healthz") == "ok\n", "a daemon is not well")
    cluster.tell("rabbitmq", "kill")
    told.wait_until("all say that the broker is away, since when and why", told.all_tell)
    for place, text, _ in told.places():
        print(f"{place}: {' '.join(text.split())}")
    for address in (told.gateway, told.worker):
        require(page(address, "/healthz").startswith("503 "), "a daemon without its broker calls itself well")
    cluster.tell("rabbitmq", "start")
    told.wait_until("nobody says it any more", told.none_tells)


def check_worker(cluster):
    require(cluster.json("topology", "list")[0]["state"] == "active", "the topology is not active")
    cluster.end("worker", signal.SIGKILL)
    wait_for("the topology has no worker", lambda: cluster.json("topology", "list")[0]["state"] == "no worker")
    status = cluster.json("status")
    require("echo: no worker runs" in status["trouble"], status)
    shown = cluster.run_cli("topology", "show", "echo")
    require(shown.stdout.startswith("echo: no worker, 0 workers") and "no worker of topology echo runs" in shown.stderr, shown)
    cluster.again("worker")
    wait_for("it is active again", lambda: cluster.json("topology", "list")[0]["state"] == "active")


def main():
    build = Path(sys.argv[1]).resolve()
    work = build / "broker-away-test"
    shutil.rmtree(work, ignore_errors=True)
    gateway, worker = (f"127.0.0.1:{port}" for port in free_ports(2))
    with PrivateCluster(work, build / "bin", build / "plugins") as cluster:
        cluster.start(gateways=1, more=f'metrics: {{address: "{gateway}"}}')
        cluster.topology("worker", echo_topology(more=f'registry.session_timeout: 4s\nmetrics: {{address: "{worker}"}}'))
        cluster.wait_until_ready()
        cluster.deploy("loadgen.so", "gateway-1", {"rate": 20})
        check_broker(cluster, Told(cluster, gateway, worker))
        check_worker(cluster)
        cluster.undeploy_all()
        cluster.require_alive()
    print("what was away was told, and only as long as it was")


if __name__ == "__main__":
    try:
        main()
    except StartError as error:
        sys.exit(str(error))

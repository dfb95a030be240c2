#!/usr/bin/python3
"""A topology starts before anything else is there, takes drivers as they come and drops them as they go, and goes on
while the gateway, the master and ZooKeeper are killed and come back. The registry is below a root of its own (zk.root)
and guarded by user and password. No message is lost.

usage: restarts_test.py BUILD_DIR
"""

import re
import shutil
import sys
import time
import urllib.request
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "servers"))

from private_cluster import PrivateCluster, echo_topology, free_port, result_of, wait_for  # noqa: E402

COUNT, RATE = 2500, 100
SESSION_S = 4
REGISTRY = """
zk.root: /farm/sensors
registry.session_timeout: {session}s
registry.user: farm
registry.password_file: "{password}"
"""


class Farm(PrivateCluster):
    def begin(self):
        """Servers only: daemons come one by one."""
        self.rabbitmq, self.zookeeper = self.server("rabbitmq"), self.server("zookeeper")
        password = self.out / "registry.password"
        password.write_text("a secret\n")
        self.registry = REGISTRY.replace("{password}", str(password)).replace("{session}", str(SESSION_S))
        self.page = f"127.0.0.1:{free_port()}"
        self.api_port = free_port()
        self.thrift = {name: free_port() for name in ("master", "gateway-1", "gateway-2")}

    def master(self):
        self.daemon("iotcloud-master", "master", f"""
id: farm-master
registry: "{self.zookeeper}"
{self.registry}
api: {{host: 127.0.0.1, port: {self.api_port}}}
gateways: {{host: 127.0.0.1, port: {self.thrift['master']}}}
""")

    def gateway(self, name):
        self.daemon("iotcloud-gateway", name, f"""
id: {name}
registry: "{self.zookeeper}"
{self.registry}
thrift: {{host: 127.0.0.1, port: {self.thrift[name]}}}
plugins: "{self.plugins}"
state: "{self.out / 'state' / name}"
brokers:
  rabbitmq: {{type: rabbitmq, urls: ["{self.rabbitmq}"]}}
""")

    def process(self, name):
        return next(child for known, child in self.children if known == name)

    def kill(self, name):
        child = self.process(name)
        child.kill()
        child.wait()
        self.children.remove((name, child))

    def order(self, name, word, answer):
        """A command for a server's script."""
        child = self.process(name)
        child.stdin.write(word + "\n")
        child.stdin.flush()
        said = child.stdout.readline()
        if not said.startswith(answer):
            sys.exit(f"{name}: {word}: {said}")

    def states(self, command, key):
        return [entry[key] for entry in self.json(command)]

    def read(self):
        """How many messages the worker has read."""
        with urllib.request.urlopen(f"http://{self.page}/metrics", timeout=60) as answer:
            lines = answer.read().decode().splitlines()
        return sum(float(line.rsplit(" ", 1)[1]) for line in lines if line.startswith("iotcloud_spout_received_total{"))

    def came_to_registry(self):
        """How often each gateway has come to the registry, according to its log."""
        return [self.log(name).read_text().count("connected to the registry") for name in ("gateway-1", "gateway-2")]

    def ready(self, count):
        wait_for(f"{count} gateways are ready", lambda: self.states("gateways", "state").count("ready") == count)

    def taken(self):
        """How often the worker has begun to read a driver's channel, according to its log."""
        return sum(map(int, re.findall(r" receive: units taken (\d+)", self.log("worker").read_text())))


def main():
    build = Path(sys.argv[1]).resolve()
    work = build / "restarts"
    shutil.rmtree(work, ignore_errors=True)
    with Farm(work, build / "bin", build / "plugins") as farm:
        farm.begin()
        page = f'metrics: {{address: "{farm.page}"}}'
        farm.topology("worker", farm.registry + echo_topology(more=page))  # nothing exists yet, not even the tree
        farm.master()
        wait_for("the topology is known", lambda: farm.states("topologies", "topology") == ["echo"])
        farm.gateway("gateway-1")
        farm.gateway("gateway-2")
        farm.ready(2)
        reports = [work / f"report-{number}.json" for number in (1, 2)]
        for number, report in enumerate(reports, 1):
            farm.deploy("loadgen.so", f"gateway-{number}", {"count": COUNT, "rate": RATE, "report": report})
        wait_for("the worker reads both drivers", lambda: farm.taken() >= 2)

        former = farm.gateway_record("gateway-1")
        farm.kill("gateway-1")  # its driver host goes on, and is adopted
        farm.gateway("gateway-1")
        farm.kill("master")
        wait_for("the host is adopted without a master", lambda: "adopted the driver host" in
                 farm.log("gateway-1").read_text())
        farm.master()
        farm.wait_for_next_life("gateway-1", former)
        farm.ready(2)
        farm.order("zookeeper", "kill", "KILLED")
        over = time.monotonic() + 1.5 * SESSION_S
        wait_for("the sessions are over", lambda: time.monotonic() > over)
        read = farm.read()
        wait_for("the worker reads without ZooKeeper", lambda: farm.read() > read or all(map(result_of, reports)))
        came = farm.came_to_registry()
        farm.order("zookeeper", "start", "READY")
        wait_for("both drivers have everything back", lambda: all(map(result_of, reports)), 120)
        farm.require_alive()
        for report in reports:
            result = result_of(report)
            wrong = {key: result[key] for key in ("lost", "damaged", "foreign") if result[key]}
            if wrong or result["sent"] != COUNT:
                sys.exit(f"{report.name}: {wrong or result}")

        # Before, the records of sessions that have ended meanwhile may count as ready.
        wait_for("the gateways are at ZooKeeper again", lambda: all(
            now > before for now, before in zip(farm.came_to_registry(), came)))
        farm.ready(2)
        farm.undeploy_all()
        late = work / "report-late.json"
        before = farm.taken()
        farm.deploy("loadgen.so", "gateway-2", {"count": 100, "rate": RATE, "report": late})
        wait_for("the driver that came last has everything back", lambda: result_of(late))
        wait_for("the log says that it was taken", lambda: farm.taken() > before)
        if result_of(late)["lost"]:
            sys.exit(f"the driver that came last: {result_of(late)}")
    print(f"2 drivers x {COUNT} messages during restarts of gateway, master and ZooKeeper: all back")


if __name__ == "__main__":
    main()

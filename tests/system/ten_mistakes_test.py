#!/usr/bin/python3
"""The ten mistakes of a first day, each made on a private system: what is printed first says what is wrong, where, and how
it is mended. Prints all of it, and how soon it came. The wrong channel is named twice, in a command and in a topology.

usage: ten_mistakes_test.py BUILD_DIR [SECONDS]      SECONDS: the most that a first message may take, on a quiet machine
"""

import math
import re
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "servers"))

from private_cluster import PrivateCluster, StartError, require, wait_for  # noqa: E402
from private_server import die_with_parent, free_ports, freeze  # noqa: E402


class Watched:
    """A program whose lines are read as they come, with the time since `begun`."""

    def __init__(self, words, begun=None):
        self.begun = begun or time.monotonic()
        self.lines = []
        self.child = subprocess.Popen([str(word) for word in words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                                      text=True, errors="replace", preexec_fn=die_with_parent)
        self.reader = threading.Thread(target=self.read, daemon=True)
        self.reader.start()

    def read(self):
        for line in self.child.stdout:
            self.lines.append((time.monotonic() - self.begun, line.rstrip("\n")))

    def first(self, pattern, longest=120):
        """Waits for a line that matches. Returns when it came, and the line."""
        deadline = time.monotonic() + longest
        while time.monotonic() < deadline:
            ended = self.child.poll() is not None and not self.reader.is_alive()
            for when, line in list(self.lines):
                if re.search(pattern, line):
                    return when, line
            if ended:
                break
            time.sleep(0.02)
        sys.exit(f"wrong: no line with {pattern!r}, but:\n" + "\n".join(line for _, line in self.lines))

    def end(self):
        if self.child.poll() is None:
            self.child.terminate()
        status = self.child.wait(120)
        self.reader.join(120)
        return status


class Mistakes:
    def __init__(self, system, build, work, limit):
        self.system, self.build, self.work, self.limit = system, build, work, limit
        self.number = 0

    def told(self, mistake, when, line, *wanted):
        """Checks and prints the first message of a mistake. `wanted`: what, where, and how to mend it."""
        self.number += 1
        print(f"{self.number:2}. {mistake} ({when:.2f} s)\n    {line}", flush=True)
        for words in wanted:
            require(words in line, f"{mistake}: no {words!r} in: {line}")
        require(when <= self.limit, f"{mistake}: the first message took {when:.2f} s, more than {self.limit} s")

    def run(self, mistake, words, pattern, *wanted):
        """A program that fails, with its message."""
        program = Watched(words)
        when, line = program.first(pattern)
        self.told(mistake, when, line, *wanted)
        require(program.end() != 0, f"{mistake}: it does not fail")

    def file(self, name, text):
        path = self.work / name
        path.write_text(text)
        return path

    def gateway_file(self, name, id_, port, registry=None):
        return self.file(name, f"""id: {id_}
registry: "{registry or self.system.zookeeper}"
thrift: {{host: 127.0.0.1, port: {port}}}
plugins: "{self.system.plugins}"
state: "{self.work / 'state' / name}"
brokers:
  rabbitmq: {{type: rabbitmq, urls: ["{self.system.rabbitmq}"]}}
""")

    # The mistakes.

    def bad_yaml(self):
        topology = self.file("bad.yaml", "topology.name: weather\nspouts:\n\tin: {broker: rabbitmq}\n")
        self.run("bad YAML", [self.system.bin / "iotcloud-topology", "--check", topology], "bad.yaml", "bad.yaml:3",
                 "TAB")

    def wrong_type(self):
        topology = self.file("type.yaml", """topology.name: weather
zk.servers: ["127.0.0.1:2181"]
spouts:
  in: {broker: rabbitmq, driver: loadgen, channel: data, fields: [data], parallelism: two}
bolts:
  out: {broker: rabbitmq, driver: loadgen, channel: echo, fields: [data], inputs: [{from: in, grouping: shuffle}]}
""")
        self.run("wrong type", [self.system.bin / "iotcloud-topology", "--check", topology], "type.yaml", "type.yaml:4",
                 "parallelism", '"two" does not fit', "a whole number from 1")

    def missing_symbol(self):
        self.run("missing symbol", self.system.command("plugin", "check", self.build / "tests/gateway/plugins/dangling.so"),
                 "dangling", "dangling.so", "nothing defines weather::calibrated(double)", "link it with -Wl,-z,defs")

    def abi(self):
        self.run("ABI", self.system.command("plugin", "check", self.build / "tests/gateway/plugins/future_sdk.so"),
                 "future_sdk", "future_sdk.so", "SDK version 4711", "rebuild the driver")

    def port_in_use(self):
        port, = free_ports(1)
        with socket.socket() as taken:
            taken.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            taken.bind(("127.0.0.1", port))
            taken.listen()
            self.run("port in use", [self.system.bin / "iotcloud-gateway", "--config",
                                     self.gateway_file("port.yaml", "gateway-9", port)],
                     f"cannot listen on 127.0.0.1:{port}", "in use", "choose another")
        require(all(one["gateway"] != "gateway-9" for one in self.system.json("gateways")), "a ghost is registered")

    def broker_away(self):
        self.system.tell("rabbitmq", "kill")
        begun = time.monotonic()
        shown = []

        def away():
            done = self.system.run_cli("status")
            shown[:] = [line for line in done.stdout.splitlines() if "is away" in line]
            return shown

        wait_for("the broker is shown as away", away)
        self.told("broker away", time.monotonic() - begun, shown[0].strip(), "gateway gateway-1", "the broker rabbitmq",
                  "is away since", "start its server")
        require(re.search("Z: (the connection broke|nobody listens at 127.0.0.1)", shown[0]), f"no reason: {shown[0]}")
        self.system.tell("rabbitmq", "start")

    def wrong_channel(self):
        self.run("wrong channel", self.system.command("channel", "echo", self.instance, "dta"), "no channel", '"dta"',
                 '"data" (out)')
        topology = self.file("channel.yaml", f"""topology.name: weather
registry: "{self.system.zookeeper}"
brokers: {{rabbitmq: "{self.system.rabbitmq}"}}
spouts:
  in: {{broker: rabbitmq, driver: loadgen, channel: dta, fields: [data, driverID]}}
bolts:
  out: {{broker: rabbitmq, driver: loadgen, channel: echo, fields: [data, driverID], inputs: [{{from: in}}]}}
""")
        program = Watched([self.system.bin / "iotcloud-topology", "--config", topology])
        when, line = program.first("waits for the channel")
        self.told("wrong channel of a spout", when, line, 'in: waits for the channel "dta"', "driver loadgen",
                  'did you mean "data"?')
        program.end()

    def zookeeper_away(self):
        port, = free_ports(1)
        program = Watched([self.system.bin / "iotcloud-gateway", "--config",
                           self.gateway_file("away.yaml", "gateway-8", port, f"zookeeper://127.0.0.1:{free_ports(1)[0]}")])
        when, line = program.first("cannot be reached yet")
        self.told("ZooKeeper away", when, line, "zookeeper://127.0.0.1", "trying on", "registry:")
        program.end()

    def same_id(self):
        port, = free_ports(1)
        program = Watched([self.system.bin / "iotcloud-gateway", "--config",
                           self.gateway_file("same.yaml", "gateway-1", port)])
        when, line = program.first("the id gateway-1 is held")
        self.told("same id", when, line, f"127.0.0.1:{self.system.thrift_ports['gateway-1']}", "waits up to",
                  "id of its own")
        program.child.kill()  # it would be refused only when that time is over
        program.end()

    def late_is_ordered(self):
        file = self.work / f"orders-{time.monotonic_ns()}.json"
        self.system.cli("registry", "export", file)
        return '"late"' in file.read_text()

    def master_killed(self):
        """The gateway stands still, so that the deployment is under way when the master dies."""
        gateway = dict(self.system.children)["gateway-1"]
        freeze(gateway)
        try:
            program = Watched(self.system.command("deploy", "loadgen.so", "--gateway", "gateway-1", "--name", "late"))
            wait_for("the order is there", self.late_is_ordered)
            program.begun = time.monotonic()
            self.system.end("master", signal.SIGKILL)
            when, line = program.first("may have been taken")
            self.told("master killed in mid-deploy", time.monotonic() - program.begun, line, "the order may have been taken",
                      "iotcloud drivers")
            require(program.end() == 1, "the deployment is not known, but not a failure")
        finally:
            gateway.send_signal(signal.SIGCONT)
        self.system.again("master")
        wait_for("what was ordered is carried out",
                 lambda: any(one.get("name", "").startswith("late") and one["state"] == "active" for one in self.system.json("drivers")))


def main():
    build = Path(sys.argv[1]).resolve()
    limit = float(sys.argv[2]) if len(sys.argv) > 2 else math.inf
    work = build / "ten-mistakes-test"
    shutil.rmtree(work, ignore_errors=True)
    with PrivateCluster(work, build / "bin", build / "plugins") as system:
        # It is frozen while an order is given, and is not to be lost meanwhile: the order would not wait for it.
        system.start(gateways=1, more="registry.session_timeout: 60s")
        system.wait_until_ready()
        mistakes = Mistakes(system, build, work, limit)
        answer = system.json("deploy", "loadgen.so", "--gateway", "gateway-1", "--property", "rate=20")
        mistakes.instance = answer["outcomes"][0]["instance"]
        for make in (mistakes.bad_yaml, mistakes.wrong_type, mistakes.missing_symbol, mistakes.abi, mistakes.port_in_use,
                     mistakes.wrong_channel, mistakes.zookeeper_away, mistakes.same_id, mistakes.broker_away,
                     mistakes.master_killed):
            make()
    print("each of the ten mistakes was told")


if __name__ == "__main__":
    try:
        main()
    except StartError as error:
        sys.exit(str(error))

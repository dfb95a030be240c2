#!/usr/bin/python3
"""The shipped units of the gateway and of its driver hosts, under a systemd of their own (booted.py).

- With `--hosts-as iotcloud-host`: a driver runs as another user than its gateway, neither of them root, and reaches neither
  its secrets nor its process, nor an address that the unit does not allow, and starts no more processes than the unit says.
  Without it does, which shows that the attacks are some.
- A gateway that is killed is started again; its host has lived on and is adopted. A host that hangs, which its gateway has
  no right to signal, is ended and started again. When systemd stops the gateway, its hosts end.

usage: adoption_test.py UNITS BUILD_DIR [--hosts-as iotcloud-host] [--kill-mode MODE]
"""

import argparse
import os
import shutil
import signal
from pathlib import Path

from booted import BootedCluster, require_means, skip, status_of, with_own_programs
from private_cluster import free_port, require, wait_for

UNIT, HOST_UNITS = "iotcloud-gateway.service", ["iotcloud-host.socket", "iotcloud-host@.service"]
# What a driver may do to its gateway, and what comes of it if it is another user. In /proc it does not even see it.
ATTACKS = {"signal_to_victim": "EPERM", "ptrace_of_victim": "EPERM", "memory_of_victim": "ENOENT", "environment_of_victim": "ENOENT",
           "secret_file": "EACCES", "forbidden_file": "EACCES", "root_again": "EPERM", "near": "ok", "far": "EPERM",
           "next_child": "EAGAIN"}
# What comes of them against a gateway of the same user, on every machine: only what the kernel keeps of a daemon, and shows to
# nobody, is out of reach.
OF_THE_SAME_USER = {**dict.fromkeys(["signal_to_victim", "secret_file", "forbidden_file", "next_child"], "ok"),
                    "environment_of_victim": "EACCES", "memory_of_victim": "EACCES"}

# A limit that is reached soon; units_test.py looks that the unit has one.
CHILDREN = 200
DROP_IN_OF_HOSTS = f"""
[Service]
IPAddressDeny=any
IPAddressAllow=127.0.0.2
TasksMax={CHILDREN}
"""
HOST_USER = "host_user: iotcloud-host\nhost_starter: /run/iotcloud-host"
DROP_IN = """
[Service]
StandardError=append:/run/gateway.log
ReadWritePaths=/run
"""


class Machine(BootedCluster):
    def boot_gateway(self, units, test_plugins, kill_mode, hosts_as):
        """systemd with the units of the gateway and its hosts; the programs' paths in them are other ones."""
        known = {"iotcloud-host@.service.d/limits.conf": DROP_IN_OF_HOSTS}
        for unit in [UNIT, *HOST_UNITS]:
            text = with_own_programs((units / unit).read_text()).replace("/etc/iotcloud/", "/opt/iotcloud/")
            if kill_mode:
                text = text.replace("KillMode=process", f"KillMode={kill_mode}")
            known[unit] = text + (DROP_IN if unit == UNIT else "")
        (self.out / "gateway.yaml").write_text(f"""
id: gateway-1
registry: "{self.zookeeper}"
thrift: {{host: 127.0.0.1, port: {free_port()}}}
plugins: /opt/iotcloud
state: state
host_hang_limit: 15s
# What the user alone keeps from a driver; other tests are about these.
host_call_filter: false
{HOST_USER if hosts_as else ""}
brokers: {{main: {{type: rabbitmq, urls: ["amqp://127.0.0.1:1/"]}}}}
""")
        secret = self.out / "tokens"
        secret.write_text("anna:admin:...")
        files = [self.bin / "iotcloud-gateway", self.bin / "iotcloud-driver-host", self.plugins / "loadgen.so",
                 test_plugins / "confined.so", self.out / "gateway.yaml"]
        self.boot(units, known, [UNIT], files, f"install -m 0600 -o iotcloud-gateway -g iotcloud-gateway {secret} /opt/iotcloud")
        self.gateways = 1

    def gateway(self):
        """Process id of the gateway, 0 when there is none."""
        for process in self.descendants():
            try:
                if Path(f"/proc/{process}/cmdline").read_bytes().startswith(b"/opt/iotcloud/iotcloud-gateway"):
                    return process
            except OSError:
                pass  # it has ended since it was listed
        return 0

    def driver(self, name="loadgen"):
        found = [driver for driver in self.json("drivers") if driver["driver"] == name]
        return found[0] if found else {"state": "not there"}

    def active_since(self):
        """Since when the load generator is active, by its host's clock; 0: it is not."""
        driver = self.driver()
        return driver["since_ms"] if driver["state"] == "active" else 0

    def hosts(self, plugin="loadgen.so"):
        """Process ids of the driver hosts of a plugin."""
        return self.processes(lambda words: words[0].endswith(b"iotcloud-driver-host") and f"--name={plugin}".encode() in words)

    def attack(self):
        """A driver that tries what it may do to its gateway, and says what came of it."""
        inside = status_of(self.gateway(), "NSpid")[-1]
        self.deploy("confined.so", "gateway-1", {"victim": inside, "near": "127.0.0.2", "far": "127.0.0.3",
                                                 "secret_file": "/opt/iotcloud/tokens",
                                                 "forbidden_file": "/var/lib/iotcloud-gateway/state/id",
                                                 "children": CHILDREN})
        wait_for("the probe is active", lambda: self.driver("confined")["state"] == "active")
        wait_for("the probe has reported", lambda: "user" in self.metadata())
        return self.metadata()

    def metadata(self):
        return self.json("describe", self.driver("confined")["instance"]).get("metadata", {})


def check_users(machine):
    """Gateway and hosts: two users, of which none is root or has a capability."""
    gateway, host = machine.gateway(), machine.hosts()[0]
    for process in (gateway, host):
        require(status_of(process, "Uid")[0] != "0", f"process {process} runs as root")
        for kind in ("CapPrm", "CapEff", "CapBnd", "CapAmb"):
            require(int(status_of(process, kind)[0], 16) == 0, f"process {process} has {kind} {status_of(process, kind)}")
    require(status_of(gateway, "Uid") != status_of(host, "Uid"), f"gateway and host run as {status_of(host, 'Uid')}")


def main():
    options = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    options.add_argument("units", type=Path)
    options.add_argument("build", type=Path)
    options.add_argument("--kill-mode", help="instead of the unit's, to see this test fail")
    options.add_argument("--hosts-as", choices=["iotcloud-host"], help="a user of their own; without: the gateway's")
    given = options.parse_args()
    require_means()
    out = given.build.resolve() / ("hosts_of_another_user" if given.hosts_as else "adoption")
    shutil.rmtree(out, ignore_errors=True)
    with Machine(out, given.build / "bin", given.build / "plugins") as machine:
        machine.start(gateways=0, brokers=[])
        machine.boot_gateway(given.units.resolve(), given.build.resolve() / "tests/gateway/plugins", given.kill_mode,
                             given.hosts_as)
        machine.wait_until_ready()
        machine.cli("deploy", "loadgen.so", "--gateway", "gateway-1", "--property", "rate=1")
        wait_for("the driver is active", lambda: machine.driver()["state"] == "active")
        gateway, hosts, before = machine.gateway(), machine.hosts(), machine.driver()
        require(len(hosts) == 1 and gateway, f"gateway {gateway} has the hosts {hosts}")
        shown = machine.systemctl("show", UNIT, "--property=MainPID,KillMode,ActiveState")
        require("ActiveState=active" in shown.stdout, f"systemd says: {shown}")
        facts = machine.attack()
        if given.hosts_as:
            check_users(machine)
        expected = dict(ATTACKS if given.hosts_as else OF_THE_SAME_USER)
        if not (counted := machine.space.counts_processes()):
            del expected["next_child"]
        for what, outcome in expected.items():
            require(facts.get(what) == outcome, f"a driver's {what} has the outcome {facts.get(what)}")
        machine.cli("undeploy", machine.driver("confined")["instance"])
        wait_for("the probe's host has ended", lambda: not machine.hosts("confined.so"))

        first_life = machine.gateway_record("gateway-1")
        os.kill(gateway, signal.SIGKILL)
        wait_for("systemd starts the gateway again", lambda: machine.gateway() not in (0, gateway))
        machine.wait_for_next_life("gateway-1", first_life)
        machine.cli("stop", before["instance"])
        wait_for("the driver follows orders", lambda: machine.driver()["state"] == "inactive")
        require(machine.hosts() == hosts, f"host {hosts} did not outlive its gateway; now there are {machine.hosts()}")
        shown = machine.systemctl("show", UNIT, "--property=NRestarts")
        require(shown.stdout.strip() == "NRestarts=1", f"systemd says: {shown}")
        machine.cli("start", before["instance"])
        wait_for("the driver is active again", lambda: machine.driver()["state"] == "active")

        since = machine.active_since()
        os.kill(hosts[0], signal.SIGSTOP)
        wait_for("a host that hangs is ended, and another one started", lambda: machine.hosts() not in ([], hosts))
        # The record of the host that hung may still say so.
        wait_for("the driver is active once more", lambda: machine.active_since() > since)

        stopped = machine.systemctl("stop", UNIT)
        require(stopped.returncode == 0, f"the gateway did not stop: {stopped}")
        require(not machine.gateway() and not machine.hosts_of("gateway-1"), "processes are left after the stop: "
                f"{machine.gateway()} {machine.hosts_of('gateway-1')}")
    print(f"host {hosts[0]} {'did nothing to' if given.hosts_as else 'could attack'} gateway {gateway}, outlived it, and was ended "
          "by the next one")
    if not counted:
        skip("all but the limit of processes (TasksMax) was shown: no group of processes here counts them")


if __name__ == "__main__":
    main()

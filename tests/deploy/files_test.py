#!/usr/bin/python3
"""The shipped units of all daemons, under a systemd of their own (booted.py), with files that the tools made and that belong to
whom the commands in deploy/README.md give them: each daemon reads its key, its tokens and its password, which is seen by what
it does, and no other user reads them. Tokens and certificates are renewed without a restart.

usage: files_test.py DEPLOY_FOLDER BUILD_DIR
"""

import argparse
import re
import shutil
import socket
import ssl
import subprocess
from pathlib import Path

from booted import BootedCluster, require_means, status_of, with_own_programs
from private_cluster import echo_topology, free_port, require, wait_for

DAEMONS = {"iotcloud-master.service": "iotcloud-master", "iotcloud-gateway.service": "iotcloud-gateway",
           "iotcloud-topology@echo.service": "iotcloud-topology", "iotcloud-registry-tunnel.service": "iotcloud-tunnel"}
# Who reads each secret file, of all the users.
READERS = {"master.key": {"iotcloud-master"}, "master-tokens": {"iotcloud-master"}, "master.password": {"iotcloud-master"},
           "gateway-tokens": {"iotcloud-gateway"}, "gateway.password": {"iotcloud-gateway"},
           "worker.password": {"iotcloud-topology"}, "lab1.key": set(DAEMONS.values()), "page-tokens": set(DAEMONS.values())}
USERS = [*DAEMONS.values(), "iotcloud-host"]
ETC = "/etc/iotcloud"
TLS = f"tls: {{ca: {ETC}/ca.pem, certificate: {ETC}/lab1.pem, key: {ETC}/lab1.key, revoked: {ETC}/revoked.pem}}"


def commands(deploy):
    """The blocks of commands in the README: what gives the files to the daemons, and what brings a renewed certificate."""
    return re.findall(r"```sh\n(.*?)```", (deploy / "README.md").read_text().split("## Files")[1], re.DOTALL)


class Machine(BootedCluster):
    def make_files(self, deploy):
        """What /etc/iotcloud is to have, as the tools make it."""
        self.certs, self.etc = self.out / "certs", self.out / "etc"
        self.etc.mkdir()
        (self.etc / "topologies").mkdir()
        self.tool("certs", "init", self.certs, "--host", "lab1")
        for name in ("ca.pem", "lab1.pem", "lab1.key", "revoked.pem"):
            shutil.copy2(self.certs / name, self.etc)
        self.tool("keys", "new", self.etc / "master")
        self.token = self.tool("token", "add", "anna", "--role", "admin", "--file", self.etc / "master-tokens").strip()
        for name in ("gateway-tokens", "page-tokens"):
            self.tool("token", "add", "anna", "--role", "viewer", "--file", self.etc / name)
        for user, role, file in (("master", "master", "master"), ("gateway-1", "gateway", "gateway"), ("workers", "worker", "worker")):
            password = self.tool("registry", "user", user, "--role", role, "--file", self.etc / "registry.users")
            (self.etc / f"{file}.password").touch(0o600)
            (self.etc / f"{file}.password").write_text(password)
        self.api_port, self.tunnel_port = free_port(), free_port()
        pages = {name: f'metrics: {{address: "127.0.0.1:{free_port()}", {TLS}, tokens: {ETC}/page-tokens}}' for name in ("master", "worker")}

        def registry(user, file):
            return f"""registry.user: {user}
registry.password_file: {ETC}/{file}.password
registry.users: {ETC}/registry.users
"""
        (self.etc / "master.yaml").write_text(f"""
id: master
registry: "{self.zookeeper}"
{registry("master", "master")}
api: {{host: 127.0.0.1, port: {self.api_port}, {TLS}, tokens: {ETC}/master-tokens}}
orders: {{signing_key: {ETC}/master.key, trusted_keys: [{ETC}/master.pub]}}
audit: {{file: /var/lib/iotcloud-master/audit.log}}
{pages["master"]}
""")
        (self.etc / "gateway.yaml").write_text(f"""
id: gateway-1
registry: "{self.zookeeper}"
{registry("gateway-1", "gateway")}
thrift: {{host: 127.0.0.1, port: {free_port()}, {TLS}, tokens: {ETC}/gateway-tokens}}
orders.trusted_keys: [{ETC}/master.pub]
plugins: /opt/iotcloud
state: state
brokers: {{main: {{type: rabbitmq, urls: ["amqp://127.0.0.1:1/"]}}}}
""")
        servers = self.zookeeper.removeprefix("zookeeper://")
        (self.etc / "topologies/echo.yaml").write_text(
            echo_topology(more=registry("workers", "worker") + pages["worker"]).replace("{zookeeper}", servers))
        (self.etc / "registry-tunnel.conf").write_text(
            (deploy / "systemd/registry-tunnel.conf").read_text().replace("127.0.0.1:2181", f"127.0.0.1:{self.tunnel_port}"))

    def tool(self, *words):
        return subprocess.run([self.bin / "iotcloud", *words], check=True, capture_output=True, text=True, timeout=60).stdout

    def command(self, *words):
        own = ["--ca", self.certs / "ca.pem", "--certificate", self.certs / "operator.pem", "--key", self.certs / "operator.key"]
        token = self.out / "anna.token"
        token.touch(0o600)
        token.write_text(self.token)
        return [str(word) for word in (self.bin / "iotcloud", "--master", f"127.0.0.1:{self.api_port}", *own, "--token-file", token,
                                       *words)]

    def main_process(self, unit):
        """Process id of a unit's daemon as this test sees it; 0: it does not run."""
        inside = self.systemctl("show", unit, "--property=MainPID").stdout.strip().removeprefix("MainPID=")
        return next((process for process in self.descendants() if inside != "0" and status_of(process, "NSpid")[-1] == inside), 0)

    def reads(self, user, file):
        """Whether a daemon of this user, with the groups that its unit gives it, may read a file."""
        groups = "--clear-groups" if user == "iotcloud-host" else "--groups=iotcloud"
        done = self.inside("setpriv", f"--reuid={user}", f"--regid={user}", groups, "cat", f"{ETC}/{file}")
        return done.returncode == 0

    def serial_number(self):
        """That of the certificate that the master shows."""
        context = ssl.create_default_context(cafile=self.certs / "ca.pem")
        context.load_cert_chain(self.certs / "operator.pem", self.certs / "operator.key")
        with socket.create_connection(("127.0.0.1", self.api_port), timeout=30) as plain, \
                context.wrap_socket(plain, server_hostname="127.0.0.1") as client:
            return client.getpeercert()["serialNumber"]


def check_work(machine):
    """Each daemon does what it could not without its files."""
    wait_for("the gateway and the topology's worker are there", lambda: machine.json("gateways")[0]["state"] == "ready" and
             machine.json("topologies")[0]["workers"])
    machine.deploy("loadgen.so", "gateway-1", {"rate": "1"})  # an order that the gateway follows only if it is signed
    wait_for("the driver is active", lambda: machine.json("drivers")[0]["state"] == "active")
    with socket.create_connection(("127.0.0.1", machine.tunnel_port), timeout=30):
        pass  # without its key the tunnel does not listen


def check_users(machine):
    for unit, user in DAEMONS.items():
        process = machine.main_process(unit)
        require(process, f"{unit} does not run")
        number = machine.inside("id", "-u", user).stdout.strip()
        require(set(status_of(process, "Uid")) == {number} and number != "0", f"{unit} runs as {status_of(process, 'Uid')}, not as {user}")
    for file, readers in READERS.items():
        found = {user for user in USERS if machine.reads(user, file)}
        require(found == readers, f"{file} is read by {found}, and is for {readers}")


def check_renewal(machine, bring):
    """A new token and a renewed certificate count, and nothing is started again."""
    processes = {unit: machine.main_process(unit) for unit in DAEMONS}
    made = machine.inside(machine.bin / "iotcloud", "token", "add", "bob", "--role", "admin", "--file", f"{ETC}/master-tokens")
    require(made.returncode == 0, f"no token for bob: {made.stderr}")
    machine.token = made.stdout.strip()
    reloaded = machine.systemctl("reload", "iotcloud-master.service")
    require(reloaded.returncode == 0, f"systemd does not reload the master: {reloaded.stderr}")
    wait_for("the new token counts", lambda: machine.json("gateways"))
    before = machine.serial_number()
    machine.tool("certs", "renew", machine.certs, "lab1", "--new-key")
    brought = machine.inside("sh", "-e", "-c", bring.replace("CERTS", str(machine.certs)))
    require(brought.returncode == 0, f"the certificate does not get to its daemons: {brought.stderr}")
    wait_for("the master shows the renewed certificate", lambda: machine.serial_number() != before)
    require(processes == {unit: machine.main_process(unit) for unit in DAEMONS}, "a daemon was started again")
    require(machine.reads("iotcloud-master", "master-tokens") and not machine.reads("iotcloud-gateway", "master-tokens"),
            "the file of tokens has other readers than before")


def main():
    options = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    options.add_argument("deploy", type=Path)
    options.add_argument("build", type=Path)
    given = options.parse_args()
    require_means()
    deploy, build = given.deploy.resolve(), given.build.resolve()
    give, bring = commands(deploy)
    out = build / "files_of_units"
    shutil.rmtree(out, ignore_errors=True)
    with Machine(out, build / "bin", build / "plugins") as machine:
        machine.zookeeper = machine.server("zookeeper")
        machine.make_files(deploy)
        known = {unit.replace("@echo", "@"): with_own_programs((deploy / "systemd" / unit.replace("@echo", "@")).read_text())
                 for unit in DAEMONS}
        files = [build / "bin" / program for program in ("iotcloud-master", "iotcloud-gateway", "iotcloud-driver-host",
                                                         "iotcloud-topology")]
        machine.boot(deploy / "systemd", known, list(DAEMONS), [*files, build / "plugins/loadgen.so"],
                     f"cp -r --preserve=mode {machine.etc} {ETC}\n({give})")
        wait_for("the master answers", lambda: machine.json("gateways"))
        check_work(machine)
        check_users(machine)
        check_renewal(machine, bring)
    print(f"{len(DAEMONS)} daemons read their files, and no others do")


if __name__ == "__main__":
    main()

#!/usr/bin/python3
"""The shipped units of all daemons, under a systemd of their own (booted.py), with the secured files of deploy/fleet, which the
commands of its page made and which belong to whom the commands below its "Files" give them: each daemon reads its key, its
tokens and its password, which is seen by what it does, and no other user reads them. Tokens and certificates are renewed without
a restart. Then other machines of the fleet are stolen, one with a gateway and one with workers, and the page's commands end what their
thieves have.

usage: files_test.py DEPLOY_FOLDER BUILD_DIR
"""

import argparse
import json
import shutil
import socket
import ssl
import struct
import subprocess
from pathlib import Path

import fleet
from booted import BootedCluster, require_means, status_of, with_own_programs
from private_cluster import free_port, require, wait_for

DAEMONS = {"iotcloud-master.service": "iotcloud-master", "iotcloud-gateway.service": "iotcloud-gateway",
           "iotcloud-topology@echo.service": "iotcloud-topology", "iotcloud-pool.service": "iotcloud-pool",
           "iotcloud-registry-tunnel.service": "iotcloud-tunnel"}
# Who reads each secret file, of all the users.
READERS = {"master.key": {"iotcloud-master"}, "master-tokens": {"iotcloud-master"}, "master.password": {"iotcloud-master"},
           "worker-pages.token": {"iotcloud-master"}, "gateways/gateway-1.token": {"iotcloud-master"},
           "gateway-tokens": {"iotcloud-gateway"}, "gateway.password": {"iotcloud-gateway"},
           "broker.password": {"iotcloud-gateway", "iotcloud-host"}, "broker-reads.password": {"iotcloud-gateway", "iotcloud-host"},
           "worker.password": {"iotcloud-topology"}, "worker-broker.password": {"iotcloud-topology"},
           "pools/pool-1.token": {"iotcloud-master"}, "pool.password": {"iotcloud-pool"}, "pool-tokens": {"iotcloud-pool"},
           **{f"workers/{name}": {"iotcloud-pool", "iotcloud-worker"} for name in ("host.key", "worker.password", "worker-broker.password")},
           "page-tokens": set(DAEMONS.values()), **{f"lab1-{user.removeprefix('iotcloud-')}.key": {user} for user in DAEMONS.values()}}
TOKEN_FILES = ["master-tokens", "gateway-tokens", "pool-tokens", "page-tokens", "workers/page-tokens"]
USERS = [*DAEMONS.values(), "iotcloud-host", "iotcloud-worker"]
# Where systemd runs what it is told, as the user of hosts or workers; and who may tell it.
STARTERS = {"/run/iotcloud-host": "iotcloud-gateway", "/run/iotcloud-worker": "iotcloud-pool"}
STARTED_UNITS = [f"{starter.removeprefix('/run/')}{kind}" for starter in STARTERS for kind in (".socket", "@.service")]
ETC = "/etc/iotcloud"
# Of the machine lab1, on which everything is here.
NAMES = "echo '127.0.0.1 lab1 zk1 broker-1' >>/etc/hosts\necho lab1 >/etc/hostname"


# What a client of ZooKeeper says first: the length, the protocol's version, no transaction seen, a time-out of 10 s, no session.
HELLO_REGISTRY = struct.pack(">iiqiqi16x", 44, 0, 0, 10_000, 0, 16)


class Machine(BootedCluster):
    def make_files(self, deploy):
        """The files of a secured fleet, on ports of this test, and the other end of the tunnel to the registry."""
        folder = self.out / "fleet"
        folder.mkdir()
        fleet.make(deploy, self.bin, self.plugins / "loadgen.so", folder)
        self.certs, self.etc, self.signed = folder / "certs", folder / "etc", folder / "plugins"
        self.folder = folder
        self.token = (folder / "anna.token").read_text().strip()
        self.api_port, self.tunnel_port, self.registry_port = free_port(), free_port(), free_port()
        servers = self.zookeeper.removeprefix("zookeeper://")
        registry, nobody = {"127.0.0.1:2181": servers}, {"broker-1:5671": "broker-1:1"}
        for name, places in {
                "master.yaml": {**registry, "12904": self.api_port, "9112": free_port()},
                "gateway.yaml": {**registry, **nobody, "12905": free_port(), "9405": free_port(), fleet.PLUGINS: "/opt/iotcloud"},
                "topologies/echo.yaml": {**registry, **nobody, "9406": free_port()},
                "pool.yaml": {**registry, "12906": free_port(), "9407": free_port()},
                "registry-tunnel.conf": {"127.0.0.1:2181": f"127.0.0.1:{self.tunnel_port}", "zk1:2281": f"zk1:{self.registry_port}"}}.items():
            file = self.etc / name
            file.write_text(fleet.replaced(file.read_text(), places))
        other_end = self.out / "registry-tls.conf"
        other_end.write_text(fleet.replaced((deploy / "fleet/registry-tls.conf").read_text(), {
            "accept = 2281": f"accept = 127.0.0.1:{self.registry_port}", "connect = 127.0.0.1:2181": f"connect = {servers}",
            ETC: self.certs}))
        self.start_other_end()

    def start_other_end(self):
        self.other_end = self.spawn("registry-tls", ["/usr/bin/stunnel4", self.out / "registry-tls.conf"])

    def restart_other_end(self):
        """`systemctl restart` on zk1, which here has the list in the folder of the first step."""
        self.other_end.kill()
        self.other_end.wait()
        self.start_other_end()

    def bring(self, *files):
        """Files of the first step's folder to lab1."""
        for file in files:
            copied = self.inside("cp", self.etc / file, f"{ETC}/{file}")
            require(copied.returncode == 0, copied.stderr)

    def run_page(self, script):
        """Commands of the page on lab1. Returns what they say."""
        here = fleet.replaced(script, {"zookeeper://127.0.0.1:2181": f"zookeeper://127.0.0.1:{self.tunnel_port}"})
        done = self.inside("sh", "-e", "-c", f"PATH={self.bin}:$PATH\n{here}")
        require(done.returncode == 0, f"the page's commands fail on lab1: {done.stdout} {done.stderr}")
        return done.stdout

    def tool(self, *words):
        return subprocess.run([self.bin / "iotcloud", *words], check=True, capture_output=True, text=True, timeout=120).stdout

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
        for process in self.descendants():
            try:
                if inside != "0" and status_of(process, "NSpid")[-1] == inside:
                    return process
            except OSError:
                pass  # it has ended since it was listed
        return 0

    def workers_of_pool(self):
        """Process ids of the pool's workers."""
        return self.processes(lambda words: words[1:2] == [b"--pooled"])

    def may(self, user, *command):
        """Whether a command does its work as a daemon of this user, with the groups that its unit gives it."""
        groups = {"iotcloud-host": "--clear-groups", "iotcloud-worker": "--clear-groups",
                  "iotcloud-gateway": "--groups=iotcloud,iotcloud-host",
                  "iotcloud-pool": "--groups=iotcloud,iotcloud-worker"}.get(user, "--groups=iotcloud")
        return self.inside("setpriv", f"--reuid={user}", f"--regid={user}", groups, *command).returncode == 0

    def reads(self, user, file):
        return self.may(user, "cat", f"{ETC}/{file}")

    def thief(self, certificate, port):
        """A connection by a certificate that lab2 has."""
        context = ssl.create_default_context(cafile=self.certs / "ca.pem")
        context.load_cert_chain(self.certs / f"{certificate}.pem", self.certs / f"{certificate}.key")
        return context.wrap_socket(socket.create_connection(("127.0.0.1", port), timeout=120), server_hostname="localhost")

    def reaches_registry(self, certificate="lab2-tunnel"):
        """Whether ZooKeeper greets whoever has the certificate of a tunnel."""
        try:
            with self.thief(certificate, self.registry_port) as thief:
                thief.sendall(HELLO_REGISTRY)
                return bool(thief.recv(100))
        except OSError:  # of which errors of TLS are some
            return False

    def reads_registry(self, password):
        """Whether ZooKeeper shows the fleet's nodes to whoever has this password of the workers, and a tunnel."""
        def text(value):
            return struct.pack(">i", len(value)) + value.encode()

        with socket.create_connection(("127.0.0.1", self.tunnel_port), timeout=60) as client:
            answers = client.makefile("rb")

            def ask(request):
                client.sendall(struct.pack(">i", len(request)) + request)
                return answers.read(struct.unpack(">i", answers.read(4))[0])

            ask(HELLO_REGISTRY[4:])
            ask(struct.pack(">iii", -4, 100, 0) + text("digest") + text(f"workers:{password}"))
            answer = ask(struct.pack(">ii", 1, 8) + text("/iot/sensors") + b"\0")  # its children
            return struct.unpack(">iqi", answer[:16])[2] == 0

    def serial_number(self):
        """That of the certificate that the master shows."""
        context = ssl.create_default_context(cafile=self.certs / "ca.pem")
        context.load_cert_chain(self.certs / "operator.pem", self.certs / "operator.key")
        with socket.create_connection(("127.0.0.1", self.api_port), timeout=120) as plain, \
                context.wrap_socket(plain, server_hostname="127.0.0.1") as client:
            return client.getpeercert()["serialNumber"]


def check_work(machine):
    """Each daemon does what it could not without its files."""
    wait_for("the gateway is ready", lambda: any(gateway["state"] == "ready" for gateway in machine.json("gateways")))
    wait_for("the topology has its worker", lambda: any(topology["workers"] for topology in machine.json("topologies")))
    # The gateway follows only an order that is signed, and runs only a plugin that is.
    machine.deploy("loadgen.so", "gateway-1", {"rate": "1"})
    wait_for("the driver is active", lambda: machine.json("drivers")[0]["state"] == "active")
    with socket.create_connection(("127.0.0.1", machine.tunnel_port), timeout=120) as registry:
        registry.sendall(b"srvr")
        require(b"Mode: " in registry.makefile("rb").read(), "the tunnel does not lead to the registry")
    # The gateway and the worker show these to the master, whose tokens they know.
    require(machine.cli("logs", machine.json("drivers")[0]["instance"], "--whole-host"), "the gateway shows no log")
    worker, = machine.json("topology", "show", "echo")["workers"]
    require(worker["tls"] and worker["http"].startswith("lab1:"), worker)


def check_pool(machine, deploy):
    """A topology whose files are those that workers reach runs in the pool, to which the master shows the pool's own token."""
    wait_for("the pool is there", lambda: [pool["pool"] for pool in machine.json("topology", "pools")] == ["pool-1"])
    text = fleet.submitted((deploy / "fleet/topology.yaml").read_text(), f"{ETC}/workers")
    file = machine.out / "submitted.yaml"
    file.write_text(fleet.replaced(text, {"topology.name: echo": "topology.name: submitted", "broker-1:5671": "broker-1:1",
                                          "127.0.0.1:2181": f"127.0.0.1:{machine.tunnel_port}"}))
    machine.cli("topology", "submit", file)
    require("runs as worker" in machine.cli("topology", "logs", "submitted"), "the pool shows no log of its worker")


def check_users(machine):
    for unit, user in DAEMONS.items():
        process = machine.main_process(unit)
        require(process, f"{unit} does not run")
        number = machine.inside("id", "-u", user).stdout.strip()
        require(set(status_of(process, "Uid")) == {number} and number != "0", f"{unit} runs as {status_of(process, 'Uid')}, not as {user}")
    number = machine.inside("id", "-u", "iotcloud-host").stdout.strip()
    hosts = [status_of(process, "Uid") for process in machine.hosts_of("gateway-1")]
    require(hosts == [[number] * 4] and number != "0", f"driver hosts run as {hosts}, not as iotcloud-host")
    number = machine.inside("id", "-u", "iotcloud-worker").stdout.strip()
    workers = [status_of(process, "Uid") for process in machine.workers_of_pool()]
    require(workers == [[number] * 4] and number != "0", f"the pool's workers run as {workers}, not as iotcloud-worker")
    for starter, teller in STARTERS.items():
        connect = f"import socket; socket.socket(socket.AF_UNIX).connect('{starter}')"
        found = {user for user in USERS if machine.may(user, "python3", "-c", connect)}
        require(found == {teller}, f"{found} may have systemd start processes at {starter}, which is for {teller}")
    check_files(machine)


def check_files(machine):
    for file, readers in READERS.items():
        found = {user for user in USERS if machine.reads(user, file)}
        require(found == readers, f"{file} is read by {found}, and is for {readers}")


def ends(machine):
    """When the tokens end that the daemons take, by file and holder."""
    found = {}
    for file in TOKEN_FILES:
        listed = machine.inside(machine.bin / "iotcloud", "token", "list", "--file", f"{ETC}/{file}", "-o", "json")
        require(listed.returncode == 0, listed.stderr)
        found |= {(file, one["name"]): one["expires"] for one in json.loads(listed.stdout)}
    return found


def check_renewal(machine, bring, renew):
    """A new token and a renewed certificate count, tokens count for longer, and nothing is started again."""
    processes = {unit: machine.main_process(unit) for unit in DAEMONS}
    made = machine.inside(machine.bin / "iotcloud", "token", "add", "bob", "--role", "admin", "--certificate", "operator", "--file",
                          f"{ETC}/master-tokens")
    require(made.returncode == 0, f"no token for bob: {made.stderr}")
    machine.token = made.stdout.strip()
    wait_for("the new token counts", lambda: machine.run_cli("gateways").returncode == 0)
    for file, holder in ends(machine):
        machine.inside(machine.bin / "iotcloud", "token", "renew", holder, "--days", "1", "--file", f"{ETC}/{file}")
    soon = ends(machine)
    renewed = machine.inside("sh", "-e", "-c", f"PATH={machine.bin}:$PATH\n{renew}")
    require(renewed.returncode == 0, f"tokens are not renewed: {renewed.stderr}")
    late = ends(machine)
    require({holder for holder in soon if late[holder] <= soon[holder]} == {("master-tokens", "bob")}, f"renewed: {soon}, {late}")
    before = machine.serial_number()
    machine.tool("certs", "renew", machine.certs, "lab1-master", "--new-key")
    brought = machine.inside("sh", "-e", "-c", bring.replace("CERTS", str(machine.certs)))
    require(brought.returncode == 0, f"the certificate does not get to its daemons: {brought.stderr}")
    wait_for("the master shows the renewed certificate", lambda: machine.serial_number() != before)
    require(processes == {unit: machine.main_process(unit) for unit in DAEMONS}, "a daemon was started again")
    require(machine.reads("iotcloud-master", "master-tokens") and not machine.reads("iotcloud-gateway", "master-tokens"),
            "the file of tokens has other readers than before")


def changed_nodes(said):
    """How many nodes had other rights, by the table of `iotcloud registry rights`."""
    titles, row = said.strip().splitlines()[-2:]
    return int(row[titles.index("HAD OTHER RIGHTS"):].split()[0])


def check_stolen(machine, here, at_broker, on_lab1):
    """What the thief of lab2 has is worth nothing after the page's commands, on open connections too, and lab1 goes on."""
    open_tunnel, open_api = machine.thief("lab2-tunnel", machine.registry_port), machine.thief("lab2-gateway", machine.api_port)
    open_tunnel.sendall(HELLO_REGISTRY)
    require(open_tunnel.recv(100) and machine.reaches_registry(), "the attack: the thief is at the registry")
    as_thief = [str(word).replace("operator.", "lab2-gateway.") for word in machine.command("gateways")]

    def refusal():
        done = subprocess.run(as_thief, capture_output=True, text=True, timeout=120, check=False)
        require(done.returncode != 0, "a person's token counts with the thief's certificate")
        return done.stderr

    require("nobody's token" in refusal(), f"the attack: the master speaks with the thief, and takes no caught token: {refusal()}")
    before = machine.inside("cat", f"{ETC}/registry.users").stdout
    require("gateway gateway-2:" in before, before)

    fleet.run(here, machine.bin, machine.folder)
    fleet.run(at_broker, machine.bin, machine.folder)
    require(fleet.told_rabbitmq(machine.folder)[-2:] == [["delete_user", user, ""] for user in ("gateway-2", "gateway-2-reads")],
            f"RabbitMQ is told {fleet.told_rabbitmq(machine.folder)[-2:]}")
    machine.restart_other_end()
    machine.bring("revoked.pem", "registry.users", "workers/revoked.pem", "workers/registry.users")
    require(not open_tunnel.recv(100), "the thief's connection to the registry is open")
    wait_for("those who may are at the registry again", lambda: machine.run_cli("gateways").returncode == 0)
    require(not machine.reaches_registry(), "the thief is at the registry again")
    try:
        require(not open_api.recv(100), "the master answers the thief")
    except OSError:
        pass  # it is cut, as wanted
    wait_for("the master refuses the certificate", lambda: "no master answers" in refusal())

    said = machine.run_page(on_lab1)
    require(changed_nodes(said) > 0, f"no node had rights of gateway-2: {said}")
    wait_for("the gateway is ready again", lambda: any(gateway["state"] == "ready" for gateway in machine.json("gateways")))
    wait_for("the driver is active again", lambda: machine.json("drivers")[0]["state"] == "active")
    wait_for("the topology has its worker again", lambda: any(topology["workers"] for topology in machine.json("topologies")))


def check_stolen_worker(machine, here, at_broker, on_lab1):
    """What the thief of lab3 has is worth nothing after the page's commands, and lab1's workers go on, with other passwords."""
    machine.tool("certs", "add", machine.certs, "--host", "lab3", "--daemon", "lab3-pool", "--pool", "pool-2")
    for daemon in ("workers-of-lab3", "lab3-tunnel"):
        machine.tool("certs", "add", machine.certs, "--host", "lab3", "--daemon", daemon)
    stolen, at_rabbitmq = ((machine.etc / name).read_text().strip() for name in ("worker.password", "worker-broker.password"))
    open_tunnel = machine.thief("lab3-tunnel", machine.registry_port)
    open_tunnel.sendall(HELLO_REGISTRY)
    require(open_tunnel.recv(100) and machine.reads_registry(stolen), "the attack: the thief reads the registry")
    before = set(machine.workers_of_pool())

    fleet.run(here, machine.bin, machine.folder)
    fleet.run(at_broker, machine.bin, machine.folder)
    fresh = (machine.etc / "worker-broker.password").read_text().strip()
    require(fresh != at_rabbitmq and fleet.told_rabbitmq(machine.folder)[-2:] == [
        ["change_password", "workers", fresh], ["close_all_user_connections", "workers", "its password was stolen", ""]],
        f"RabbitMQ is told {fleet.told_rabbitmq(machine.folder)[-2:]}")
    machine.restart_other_end()
    machine.bring("revoked.pem", "registry.users", "worker.password", "pool.password", "worker-broker.password",
                  *(f"workers/{file.name}" for file in (machine.etc / "workers").iterdir()))
    require(not open_tunnel.recv(100), "the thief's connection to the registry is open")
    wait_for("those who may are at the registry again", lambda: machine.run_cli("gateways").returncode == 0)
    require(not machine.reaches_registry("lab3-tunnel"), "the thief is at the registry again")
    said = machine.run_page(on_lab1)
    require(changed_nodes(said) > 0, f"no node had rights of the workers: {said}")
    require(not machine.reads_registry(stolen), "the workers' old password counts")
    require(machine.reads_registry((machine.etc / "worker.password").read_text().strip()), "the workers' new password does not count")
    wait_for("the gateway is ready once more", lambda: any(gateway["state"] == "ready" for gateway in machine.json("gateways")))
    for topology in ("echo", "submitted"):
        wait_for(f"{topology} has its worker again", lambda topology=topology: machine.json("topology", "show", topology)["workers"])
    require(before and not before & set(machine.workers_of_pool()), f"a worker with the old passwords runs: {before}, {machine.workers_of_pool()}")
    check_files(machine)


def main():
    options = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    options.add_argument("deploy", type=Path)
    options.add_argument("build", type=Path)
    given = options.parse_args()
    require_means()
    deploy, build = given.deploy.resolve(), given.build.resolve()
    give, bring, renew, *drills = fleet.blocks(fleet.page(deploy)[1])
    out = build / "files_of_units"
    shutil.rmtree(out, ignore_errors=True)
    with Machine(out, build / "bin", build / "plugins") as machine:
        machine.zookeeper = machine.server("zookeeper")
        machine.make_files(deploy)
        known = {unit.replace("@echo", "@"): with_own_programs((deploy / "systemd" / unit.replace("@echo", "@")).read_text())
                 for unit in [*DAEMONS, *STARTED_UNITS]}
        files = [build / "bin" / program for program in ("iotcloud-master", "iotcloud-gateway", "iotcloud-driver-host",
                                                         "iotcloud-topology")]
        machine.boot(deploy / "systemd", known, list(DAEMONS), [*files, *machine.signed.iterdir()],
                     f"cp -r --preserve=mode {machine.etc} {ETC}\n{NAMES}\n({give})")
        wait_for("the master answers", lambda: machine.json("gateways"))
        check_work(machine)
        check_pool(machine, deploy)
        check_users(machine)
        check_renewal(machine, bring, renew)
        check_stolen(machine, *drills[:3])
        check_stolen_worker(machine, *drills[3:])
    print(f"{len(DAEMONS)} daemons read their files, and no others do")


if __name__ == "__main__":
    main()

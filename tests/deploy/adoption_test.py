#!/usr/bin/python3
"""A gateway that systemd runs by the shipped unit is killed: systemd starts it again, its driver host has lived on and is
adopted; when systemd stops the gateway, its host ends. systemd is the first process of a space of processes and mounts of
its own, with no unit but those given here. That takes root; who may not have such spaces skips this test.

usage: adoption_test.py UNITS BUILD_DIR [--kill-mode MODE]
"""

import argparse
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "servers"))

from private_cluster import PrivateCluster, free_port, require, wait_for  # noqa: E402

SKIPPED = 77
SYSTEMD = "/lib/systemd/systemd"
UNIT = "iotcloud-gateway.service"
GROUPS = Path("/sys/fs/cgroup")

# In its own space of mounts. What the unit calls /usr/bin, /etc/iotcloud and /var/lib is empty there but for what the
# test needs; SYSTEMD_UNIT_PATH leaves out all units of this machine.
BOOT = """
set -e
mount --make-rprivate /
mount -t proc proc /proc
for folder in /run /opt /var/lib /sys/fs/cgroup; do mount -t tmpfs -o mode=0755 tmpfs $folder; done
{groups}
mkdir /opt/units /opt/iotcloud
cp {files} /opt/iotcloud
cp {units}/* /opt/units
exec env -i container=iotcloud-test PATH=/usr/bin:/bin SYSTEMD_UNIT_PATH=/opt/units {systemd} --system --unit=test.target \\
  --log-target=console --show-status=no
"""
DROP_IN = """
[Service]
StandardError=append:/run/gateway.log
ReadWritePaths=/run
"""


def skip(why):
    print(f"SKIPPED: {why}")
    sys.exit(SKIPPED)


class Space:
    """Groups of processes (cgroups) for a systemd that is not this machine's, and the words that begin its spaces."""

    def __init__(self, name):
        self.unified = (GROUPS / "cgroup.procs").exists()
        # With version 1 there is a tree for each controller; systemd makes groups in all that it finds.
        trees = [GROUPS] if self.unified else [file.parent for file in GROUPS.glob("*/cgroup.procs") if not file.parent.is_symlink()]
        self.groups = [tree / name for tree in trees]
        if not self.groups:
            skip(f"no cgroups in {GROUPS}")
        for group in self.groups:
            try:
                group.mkdir()
            except OSError as error:
                self.remove()
                skip(f"no cgroup of its own: {error}")
            for setting in ("cpuset.cpus", "cpuset.mems"):  # without them nobody may be in the group
                if (group / setting).exists() and not self.unified:
                    (group / setting).write_text((group.parent / setting).read_text())

    def enter(self):
        """Words before a command, which make it the first process of its space, in these groups."""
        join = "; ".join(f"echo $$ >{group}/cgroup.procs" for group in self.groups)
        return ["/bin/sh", "-c", f'set -e; {join}; exec unshare --mount --pid --cgroup --uts --ipc --fork --kill-child "$@"', "sh"]

    def mounts(self):
        """Commands in its space of mounts, after which these groups are all that it sees."""
        if self.unified:
            return f"mount -t cgroup2 cgroup {GROUPS}"
        return "\n".join(f"mkdir {tree}; mount -t {kind} cgroup {tree}" for tree, kind in (
            (GROUPS / "systemd", "cgroup -o none,name=systemd"), (GROUPS / "unified", "cgroup2")) if tree.exists())

    def remove(self):
        """When all processes have ended, which the kernel does soon after the first one's end."""
        for group in self.groups:
            wait_for(f"{group} is empty", lambda group=group: self.removed(group))

    @staticmethod
    def removed(group):
        try:
            for folder, _, _ in os.walk(group, topdown=False):
                os.rmdir(folder)
        except OSError:
            return False
        return True


class Machine(PrivateCluster):
    def boot(self, units, kill_mode):
        """systemd with the gateway's unit; the programs' paths in it are other ones."""
        self.space = Space(f"iotcloud-adoption-{os.getpid()}")
        own = self.out / "units"
        own.mkdir()
        text = (units / UNIT).read_text().replace("/usr/bin/iotcloud-gateway", "/opt/iotcloud/iotcloud-gateway") \
            .replace("/etc/iotcloud/", "/opt/iotcloud/")
        if kill_mode:
            text = text.replace("KillMode=process", f"KillMode={kill_mode}")
        (own / UNIT).write_text(text + DROP_IN)
        for name in ("sysinit", "basic", "network-online", "shutdown", "umount"):
            (own / f"{name}.target").write_text("[Unit]\nDefaultDependencies=no\n")
        (own / "test.target").write_text(f"[Unit]\nDefaultDependencies=no\nWants={UNIT}\n")
        (self.out / "gateway.yaml").write_text(f"""
id: gateway-1
registry: "{self.zookeeper}"
thrift: {{host: 127.0.0.1, port: {free_port()}}}
plugins: /opt/iotcloud
state: state
brokers: {{main: {{type: rabbitmq, urls: ["amqp://127.0.0.1:1/"]}}}}
""")
        files = [self.bin / "iotcloud-gateway", self.bin / "iotcloud-driver-host", self.plugins / "loadgen.so",
                 self.out / "gateway.yaml"]
        boot = BOOT.format(files=" ".join(map(str, files)), units=own, systemd=SYSTEMD,
                           groups=self.space.mounts())
        self.spawn("systemd", [*self.space.enter(), "/bin/sh", "-c", boot])
        self.gateways = 1

    def stop(self, limit=10):
        for name, child in self.children:
            if name == "systemd":  # SIGTERM would only make it start itself again; with it all of its space ends
                child.kill()
                child.wait()
        super().stop(limit)
        if hasattr(self, "space"):
            self.space.remove()

    def gateway(self):
        """Process id of the gateway, 0 when there is none."""
        for process in self.descendants():
            try:
                if Path(f"/proc/{process}/cmdline").read_bytes().startswith(b"/opt/iotcloud/iotcloud-gateway"):
                    return process
            except OSError:
                pass  # it has ended since it was listed
        return 0

    def systemctl(self, *words):
        first = next(process for process in self.descendants() if Path(f"/proc/{process}/comm").read_text() == "systemd\n")
        return subprocess.run(["nsenter", "--target", str(first), "--mount", "--pid", "systemctl", *words], capture_output=True,
                              text=True, timeout=60, check=False, env={"PATH": "/usr/bin:/bin"})

    def driver(self):
        found = self.json("drivers")
        return found[0] if found else {"state": "not there"}


def main():
    options = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    options.add_argument("units", type=Path)
    options.add_argument("build", type=Path)
    options.add_argument("--kill-mode", help="instead of the unit's, to see this test fail")
    given = options.parse_args()
    if os.geteuid() != 0 or not Path(SYSTEMD).exists() or not shutil.which("unshare"):
        skip("root, systemd and unshare are needed")
    out = given.build.resolve() / "adoption"
    shutil.rmtree(out, ignore_errors=True)
    with Machine(out, given.build / "bin", given.build / "plugins") as machine:
        machine.start(gateways=0, brokers=[])
        machine.boot(given.units, given.kill_mode)
        machine.wait_until_ready(60)
        machine.cli("deploy", "loadgen.so", "--gateway", "gateway-1", "--property", "rate=1")
        wait_for("the driver is active", lambda: machine.driver()["state"] == "active")
        gateway, hosts, before = machine.gateway(), machine.hosts_of("gateway-1"), machine.driver()
        require(len(hosts) == 1 and gateway, f"gateway {gateway} has the hosts {hosts}")
        shown = machine.systemctl("show", UNIT, "--property=MainPID,KillMode,ActiveState")
        require("ActiveState=active" in shown.stdout, f"systemd says: {shown}")

        os.kill(gateway, signal.SIGKILL)
        wait_for("systemd starts the gateway again", lambda: machine.gateway() not in (0, gateway))
        wait_for("the gateway is ready again", lambda: machine.json("gateways")[0]["state"] == "ready")
        machine.cli("stop", before["instance"])
        wait_for("the driver follows orders", lambda: machine.driver()["state"] == "inactive")
        require(machine.hosts_of("gateway-1") == hosts, f"host {hosts} did not outlive its gateway; now there are "
                                                        f"{machine.hosts_of('gateway-1')}")
        shown = machine.systemctl("show", UNIT, "--property=NRestarts")
        require(shown.stdout.strip() == "NRestarts=1", f"systemd says: {shown}")
        machine.cli("start", before["instance"])
        wait_for("the driver is active again", lambda: machine.driver()["state"] == "active")

        stopped = machine.systemctl("stop", UNIT)
        require(stopped.returncode == 0, f"the gateway did not stop: {stopped}")
        require(not machine.gateway() and not machine.hosts_of("gateway-1"), "processes are left after the stop: "
                f"{machine.gateway()} {machine.hosts_of('gateway-1')}")
    print(f"host {hosts[0]} outlived gateway {gateway}, which systemd started again, and ended with the unit")


if __name__ == "__main__":
    main()

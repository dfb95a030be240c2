#!/usr/bin/python3
"""The shipped unit of a pool of workers, under a systemd of its own (booted.py): a topology that is submitted runs in a worker of
the pool's user, which is not root. A pool that is killed is started again, and adopts its worker. When systemd stops the pool, its
worker ends.

usage: pool_unit_test.py UNITS BUILD_DIR LIBRARY [--kill-mode MODE]
"""

import argparse
import os
import shutil
import signal
from pathlib import Path

from booted import BootedCluster, require_means, status_of, with_own_programs
from private_cluster import passing_topology, require, wait_for

UNIT = "iotcloud-pool.service"
USER = "iotcloud-topology"


class Machine(BootedCluster):
    def boot_pool(self, units, kill_mode):
        text = with_own_programs((units / UNIT).read_text()).replace("/etc/iotcloud/", "/opt/iotcloud/")
        if kill_mode:
            text = text.replace("KillMode=process", f"KillMode={kill_mode}")
        (self.out / "pool.yaml").write_text(f"""
id: pool-1
registry: "{self.zookeeper}"
registry.session_timeout: 4s
state: state
""")
        self.boot(units, {UNIT: text}, [UNIT], [self.bin / "iotcloud-topology", self.out / "pool.yaml"], "")

    def processes(self, second):
        """Process ids of iotcloud-topology whose second word is this one."""
        found = []
        for process in self.descendants():
            try:
                words = Path(f"/proc/{process}/cmdline").read_bytes().split(b"\0")
            except OSError:  # it has ended since it was listed
                continue
            if words[:2] == [b"/opt/iotcloud/iotcloud-topology", second]:
                found.append(process)
        return found

    def pool(self):
        return self.processes(b"--pool")

    def worker(self):
        return self.processes(b"--pooled")


def check_users(machine):
    number = machine.inside("id", "-u", USER).stdout.strip()
    for process in machine.pool() + machine.worker():
        require(set(status_of(process, "Uid")) == {number} and number != "0",
                f"process {process} runs as {status_of(process, 'Uid')}, not as {USER}")
        for kind in ("CapPrm", "CapEff", "CapBnd", "CapAmb"):
            require(int(status_of(process, kind)[0], 16) == 0, f"process {process} has {kind} {status_of(process, kind)}")


def main():
    options = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    options.add_argument("units", type=Path)
    options.add_argument("build", type=Path)
    options.add_argument("library", help="the component library passing.so")
    options.add_argument("--kill-mode", help="instead of the unit's, to see this test fail")
    given = options.parse_args()
    require_means()
    out = given.build.resolve() / "pool_unit"
    shutil.rmtree(out, ignore_errors=True)
    with Machine(out, given.build / "bin", given.build / "plugins") as machine:
        machine.start(gateways=0, brokers=[])
        machine.boot_pool(given.units.resolve(), given.kill_mode)
        wait_for("the pool is there", lambda: len(machine.json("topology", "pools")) == 1)
        file = passing_topology(machine, given.library)
        machine.cli("topology", "submit", file)
        pool, worker = machine.pool(), machine.worker()
        require(len(pool) == 1 and len(worker) == 1, f"pool {pool} has the workers {worker}")
        check_users(machine)

        os.kill(pool[0], signal.SIGKILL)
        wait_for("systemd starts the pool again", lambda: machine.pool() not in ([], pool))
        wait_for("it tells of its worker again", lambda: [
            place["state"] for place in machine.json("topology", "show", "echo")["places"]] == ["running"])
        require(machine.worker() == worker, f"worker {worker} did not outlive its pool; now there are {machine.worker()}")

        stopped = machine.systemctl("stop", UNIT)
        require(stopped.returncode == 0, f"the pool did not stop: {stopped}")
        require(not machine.pool() and not machine.worker(), f"left after the stop: {machine.pool()} {machine.worker()}")
    print(f"worker {worker[0]} ran as {USER}, outlived its pool, and was ended by the next one")


if __name__ == "__main__":
    main()

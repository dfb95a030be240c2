#!/usr/bin/python3
"""The shipped units of a pool of workers, under a systemd of their own (booted.py).

- With `--workers-as iotcloud-worker`: a component library runs as another user than its pool, neither of them root, and reaches
  neither the pool's key and tokens nor its process. Without it does, which shows that the attacks are some.
- A pool that is killed is started again; its worker has lived on and is adopted. A worker that hangs, which its pool has no right
  to signal, is ended and started again. When systemd stops the pool, its worker ends.

usage: pool_unit_test.py UNITS BUILD_DIR LIBRARY [--workers-as iotcloud-worker] [--kill-mode MODE]
"""

import argparse
import os
import shutil
import signal
from pathlib import Path

from booted import BootedCluster, require_means, status_of, with_own_programs
from private_cluster import passing_topology, require, wait_for

UNIT, WORKER_UNITS = "iotcloud-pool.service", ["iotcloud-worker.socket", "iotcloud-worker@.service"]
USER = "iotcloud-pool"
OWN = "worker_user: iotcloud-worker\nworker_starter: /run/iotcloud-worker"
# Of the pool: its key, its tokens, and what is in its state folder.
SECRETS = ["/opt/iotcloud/pool.key", "/opt/iotcloud/pool-tokens", "/var/lib/iotcloud-pool/state/id"]
# What comes of a library's attacks, if workers have a user of their own: in /proc it does not even see the pool.
ATTACKS = {"signal": "EPERM", "mem": "ENOENT", "environ": "ENOENT", "pool.key": "EACCES", "pool-tokens": "EACCES", "id": "EACCES"}
# If they have the pool's: only what the kernel keeps of a daemon, and shows to nobody, is out of reach.
OF_THE_SAME_USER = {**dict.fromkeys(ATTACKS, "ok"), "mem": "EACCES", "environ": "EACCES"}


class Machine(BootedCluster):
    def boot_pool(self, units, kill_mode, workers_as):
        known = {}
        for unit in [UNIT, *WORKER_UNITS]:
            text = with_own_programs((units / unit).read_text()).replace("/etc/iotcloud/", "/opt/iotcloud/")
            if kill_mode:
                text = text.replace("KillMode=process", f"KillMode={kill_mode}")
            known[unit] = text
        (self.out / "pool.yaml").write_text(f"""
id: pool-1
registry: "{self.zookeeper}"
registry.session_timeout: 4s
state: state
worker_hang_limit: 15s
{OWN if workers_as else ""}
""")
        secrets = " ".join(SECRETS[:2])
        self.boot(units, known, [UNIT], [self.bin / "iotcloud-topology", self.out / "pool.yaml"],
                  f"touch {secrets}; chmod 0600 {secrets}; chown {USER}: {secrets}")

    def topologies(self, second):
        """Process ids of iotcloud-topology whose second word is this one."""
        return self.processes(lambda words: words[:2] == [b"/opt/iotcloud/iotcloud-topology", second])

    def pool(self):
        return self.topologies(b"--pool")

    def worker(self):
        return self.topologies(b"--pooled")

    def record(self):
        """What the master says of the pool; empty while it is not there."""
        return next(iter(self.json("topology", "pools")), {})

    def running(self):
        """(since when the pool runs, since when its only place does), by the pool's record; zeros: it does not."""
        record = self.record()
        places = record.get("places", [])
        return (record["since_ms"], places[0]["since_ms"]) if [place["state"] for place in places] == ["running"] else (0, 0)

    def attacking_topology(self, library):
        """The YAML file of a topology whose library tries what it may do to the pool."""
        file = passing_topology(self, library)
        conf = f'conf: {{victim: "{status_of(self.pool()[0], "NSpid")[-1]}", secrets: "{" ".join(SECRETS)}"}}'
        file.write_text(file.read_text().replace("class: passing.Pass", f"class: passing.Pass, {conf}"))
        return file


def check_users(machine, worker_user):
    for process, user in ((machine.pool()[0], USER), (machine.worker()[0], worker_user)):
        number = machine.inside("id", "-u", user).stdout.strip()
        require(set(status_of(process, "Uid")) == {number} and number != "0",
                f"process {process} runs as {status_of(process, 'Uid')}, not as {user}")
        for kind in ("CapPrm", "CapEff", "CapBnd", "CapAmb"):
            require(int(status_of(process, kind)[0], 16) == 0, f"process {process} has {kind} {status_of(process, kind)}")


def check_attacks(machine, expected):
    """The worker's log, which the pool reads, says what came of them."""
    log = machine.cli("topology", "logs", "echo", "--place", "0")
    found = dict(line.removeprefix("tried ").split(": ") for line in log.splitlines() if line.startswith("tried "))
    require(found == expected, f"a library's attacks have the outcomes {found}, not {expected}, in {log}")


def main():
    options = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    options.add_argument("units", type=Path)
    options.add_argument("build", type=Path)
    options.add_argument("library", help="the component library passing.so")
    options.add_argument("--kill-mode", help="instead of the unit's, to see this test fail")
    options.add_argument("--workers-as", choices=["iotcloud-worker"], help="a user of their own; without: the pool's")
    given = options.parse_args()
    require_means()
    out = given.build.resolve() / ("workers_of_another_user" if given.workers_as else "pool_unit")
    shutil.rmtree(out, ignore_errors=True)
    with Machine(out, given.build / "bin", given.build / "plugins") as machine:
        machine.start(gateways=0, brokers=[])
        machine.boot_pool(given.units.resolve(), given.kill_mode, given.workers_as)
        wait_for("the pool is there", lambda: len(machine.json("topology", "pools")) == 1)
        machine.cli("topology", "submit", machine.attacking_topology(given.library))
        pool, worker = machine.pool(), machine.worker()
        require(len(pool) == 1 and len(worker) == 1, f"pool {pool} has the workers {worker}")
        check_users(machine, given.workers_as or USER)
        check_attacks(machine, ATTACKS if given.workers_as else OF_THE_SAME_USER)

        first_life = machine.record()["since_ms"]
        os.kill(pool[0], signal.SIGKILL)
        wait_for("systemd starts the pool again", lambda: machine.pool() not in ([], pool))
        # The record of the killed one says until its session ends that the worker runs.
        wait_for("its next life tells of the worker", lambda: machine.running()[0] > first_life)
        require(machine.worker() == worker, f"worker {worker} did not outlive its pool; now there are {machine.worker()}")

        since = machine.running()[1]
        os.kill(worker[0], signal.SIGSTOP)
        wait_for("a worker that hangs is ended, and another one started", lambda: machine.worker() not in ([], worker))
        wait_for("that one runs", lambda: machine.running()[1] > since)

        stopped = machine.systemctl("stop", UNIT)
        require(stopped.returncode == 0, f"the pool did not stop: {stopped}")
        require(not machine.pool() and not machine.worker(), f"left after the stop: {machine.pool()} {machine.worker()}")
    print(f"worker {worker[0]} ran as {given.workers_as or USER}, outlived its pool, and was ended by the next one")


if __name__ == "__main__":
    main()

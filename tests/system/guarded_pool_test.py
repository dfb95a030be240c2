#!/usr/bin/python3
"""A pool that other machines reach, by TLS and a token only, whose libraries and orders must be signed, and whose workers reach
the files that they need and no others: an admin submits a topology to it, and nobody else.

usage: guarded_pool_test.py BUILD_DIR LIBRARY
"""

import os
import shutil
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "servers"))

from guarded_cluster import HOST, GuardedCluster  # noqa: E402
from private_cluster import PATIENT_STOP, StartError, free_port, passing_topology, require, wait_for  # noqa: E402


class GuardedPool(GuardedCluster):
    """Master and pool ask for certificates and tokens; the pool for signatures, too."""

    of_api = 'pool_token_file: "{out}/{pool}.token"'

    def make_secrets(self):
        super().make_secrets()
        self.iotcloud("certs", "add", self.certs, "--host", HOST, "--daemon", "workers", "--pool", "pool-1")
        self.token("pool-1", "pool-tokens", "--role", "master", "--certificate", self.certs / "lab1.pem")  # the master's
        for key in ("orders", "libraries", "somebodys"):
            self.iotcloud("keys", "new", self.out / key)

    def daemon(self, program, name, configuration, **more):
        configuration += f'orders: {{signing_key: "{self.out}/orders.key", trusted_keys: ["{self.out}/orders.pub"]}}\n'
        return super().daemon(program, name, configuration, **more)

    def pool(self):
        port, file = free_port(), self.out / "pool-1.yaml"
        file.write_text(f"""id: pool-1
registry: "{self.zookeeper}"
thrift: {{host: 0.0.0.0, port: {port}, advertise: "{HOST}:{port}", {self.guarded('workers', 'pool-tokens')}}}
orders.trusted_keys: ["{self.out}/orders.pub"]
libraries.require_signature: true
libraries.trusted_keys: ["{self.out}/libraries.pub"]
state: "{self.out}/state/pool-1"
worker_files: {{read: ["{self.out}/orders.pub"]}}
audit: {{file: "{self.out}/audit.log"}}
""")
        return self.spawn("pool-1", [self.bin / "iotcloud-topology", "--pool", "--config", file, *PATIENT_STOP])


def refused(what, done, *expected):
    for words in expected:
        require(done.returncode == 1 and words in done.stdout + done.stderr, f'{what}: "{words}" is not in: {done}')
    print(f"refused: {what}")


def main():
    build = Path(sys.argv[1]).resolve()
    work = build / "guarded-pool-test"
    shutil.rmtree(work, ignore_errors=True)
    with GuardedPool(work, build / "bin", build / "plugins") as cluster:
        cluster.make_secrets()
        cluster.start(gateways=0, brokers=[])
        cluster.pool()
        wait_for("the pool is there", lambda: len(cluster.json("topology", "pools")) == 1)
        file = passing_topology(cluster, sys.argv[2], more=f'orders.trusted_keys: ["{work}/orders.pub"]')
        refused("a library without a signature", cluster.run_as("anna", "topology", "submit", file), "no pool takes", "sign")
        cluster.iotcloud("sign", work / "passing.so", "--key", work / "somebodys.key")
        refused("a library that somebody signed", cluster.run_as("anna", "topology", "submit", file), "no pool takes", "trusted")
        os.remove(work / "passing.so.sig")
        cluster.iotcloud("sign", work / "passing.so", "--key", work / "libraries.key")
        refused("a viewer's submission", cluster.run_as("vera", "topology", "submit", file), "admin")
        cluster.cli("topology", "submit", file)
        shown = cluster.json("topology", "show", "echo")
        require([place["state"] for place in shown["places"]] == ["running"], shown)
        require("topology echo runs as worker" in cluster.run_as("vera", "topology", "logs", "echo").stdout, "no log")
        cluster.cli("topology", "deactivate", "echo")  # the worker follows it: its file has the masters' key, which it reads
        require(cluster.json("topology", "list")[0]["state"] == "inactive", cluster.json("topology", "list"))
        answer = cluster.answer("topology", "kill", "echo")
        require(answer["ok"], answer)
        audit = (work / "audit.log").read_text()
        require('"offerLibrary"' in audit and "passing.so" in audit, audit)
        cluster.require_alive()
    print("a topology is submitted over TLS by those who may, with signed libraries and orders, to a confined worker")


if __name__ == "__main__":
    try:
        main()
    except StartError as error:
        sys.exit(str(error))

#!/usr/bin/python3
"""The console works on a live cluster: what it shows of real gateways, driver hosts and workers, what its acts do, and where an open
page goes when its master is killed. Leaves a picture of each page, light and dark, in build/console.

usage: live_test.py BUILD_DIR
"""
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import browser

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "servers"))

from private_cluster import PrivateCluster, echo_topology, wait_for  # noqa: E402
from private_server import free_ports  # noqa: E402


class ConsoleCluster(PrivateCluster):
    """Masters with a console each, which knows the other's."""

    def __init__(self, folder, *places):
        super().__init__(*places)
        self.folder, self.ports = Path(folder), dict(zip(("master-1", "master-2"), free_ports(2)))

    def url(self, name):
        return f"http://127.0.0.1:{self.ports[name]}/"

    def audit(self, name):
        return self.folder / f"{name}-audit.log"

    def daemon(self, program, name, configuration, *more, **options):
        if name in self.ports:
            others = [self.url(other).rstrip("/") for other in self.ports if other != name]
            configuration += f'console: {{address: "127.0.0.1:{self.ports[name]}", others: {json.dumps(others)}}}\n' \
                             f'audit: {{file: "{self.audit(name)}"}}\n'
        return super().daemon(program, name, configuration, *more, **options)


def main():
    build = Path(sys.argv[1]).resolve()
    shutil.rmtree(build / "console_live", ignore_errors=True)  # an earlier run's fleet
    with tempfile.TemporaryDirectory(prefix="iotcloud-console-") as folder, \
            ConsoleCluster(folder, build / "console_live", build / "bin", build / "plugins") as cluster:
        tokens_file = Path(folder) / "tokens"
        tokens = {name: subprocess.run([build / "bin/iotcloud", "token", "add", name, "--role", role, "--file", tokens_file], check=True,
                                       capture_output=True, text=True).stdout.strip()
                  for name, role in (("anna", "admin"), ("vera", "viewer"))}
        os.environ["IOTCLOUD_TOKEN"] = tokens["anna"]  # of the command line
        cluster.start(masters=2, of_api=f", tokens: {tokens_file}")
        wait_for("the gateways are ready", lambda: [one["state"] for one in cluster.json("gateways")] == ["ready", "ready"])
        cluster.cli("deploy", "loadgen.so", "--all", "--name", "meter", "--count", 3, "--property", "rate=20", "--metadata", "site=lab")
        cluster.topology("echo", echo_topology(bolts=2, more='metrics: {address: "127.0.0.1:0"}'))

        def leading():
            """The name of the master that leads: one that does not knows its address."""
            master = cluster.json("status")["master"]
            address = master["address"] if master["leading"] else master["leader"]
            return next((name for name in cluster.ports if address.endswith(f":{cluster.apis[name]}")), "")

        wait_for("a master leads", leading)
        leader = leading()
        other, = set(cluster.ports) - {leader}

        def do(words):
            if words[0] == "state":
                return next(one["state"] for one in cluster.json("drivers", words[1]) if one["gateway"] == words[2])
            if words == ["audit"]:
                return [json.loads(line) for line in cluster.audit(leader).read_text().splitlines()]
            if words == ["kill"]:
                cluster.end(leader, signal.SIGKILL)
            return None

        browser.run_script("live.mjs", {"url": cluster.url(leader), "other": cluster.url(other), "leader": leader, "tokens": tokens}, do)


if __name__ == "__main__":
    main()

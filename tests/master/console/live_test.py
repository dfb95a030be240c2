#!/usr/bin/python3
"""The console works on a live cluster: what it shows of real gateways, driver hosts and workers, and what its acts do. Leaves
a picture of each page, light and dark, in build/console.

usage: live_test.py BUILD_DIR
"""
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import browser

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "servers"))

from private_cluster import PrivateCluster, echo_topology, wait_for  # noqa: E402
from private_server import free_ports  # noqa: E402


def main():
    build = Path(sys.argv[1]).resolve()
    shutil.rmtree(build / "console_live", ignore_errors=True)  # an earlier run's fleet
    with tempfile.TemporaryDirectory(prefix="iotcloud-console-") as folder, \
            PrivateCluster(build / "console_live", build / "bin", build / "plugins") as cluster:
        port, = free_ports(1)
        tokens_file, audit = Path(folder) / "tokens", Path(folder) / "audit.log"
        tokens = {name: subprocess.run([build / "bin/iotcloud", "token", "add", name, "--role", role, "--file", tokens_file], check=True,
                                       capture_output=True, text=True).stdout.strip()
                  for name, role in (("anna", "admin"), ("vera", "viewer"))}
        os.environ["IOTCLOUD_TOKEN"] = tokens["anna"]  # of the command line
        cluster.start(of_masters=f'console: {{address: "127.0.0.1:{port}"}}\naudit: {{file: "{audit}"}}', of_api=f", tokens: {tokens_file}")
        wait_for("the gateways are ready", lambda: [one["state"] for one in cluster.json("gateways")] == ["ready", "ready"])
        cluster.cli("deploy", "loadgen.so", "--all", "--name", "meter", "--count", 3, "--property", "rate=20", "--metadata", "site=lab")
        cluster.topology("echo", echo_topology(bolts=2, more='metrics: {address: "127.0.0.1:0"}'))

        def do(words):
            if words[0] == "state":
                return next(one["state"] for one in cluster.json("drivers", words[1]) if one["gateway"] == words[2])
            if words == ["audit"]:
                return [json.loads(line) for line in audit.read_text().splitlines()]
            return None

        browser.run_script("live.mjs", {"url": f"http://127.0.0.1:{port}/", "tokens": tokens}, do)


if __name__ == "__main__":
    main()

#!/usr/bin/python3
"""One gateway with every kind of broker at once, each behind TLS, client certificate, user and password. Its driver hosts
may connect to the brokers only, by the names in their URLs.

usage: secured_brokers_test.py BUILD_DIR

A load generator on each broker gets everything back, once and in order, and nobody has written the password anywhere.
Exit status 77: skipped, because a server cannot be had.
"""

import json
import os
import shutil
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "servers"))

import certificates  # noqa: E402
from private_cluster import PrivateCluster, Unavailable  # noqa: E402

COUNT, RATE = 500, 100
SKIPPED = 77
KINDS = ["rabbitmq", "kafka", "activemq"]
TOPOLOGY = """
zk.servers: ["{{zookeeper}}"]
topology.name: "echo_{name}"
brokers:
{brokers}
spouts:
  receive: {{broker: {name}, driver: loadgen, channel: data, fields: [data, driverID, time]}}
bolts:
  send: {{broker: {name}, driver: loadgen, channel: echo, fields: [data, driverID, time], inputs: {{from: receive}}}}
"""


def broker_lines(cluster, kind, password_file):
    """YAML of one logical broker, `my_<kind>`."""
    url = cluster.server(kind, "--tls")
    files = cluster.out / kind
    return [f"my_{kind}:", f"  type: {kind}", f'  urls: ["{url}"]', f"  user: {certificates.USER}",
            f"  password_file: {password_file}",
            f"  tls: {{ca: {files / 'ca.pem'}, certificate: {files / 'client.pem'}, key: {files / 'client.key'}}}"]


def result_of(report):
    """The driver's report; None until it is written, when every message is back."""
    text = report.read_text() if report.exists() else ""
    return json.loads(text) if text.rstrip().endswith("}") else None


def said(file):
    """What a file of /proc says; empty if its process has ended."""
    try:
        return file.read_text(errors="replace")
    except OSError:
        return ""


def wait_for(what, condition, limit):
    deadline = time.monotonic() + limit
    while not condition():
        if time.monotonic() > deadline:
            sys.exit(f"not within {limit} s: {what}")
        time.sleep(0.1)


def confined(cluster, folder):
    """Lines of the gateway's configuration with which its hosts connect to the brokers only. If this is root they run as
    another user, who must be able to read what they need and to write to `folder`."""
    folder.mkdir()
    lines = f"host_files: {{write: [{folder}]}}\nhost_network: {{all: []}}\n"
    if os.geteuid() != 0:
        return lines
    folder.chmod(0o777)
    for path in [cluster.out, cluster.out / "password", *(cluster.out / kind for kind in KINDS),
                 *(cluster.out / kind / "client.key" for kind in KINDS)]:
        path.chmod(path.stat().st_mode | 0o055 if path.is_dir() else 0o644)
    return lines + "host_user: nobody\n"


def run(work, build):
    with PrivateCluster(work, build / "bin", build / "plugins") as cluster:
        password_file = work / "password"
        password_file.write_text(certificates.PASSWORD + "\n")
        brokers = {kind: broker_lines(cluster, kind, password_file) for kind in KINDS}
        reports_folder = work / "reports"
        cluster.start(gateways=1, brokers=[line for lines in brokers.values() for line in lines],
                      more=confined(cluster, reports_folder))
        for kind, lines in brokers.items():
            own = "\n".join("  " + line for line in lines if "type:" not in line)
            cluster.topology(f"worker-{kind}", TOPOLOGY.format(name=f"my_{kind}", brokers=own))
        cluster.wait_until_ready()
        reports = {kind: reports_folder / f"{kind}.json" for kind in KINDS}
        for kind, report in reports.items():
            cluster.deploy("loadgen.so", "gateway-1", {
                "count": COUNT, "rate": RATE, "report": report, "broker": f"my_{kind}", "shared": str(kind == "kafka").lower()})
        wait_for("every driver has everything back", lambda: all(map(result_of, reports.values())), 180)
        connectors = [int(comm.parent.name) for comm in Path("/proc").glob("[0-9]*/comm")
                      if said(comm) == "connector\n" and str(work) in said(comm.parent / "cmdline")]
        if len(connectors) != 1:
            sys.exit(f"the driver host has not one connector: {connectors}")
        cluster.require_alive()
        for kind, report in reports.items():
            result = result_of(report)
            wrong = {key: result[key] for key in ("lost", "duplicated", "out_of_order", "damaged", "foreign") if result[key]}
            if wrong or result["sent"] != COUNT:
                sys.exit(f"over {kind}: {wrong or result}")
        described = cluster.cli("drivers", "-o", "json")
    for name, text in [(file.name, file.read_text(errors="replace")) for file in work.glob("**/*.log")] + [("drivers", described)]:
        if certificates.PASSWORD in text:
            sys.exit(f"the password stands in {name}")
    print(f"{len(KINDS)} brokers x {COUNT} messages behind TLS, all back in order")


def main():
    build = Path(sys.argv[1]).resolve()
    work = build / "secured-brokers"
    shutil.rmtree(work, ignore_errors=True)
    try:
        run(work, build)
    except Unavailable as reason:
        print(reason)
        sys.exit(SKIPPED)


if __name__ == "__main__":
    main()

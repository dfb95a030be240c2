#!/usr/bin/python3
"""Two workers of a topology over real servers, driven by every command of `iotcloud topology`.

usage: control_test.py BUILD_DIR
"""

import json
import shutil
import signal
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "servers"))

from private_cluster import (PATIENT_STOP, PrivateCluster, StartError, echo_topology, require, result_of,  # noqa: E402
                             wait_for)

TOPOLOGY = echo_topology(bolts=3)
RATE = 50  # messages a second of each driver


# What only messages change; the capacity that a component used is measured anew now and then, for example.
COUNTS = ("emitted", "transferred", "executed", "acked", "failed", "timed_out", "late", "superseded", "errors")


def counts(sums):
    return {component: [entry[name] for name in COUNTS] for component, entry in sums.items()}


class Control:
    """`iotcloud topology` on a cluster."""

    def __init__(self, cluster):
        self.cluster = cluster
        self.reports = []  # of all drivers

    def command(self, *words):
        return self.cluster.command("topology", *words)

    def json(self, *words):
        return self.cluster.json("topology", *words)

    def refusal(self, *words):
        """(exit status, error text)"""
        done = subprocess.run(self.command(*words), capture_output=True, text=True, timeout=120)
        return done.returncode, done.stderr

    def load(self, seconds):
        """Deploys a driver that sends for so long. On a busy machine the drivers of before may have sent all by now."""
        report = self.cluster.out / f"report-{len(self.reports)}.json"
        self.reports.append(report)
        self.cluster.deploy("loadgen.so", "gateway-1", {"count": seconds * RATE, "rate": RATE, "report": report})

    def sums(self):
        return {entry["component"]: entry["sum"] for entry in self.json("metrics", "echo")["components"]}

    def quiet_sums(self):
        """The sums, once nothing is under way. Call it when nothing new comes."""
        found = {}

        def nothing_is_under_way():
            found.update(self.sums())
            return not any(entry[what] for entry in found.values() for what in ("pending", "queue_depth"))

        wait_for("nothing is under way", nothing_is_under_way)
        return found


def check_pause(control):
    wait_for("messages flow", lambda: control.sums()["send"]["executed"] > 0)
    answer = control.json("deactivate", "echo")
    require([o["outcome"] for o in answer["outcomes"]] == ["done", "done"], answer)
    require(control.json("list")[0]["state"] == "inactive", control.json("list"))
    paused = control.quiet_sums()
    for driver in control.cluster.json("drivers"):  # they go on sending; no message may come through
        control.cluster.cli("channel", "echo", driver["instance"], "data", "-n", 25)
    before, now = counts(paused), counts(control.sums())
    require(now == before, f"messages went through an inactive topology: {before}, then {now}")
    return paused


def check_late_worker(control, cluster):
    """A worker that starts while the topology is inactive obeys too."""
    late = cluster.topology("worker-3", TOPOLOGY, PATIENT_STOP)
    wait_for("a third worker is inactive", lambda: [w["state"] for w in control.json("show", "echo")["workers"]] ==
             ["inactive"] * 3)
    late.send_signal(signal.SIGTERM)
    require(late.wait(120) == 0, "the third worker did not stop in order")
    cluster.children = [entry for entry in cluster.children if entry[1] is not late]
    wait_for("two workers are left", lambda: len(control.json("list")[0]["workers"]) == 2)


def check_resume(control, paused):
    control.json("activate", "echo")
    wait_for("messages flow again", lambda: control.sums()["send"]["executed"] > paused["send"]["executed"])


def check_rebalance(control):
    control.json("rebalance", "echo", "send=1")
    component = {c["id"]: c for c in control.json("show", "echo")["components"]}["send"]
    require((component["parallelism"], component["tasks"]) == (2, 6), component)  # of both workers
    status, complaint = control.refusal("rebalance", "echo", "send=4")
    require(status == 1 and "1 to 3" in complaint, complaint)
    status, complaint = control.refusal("rebalance", "echo", "sned=2")
    require(status == 1 and "send (1 to 3)" in complaint, complaint)
    status, complaint = control.refusal("activate", "ehco")
    require(status == 1 and "there are echo" in complaint, complaint)
    status, complaint = control.refusal("rebalance", "echo", "send=none")
    require(status == 2, complaint)
    control.load(10)
    before = control.sums()["send"]["executed"]
    wait_for("messages flow with another parallelism", lambda: control.sums()["send"]["executed"] > before)


def check_tap(control):
    control.load(15)
    at_sink = subprocess.Popen(control.command("tap", "echo", "send"), stdout=subprocess.PIPE, text=True)
    out = subprocess.run(control.command("tap", "echo", "receive", "--count", "3", "-o", "json"), capture_output=True,
                         text=True, timeout=120)
    samples = [json.loads(line) for line in out.stdout.splitlines()]
    require(out.returncode == 0 and len(samples) == 3, out)
    for sample in samples:
        require(sample["source"] == "receive" and sample["stream"] == "default", sample)
        require(sample["fields"]["data"]["bytes"] > 0 and sample["fields"]["driverID"], sample)
    status, complaint = control.refusal("tap", "echo", "recieve")
    require(status == 1 and "recieve" in complaint, complaint)

    # At a sink the tap shows the input; Ctrl-C ends it in order.
    line = at_sink.stdout.readline()
    require("receive/default" in line and "driverID=" in line, line)
    at_sink.send_signal(signal.SIGINT)
    at_sink.communicate(timeout=120)
    require(at_sink.returncode == 0, f"tap ended with {at_sink.returncode} at Ctrl-C")


def check_counts(control, cluster):
    """When every message is back, each component has counted every message once."""
    wait_for("the drivers have everything back", lambda: all(
        result_of(report) for report in control.reports))
    sent = sum(result_of(report)["sent"] for report in control.reports)
    sums = control.quiet_sums()
    for what in ("emitted", "acked"):
        require(sums["receive"][what] == sent, f"{what} {sums['receive'][what]} of {sent}")
    for what in ("executed", "acked"):
        require(sums["send"][what] == sent, f"{what} {sums['send'][what]} of {sent}")
    require(sums["send"]["execute"]["count"] > 0, sums["send"])
    table = cluster.cli("topology", "metrics", "echo")
    require("EXECUTE p50/p99/max" in table and str(sent) in table, table)


def check_check(control, work):
    good, bad = work / "worker-1.yaml", work / "bad.yaml"
    bad.write_text(good.read_text().replace("driverID]}]", "driverId]}]"))
    done = subprocess.run(control.command("check", good), capture_output=True, text=True, timeout=120)
    require(done.returncode == 0 and "receive" in done.stdout, done)
    status, complaint = control.refusal("check", bad)
    require(status == 2 and "driverId" in complaint and "bad.yaml" in complaint, complaint)


def check_kill(control, cluster, workers):
    answer = control.json("kill", "echo", "--drain", "20")
    require([o["outcome"] for o in answer["outcomes"]] == ["done", "done"], answer)
    for worker in workers:
        require(worker.wait(120) == 0, f"a killed worker ended with {worker.returncode}")
    cluster.children = [entry for entry in cluster.children if entry[1] not in workers]
    # A worker leaves the registry as it ends, and does not wait for its answer for long.
    wait_for("the topology is gone", lambda: control.json("list") == [])
    again = cluster.topology("worker-again", TOPOLOGY)
    wait_for("a later start is active", lambda: [t["state"] for t in control.json("list")] == ["active"])
    require(again.poll() is None, "a later start was killed as well")


def main():
    build = Path(sys.argv[1]).resolve()
    work = build / "control-test"
    shutil.rmtree(work, ignore_errors=True)
    with PrivateCluster(work, build / "bin", build / "plugins") as cluster:
        cluster.start(gateways=1)
        workers = [cluster.topology(f"worker-{number}", TOPOLOGY, PATIENT_STOP) for number in (1, 2)]
        cluster.wait_until_ready()
        control = Control(cluster)
        wait_for("two workers are active", lambda: [w["state"] for w in control.json("show", "echo")["workers"]] ==
                 ["active"] * 2)
        for _ in range(2):
            control.load(30)
        paused = check_pause(control)
        check_late_worker(control, cluster)
        check_resume(control, paused)
        check_rebalance(control)
        check_tap(control)
        check_check(control, work)
        check_counts(control, cluster)
        cluster.require_alive()
        check_kill(control, cluster, workers)
    print("list, show, activate, deactivate, rebalance, metrics, tap and kill did what they say")


if __name__ == "__main__":
    try:
        main()
    except StartError as error:
        sys.exit(str(error))

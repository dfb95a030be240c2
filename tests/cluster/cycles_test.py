#!/usr/bin/python3
"""A driver is deployed and undeployed again and again, once into a host that stays and once into a host of its own that
ends with it. File descriptors, threads and memory of the gateway, of the host that stays and of the master are flat: the
last fifth of the cycles beside the fifth in the middle. Of instances with durable channels no queue is left.

usage: cycles_test.py BUILD_DIR [--cycles N]
"""

import argparse
import json
import shutil
import statistics
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "servers"))

from master_api import MasterApi, compile_idl  # noqa: E402
from private_cluster import PrivateCluster, children_of, echo_topology, require, wait_for  # noqa: E402

# A short-lived connection or thread may exist while they are counted.
MORE = {"descriptors": 2, "threads": 2}
DURABLE = 15  # instances with durable channels
GROWTH_MB, GROWTH = 1.0, 0.03  # of memory: allocators settle slowly; the larger of both


def measure(process):
    folder = Path("/proc", str(process))
    anonymous = next(line for line in (folder / "status").read_text().splitlines() if line.startswith("RssAnon:"))
    return {"descriptors": len(list((folder / "fd").iterdir())), "threads": len(list((folder / "task").iterdir())),
            "memory MB": int(anonymous.split()[1]) / 1024}


def host_process(gateway):
    """The only driver host of that gateway: the gateway's child, in a process group of its own."""
    found = children_of(gateway)
    return found[0] if len(found) == 1 else None


def judge(name, samples):
    """Prints and judges the samples of one process, taken after each cycle. Returns the errors."""
    fifth, wrong = len(samples) // 5, []
    middle, tail = samples[2 * fifth:3 * fifth], samples[-fifth:]
    for figure in samples[0]:
        before, after = (statistics.median(sample[figure] for sample in part) for part in (middle, tail))
        allowed = MORE.get(figure, max(GROWTH_MB, GROWTH * before))
        print(f"{name}: {figure}: {before:.4g} in the middle, {after:.4g} in the end, {allowed:.2g} more are allowed")
        if after - before > allowed:
            wrong.append(f"{name}: {figure}")
    return wrong


def durable_queues(cluster):
    """How many the broker has."""
    server = dict(cluster.children)["rabbitmq"]
    server.stdin.write("queues\n")
    server.stdin.flush()
    return int(server.stdout.readline().removeprefix("QUEUES "))


def leave_no_queues(cluster, api):
    """Deploys instances with durable channels of their own, which a topology reads, and undeploys them."""
    cluster.topology("echo", echo_topology())
    cluster.wait_until_ready()
    silent = {"rate": "0.01", "channel.data.durable": "true", "channel.echo.durable": "true"}
    instances = [instance for _ in range(DURABLE) for instance in api.deploy("loadgen.so", "gateway-1", silent)]
    wait_for("each instance has two durable queues", lambda: durable_queues(cluster) == 2 * DURABLE)
    api.undeploy(instances)
    wait_for("no durable queue is left", lambda: durable_queues(cluster) == 0)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("build", type=Path)
    parser.add_argument("--cycles", type=int, default=50)
    given = parser.parse_args()
    build = given.build.resolve()
    work = build / "cycles"
    shutil.rmtree(work, ignore_errors=True)
    compile_idl(build)
    with PrivateCluster(work, build / "bin", build / "plugins") as cluster:
        cluster.start(gateways=1, more="host_debugging: true")  # so that the hosts' user may read /proc
        wait_for("the gateway is ready", lambda: [
            gateway["state"] for gateway in json.loads(cluster.cli("gateways", "-o", "json"))] == ["ready"])
        cluster.deploy("loadgen.so", "gateway-1", {"rate": 1})
        processes = {name: child.pid for name, child in cluster.children if name in ("master", "gateway-1")}

        def host_runs():
            processes["driver host"] = host_process(processes["gateway-1"])
            return processes["driver host"]

        wait_for("the host runs", host_runs)
        samples = {name: [] for name in processes}

        def only_the_host_that_stays():
            return host_process(processes["gateway-1"]) == processes["driver host"]

        def gateway_closed_what_it_held():
            return measure(processes["gateway-1"])["descriptors"] <= at_first + MORE["descriptors"]

        at_first = measure(processes["gateway-1"])["descriptors"]
        api = MasterApi(cluster.apis["master"], 60)
        began = time.monotonic()
        for number in range(given.cycles):
            for properties in ({"rate": "50"}, {"rate": "50", "isolation": "instance"}):
                instances = api.deploy("loadgen.so", "gateway-1", properties)
                api.undeploy(instances)
            # The host of the removed instance may still be ending, and the gateway has yet to close what it held of it.
            wait_for("only the host that stays is left", only_the_host_that_stays)
            wait_for("the gateway closed what it held of the other", gateway_closed_what_it_held)
            for name, process in processes.items():
                samples[name].append(measure(process))
        took = time.monotonic() - began
        leave_no_queues(cluster, api)
        api.close()
        cluster.require_alive()
        require(len(json.loads(cluster.cli("drivers", "-o", "json"))) == 1, "drivers are left over")
    print(f"{given.cycles} cycles of two deployments in {took:.0f} s")
    wrong = [text for name in samples for text in judge(name, samples[name])]
    if wrong:
        sys.exit("not flat: " + ", ".join(wrong))


if __name__ == "__main__":
    main()

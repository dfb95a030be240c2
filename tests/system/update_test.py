#!/usr/bin/python3
"""A driver's plugin is sent through the master, updated to another version gateway by gateway, by a command and by a
manifest, and goes back by itself when the new one does not come up; messages flow through a topology before and after. A
gateway that requires signatures refuses what is not signed by a key that it trusts, and a gateway that is killed runs
what was sent when it returns.

usage: update_test.py BUILD_DIR
"""

import hashlib
import os
import shutil
import signal
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "servers"))

from private_cluster import PrivateCluster, StartError, answer_of, echo_topology, require, wait_for  # noqa: E402
from private_server import freeze  # noqa: E402

def sha256(file):
    return hashlib.sha256(file.read_bytes()).hexdigest()


class Plugins:
    """Versions of a driver that do the same: the bytes appended to a library are never read."""

    def __init__(self, folder, build):
        self.folder, self.build = folder, build

    def version(self, name):
        file = self.folder / f"loadgen-{name}.so"
        file.write_bytes((self.build / "plugins" / "loadgen.so").read_bytes() + name.encode())
        return file

    def broken(self):
        file = self.folder / "loadgen-broken.so"
        file.write_bytes(b"this is no library")
        return file


class Fleet(PrivateCluster):
    def drivers(self):
        return {driver["instance"]: driver for driver in self.json("drivers")}

    def start_anew(self, gateway):
        """Ends a gateway in order, and starts it with what its file says now."""
        former = self.gateway_record(gateway)
        self.end(gateway, signal.SIGTERM)
        self.again(gateway)
        self.wait_for_next_life(gateway, former)

    def all_run(self, file, instances):
        drivers = self.drivers()
        require(set(drivers) == set(instances), f"the instances are others: {drivers}")
        return all(driver["state"] == "active" and driver["plugin"]["sha256"] == sha256(file)
                   for driver in drivers.values())

    def check_flow(self, when):
        """Every instance's messages come through the topology and back."""
        before = received(self.json("topology", "metrics", "echo"))
        wait_for(f"messages flow {when}", lambda: received(self.json("topology", "metrics", "echo")) > before + 20)


def received(metrics):
    return {entry["component"]: entry["sum"] for entry in metrics["components"]}["send"]["executed"]


def check_update(fleet, plugins, instances):
    fleet.check_flow("before the update")
    second = plugins.version("two")
    before = fleet.drivers()
    begun = time.monotonic()
    done = fleet.run_cli("update", "--plugin", second, "--driver", "loadgen")
    took = time.monotonic() - begun
    require(done.returncode == 0, f"the update failed: {done}")
    require(fleet.all_run(second, instances), fleet.drivers())
    for instance, driver in fleet.drivers().items():
        require(driver["metadata"] == before[instance]["metadata"], driver)
        require(driver["plugin"]["file"] == second.name, driver)
    fleet.check_flow("after the update")
    print(f"updated {len(instances)} instances on 2 gateways, one after the other, in {took:.1f} s")
    return second


def check_going_back(fleet, plugins, instances, second):
    begun = time.monotonic()
    done = fleet.run_cli("update", "--plugin", plugins.broken(), "--all", "--at-once", "2")
    took = time.monotonic() - begun
    require(done.returncode == 1, f"an update to no library succeeded: {done}")
    require("back on loadgen-two.so" in done.stdout and "gateway-1" in done.stdout, done.stdout)
    require("not begun" in done.stdout, done.stdout)
    wait_for("all run the version before again", lambda: fleet.all_run(second, instances))
    fleet.check_flow("after the update that went back")
    print(f"an update whose first step failed was back after {took:.1f} s")


def check_later_failure(fleet, plugins, instances, second):
    """gateway-1 runs the new version already when it does not come up on gateway-2: both go back."""
    name = "loadgen-next.so"
    shutil.copy(plugins.version("next"), fleet.plugins / name)
    damaged = plugins.folder / "damaged"
    damaged.mkdir()
    (damaged / name).write_bytes(b"this is no library")
    file = fleet.out / "gateway-2.yaml"
    file.write_text(file.read_text().replace(f'plugins: "{fleet.plugins}"', f'plugins: "{damaged}"'))
    fleet.start_anew("gateway-2")
    begun = time.monotonic()
    outcomes = fleet.answer("update", "--plugin", name, "--all")["outcomes"]
    took = time.monotonic() - begun
    for outcome in outcomes:
        require(outcome["outcome"] == "failed" and "back on loadgen-two.so" in outcome["reason"], outcome)
    updated = [outcome["gateway"] for outcome in outcomes if "the update failed, " in outcome["reason"]]
    require(updated == ["gateway-1"] * 2, f"gateway-1 was not updated before gateway-2 failed: {outcomes}")
    wait_for("all run the version before again", lambda: fleet.all_run(second, instances))
    fleet.check_flow("after the update whose second step failed")
    print(f"an update whose second step failed was back after {took:.1f} s, with the 2 instances of the first step")


def check_restart(fleet, instances, second):
    """A gateway whose machine lost its power, with its hosts, runs the sent plugin when it returns."""
    wait_for("the host of the version before has ended", lambda: len(fleet.hosts_of("gateway-1")) == 1)
    hosts = fleet.hosts_of("gateway-1")
    freeze(dict(fleet.children)["gateway-1"])  # it does not start its host again
    os.kill(hosts[0], signal.SIGKILL)
    fleet.end("gateway-1", signal.SIGKILL)
    before = {instance: driver["since_ms"] for instance, driver in fleet.drivers().items()}
    begun = time.monotonic()
    fleet.again("gateway-1")

    def started_again():
        drivers = fleet.drivers()
        return all(driver["since_ms"] > before[instance] for instance, driver in drivers.items()
                   if driver["gateway"] == "gateway-1") and fleet.all_run(second, instances)

    wait_for("another host runs what was sent", started_again)
    require(fleet.hosts_of("gateway-1") not in ([], hosts), "gateway-1 has its former host")
    print(f"a gateway that lost its power ran what was sent again after {time.monotonic() - begun:.1f} s")
    fleet.check_flow("after the restart of a gateway")


def check_manifest(fleet, plugins):
    """A manifest orders a file by its content."""
    file = plugins.version("manifest")
    manifest = plugins.folder / "fleet.yaml"
    manifest.write_text(f"fleet: lab\ndeployments:\n  meter: {{plugin: ./{file.name}, gateways: all, count: 2, "
                        "properties: {rate: 5}}\n")
    require(fleet.run_cli("diff", "-f", manifest).returncode == 4, "diff does not say what is missing")
    fleet.cli("apply", "-f", manifest)
    ids = set(fleet.drivers())
    require(len(ids) == 4 and fleet.all_run(file, ids), fleet.drivers())
    require(fleet.run_cli("diff", "-f", manifest).returncode == 0, "something differs after apply")
    first = file.read_bytes()
    file.write_bytes(first + b"changed")
    shown = fleet.run_cli("diff", "-f", manifest)
    require(shown.returncode == 4 and sha256(file)[:12] in shown.stdout, shown)
    begun = time.monotonic()
    fleet.cli("apply", "-f", manifest)
    require(fleet.all_run(file, ids), fleet.drivers())
    require(fleet.run_cli("diff", "-f", manifest).returncode == 0, "something differs after the second apply")
    print(f"a manifest sent a plugin to 2 gateways, and in {time.monotonic() - begun:.1f} s its next version, under the ids "
          "of 4 instances")
    check_manifest_going_back(fleet, file, manifest, ids)


def check_manifest_going_back(fleet, file, manifest, ids):
    """A version that does not become active: those of gateway-1 go back, and those of gateway-2 never see it."""
    good, good_sha256 = file.read_bytes(), sha256(file)

    def all_are_back():
        return set(fleet.drivers()) == ids and all(
            driver["state"] == "active" and driver["plugin"]["sha256"] == good_sha256 for driver in fleet.drivers().values())

    file.write_bytes(b"this is no library")
    began = {instance: driver["since_ms"] for instance, driver in fleet.drivers().items() if driver["gateway"] == "gateway-2"}
    done = fleet.run_cli("apply", "-f", manifest)
    require(done.returncode == 1 and f"back on {file.name} ({good_sha256[:12]})" in done.stdout, done)
    require("gateway-2  meter/1  update  failed   not begun" in done.stdout, done)
    require(all_are_back(), fleet.drivers())
    require(all(fleet.drivers()[instance]["since_ms"] == since for instance, since in began.items()),
            "gateway-2 had to do with an update that failed on gateway-1")
    print(f"a manifest's plugin that is no library: apply ended with {done.returncode}, and all run the version before:")
    print(done.stdout + done.stderr, end="")
    require(fleet.run_cli("diff", "-f", manifest).returncode == 4, "diff says nothing after an apply that went back")
    file.write_bytes(good)
    require(fleet.run_cli("diff", "-f", manifest).returncode == 0, "something differs after going back")


def check_signatures(fleet, plugins):
    """gateway-2 requires signatures."""
    key = plugins.folder / "lab"
    fleet.cli("keys", "new", key)
    name = "gateway-2"
    file = fleet.out / f"{name}.yaml"
    file.write_text(file.read_text() + f'plugins.require_signature: true\nplugins.trusted_keys: ["{key}.pub"]\n')
    fleet.start_anew(name)
    third = plugins.version("three")
    done = fleet.run_cli("deploy", "--plugin", third, "--gateway", name, "--property", "rate=5")
    require(done.returncode == 1 and "is not signed" in done.stdout, done)
    done = fleet.run_cli("deploy", "loadgen-next.so", "--gateway", name, "--property", "rate=5")
    require(done.returncode == 1 and "is not signed" in done.stdout, done)
    fleet.cli("sign", third, "--key", f"{key}.key")
    answer = fleet.json("deploy", "--plugin", third, "--gateway", name, "--property", "rate=5")
    described = answer_of("it is described", lambda: fleet.cli("describe", answer["outcomes"][0]["instance"]))
    require("signed by lab" in described and sha256(third)[:12] in described, described)
    third.write_bytes(third.read_bytes() + b"changed after it was signed")
    done = fleet.run_cli("update", "--plugin", third, answer["outcomes"][0]["instance"])
    require(done.returncode == 1 and "changed after it was signed" in done.stdout, done)


def main():
    build = Path(sys.argv[1]).resolve()
    work = build / "update-test"
    shutil.rmtree(work, ignore_errors=True)
    shared = work / "plugins"  # the gateways' folder
    shared.mkdir(parents=True)
    shutil.copy(build / "plugins" / "loadgen.so", shared)
    with Fleet(work, build / "bin", shared) as fleet:
        fleet.start(gateways=2)
        fleet.topology("echo", echo_topology())
        fleet.wait_until_ready()
        plugins = Plugins(work, build)
        first = plugins.version("one")
        answer = fleet.json("deploy", "--plugin", first, "--all", "--count", "2", "--property", "rate=50", "--metadata",
                            "site=lab")
        instances = [outcome["instance"] for outcome in answer["outcomes"]]
        require(len(instances) == 4 and fleet.all_run(first, instances), answer)
        second = check_update(fleet, plugins, instances)
        check_going_back(fleet, plugins, instances, second)
        check_later_failure(fleet, plugins, instances, second)
        check_restart(fleet, instances, second)
        fleet.undeploy_all()
        check_manifest(fleet, plugins)
        fleet.undeploy_all()
        check_signatures(fleet, plugins)
        fleet.undeploy_all()
        fleet.require_alive()
    print("plugins were sent, updated, taken back, found again after a restart, and refused without a signature")


if __name__ == "__main__":
    try:
        main()
    except StartError as error:
        sys.exit(str(error))

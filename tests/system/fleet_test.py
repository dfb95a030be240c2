#!/usr/bin/python3
"""The shipped manifest, applied to real gateways: only what differs changes, instances keep their ids, and a gateway
that drains does so over its own restart and the master's.

usage: fleet_test.py BUILD_DIR
"""

import json
import shutil
import signal
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "servers"))

from private_cluster import PrivateCluster, StartError, require, wait_for  # noqa: E402

MANIFEST = HERE.parent.parent / "config" / "fleet.yaml"


class Fleet(PrivateCluster):
    def changes(self, verb, file, status):
        """The changes of diff or apply, which must exit with this status: ["deploy meter/1", ...]."""
        done = self.run_cli(verb, "-f", file, "-o", "json", limit=120)
        require(done.returncode == status, f"{verb}: {done.returncode}: {done.stdout} {done.stderr}")
        return [f"{change['change']} {change['name']}/{change['index']}" for change in json.loads(done.stdout)["changes"]]

    def instances(self, **wanted):
        """Ids of the instances in this state, in order."""
        return sorted(driver["instance"] for driver in self.json("drivers")
                      if all(driver[key] == value for key, value in wanted.items()))


def check_apply(fleet, work):
    fleet.cli("deploy", "loadgen.so", "--gateway", "gateway-1", "--name", "by-hand", "--property", "rate=1")
    both = ["deploy meter/1", "deploy meter/2"]
    require(fleet.changes("diff", MANIFEST, 4) == both, "diff does not say what is missing")
    require(fleet.changes("apply", MANIFEST, 0) == both, "apply did not deploy it")
    require(fleet.changes("diff", MANIFEST, 0) == [], "something differs after apply")
    ids = fleet.instances(name="meter", state="active")
    require(len(ids) == 2, ids)

    changed = work / "changed.yaml"
    changed.write_text(MANIFEST.read_text().replace("rate: 5", "rate: 7").replace("site: lab", "site: roof"))
    since = {driver["instance"]: driver["since_ms"] for driver in fleet.json("drivers")}
    done = fleet.changes("apply", changed, 0)
    require(done == ["change meter/1", "change meter/2", "describe meter/1", "describe meter/2"], done)
    require(fleet.instances(name="meter", state="active") == ids, "the instances did not keep their ids")
    for driver in fleet.json("drivers"):
        anew = driver["since_ms"] != since[driver["instance"]]
        require(anew == (driver["name"] == "meter"), f"made anew or not, wrongly: {driver}")
    require(fleet.changes("apply", changed, 0) == [], "applied twice it changes something")
    return ids, changed


def check_drain(fleet, ids, manifest):
    fleet.cli("drain", "gateway-1")
    require(fleet.instances(gateway="gateway-1", state="active") == [], "something runs on a drained gateway")
    former = fleet.gateway_record("gateway-1")
    for name in ("gateway-1", "master"):
        fleet.end(name, signal.SIGKILL)
        fleet.again(name)
    fleet.wait_for_next_life("gateway-1", former)
    fleet.wait_until_ready()
    require([gateway["draining"] for gateway in fleet.json("gateways")] == [True, False], "it drains no longer")
    wait_for("the instances are there again, and wait", lambda: fleet.instances(name="meter", state="inactive") == ids)
    require(fleet.changes("apply", manifest, 0) == [], "a drained gateway differs from the manifest")
    refused = fleet.run_cli("deploy", "loadgen.so", "--gateway", "gateway-1")
    require(refused.returncode == 1 and "undrain gateway-1" in refused.stderr, refused)
    fleet.cli("undrain", "gateway-1")
    require(fleet.instances(name="meter", state="active") == ids, "they did not start again")


def check_away(fleet, work):
    nothing = work / "nothing.yaml"
    nothing.write_text("fleet: lab\ndeployments: {}\n")
    require(fleet.changes("apply", nothing, 0) == ["undeploy meter/1", "undeploy meter/2"], "it did not take them away")
    left = [driver["name"] for driver in fleet.json("drivers")]
    require(left == ["by-hand"], left)


def main():
    build = Path(sys.argv[1]).resolve()
    work = build / "fleet-test"
    shutil.rmtree(work, ignore_errors=True)
    with Fleet(work, build / "bin", build / "plugins") as fleet:
        fleet.start(gateways=2)
        fleet.wait_until_ready()
        ids, manifest = check_apply(fleet, work)
        check_drain(fleet, ids, manifest)
        check_away(fleet, work)
        fleet.undeploy_all()
        fleet.require_alive()
    print("the fleet was as its manifest said")


if __name__ == "__main__":
    try:
        main()
    except StartError as error:
        sys.exit(str(error))

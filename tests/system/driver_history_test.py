#!/usr/bin/python3
"""What becomes of a driver instance is seen through the command line: `iotcloud describe`, `history`, `logs`, `channel` and
`check`, of a gateway whose driver host crashes, and of one that is frozen for a while.

usage: driver_history_test.py BUILD_DIR
"""

import json
import os
import select
import shutil
import signal
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "servers"))

from private_cluster import PrivateCluster, StartError, answer_of, require, wait_for  # noqa: E402
from private_server import freeze  # noqa: E402


class Fleet(PrivateCluster):
    def deploy(self, gateway):
        answer = self.json("deploy", "loadgen.so", "--gateway", gateway, "--property", "rate=5")
        return answer["outcomes"][0]["instance"]

    def states(self, instance):
        return [change["state"] for change in self.json("history", instance)]


def check_machine(fleet):
    """`iotcloud check` finds nothing wrong with a machine whose gateway runs, and tells the gateway's port from a stranger's."""
    done = fleet.run_cli("check", "--config", fleet.out / "gateway-1.yaml", "--limit", 60, "-o", "json")
    found = {one["area"]: one for one in json.loads(done.stdout)}
    require(done.returncode == 0, done.stdout)
    require("answers" in found["registry"]["says"] and "takes connections" in found["broker"]["says"], done.stdout)
    require(found["port"]["says"].startswith("iotcloud-gateway"), done.stdout)


def check_crash(fleet, instance):
    """A crash is in the history with its reason, and so is the new start."""
    wait_for("the first start is remembered", lambda: fleet.states(instance) == ["deployed", "starting", "active"])
    host, = fleet.hosts_of("gateway-1")
    os.kill(host, signal.SIGSEGV)
    wait_for("the instance is active again", lambda: "again, after" in fleet.json("drivers", instance)[0]["reason"])
    described = answer_of("it is described", lambda: fleet.json("describe", instance[:8]))
    require(described["instance"] == instance and described["state"] == "active", described)
    reasons = [change["reason"] for change in described["history"]]
    require(any("crashed" in reason and "signal 11" in reason for reason in reasons), reasons)
    table = answer_of("it is described", lambda: fleet.cli("describe", instance))
    require("crashed" in table and "guest:***@" in table and "guest:guest" not in table, table)


def check_logs(fleet, instance):
    """`logs --follow` prints new lines; Ctrl-C ends it in order."""
    require(instance in answer_of("the log is shown", lambda: fleet.cli("logs", instance)), "the log does not name the instance")
    follower = subprocess.Popen(fleet.command("logs", instance, "--follow", "--lines", 1), stdout=subprocess.PIPE, text=True)
    require("active" in follower.stdout.readline(), "the last line is not that it became active")
    fleet.cli("stop", instance)
    lines = [follower.stdout.readline() for _ in range(2)]
    require("stopping" in lines[0] and "inactive" in lines[1], lines)
    follower.send_signal(signal.SIGINT)
    follower.communicate(timeout=120)
    require(follower.returncode == 0, f"logs --follow ended with {follower.returncode} at Ctrl-C")


def check_channels(fleet, instance):
    """A channel is looked at, a message is handed to the driver by hand, and Ctrl-C ends a look in order."""
    echo = answer_of("three messages are shown", lambda: fleet.cli("channel", "echo", instance, "data", "-n", 3, "-o", "json"))
    seen = [json.loads(line) for line in echo.splitlines()]
    require([one["number"] for one in seen] == [1, 2, 3] and all(one["size"] > 0 for one in seen), seen)
    # On a busy machine a driver pauses and then catches up, so not every two seconds show its rate.
    wait_for("5 messages a second are measured", lambda: 1 < json.loads(
        fleet.cli("channel", "hz", instance, "data", "--once", "--every", 2, "-o", "json"))["messages_per_s"] < 25)
    listed = answer_of("the channels are listed", lambda: fleet.json("channel", "list", instance))
    channels = {one["channel"]: one for one in listed}
    require(set(channels) == {"data", "echo"} and channels["data"]["broker_state"] == "connected", channels)
    look = subprocess.Popen(fleet.command("channel", "echo", instance, "echo"), stdout=subprocess.PIPE, text=True)
    wait_for("the message by hand is shown", lambda: fleet.cli("channel", "publish", instance, "echo", "by hand")
             and select.select([look.stdout], [], [], 0.5)[0])
    require("by hand" in look.stdout.readline(), "another message is shown")
    look.send_signal(signal.SIGINT)
    look.communicate(timeout=120)
    require(look.returncode == 0, f"channel echo ended with {look.returncode} at Ctrl-C")
    look = subprocess.Popen(fleet.command("channel", "echo", instance, "data"), stdout=subprocess.PIPE,
                            stderr=subprocess.PIPE, text=True)
    look.stdout.readline()
    fleet.cli("stop", instance)
    told = look.communicate(timeout=120)[1]
    require(look.returncode == 1 and "is inactive" in told and "iotcloud start" in told, told)
    fleet.cli("start", instance)


def check_gone(fleet, instance):
    """An undeployed instance still has its history."""
    fleet.cli("undeploy", instance)
    wait_for("its end is remembered", lambda: fleet.states(instance[:8])[-1] == "undeployed")
    for words in (("describe", instance), ("logs", instance)):
        done = fleet.run_cli(*words)
        require(done.returncode == 1 and "no driver instance" in done.stderr, done)


def check_silent(fleet, frozen, instance, other):
    """A frozen gateway is named; the others answer."""
    freeze(frozen)
    try:
        asked = []

        def only_the_other_answers():
            asked[:] = [fleet.run_cli("history")]
            return instance in asked[0].stdout  # on a busy machine not always in time

        wait_for("the gateway that runs answers", only_the_other_answers)
        done, = asked
        require(done.returncode == 1 and other not in done.stdout, done)
        require("the history of gateway-2 is missing" in done.stderr, done)
    finally:
        frozen.send_signal(signal.SIGCONT)
    wait_for("the frozen gateway tells again", lambda: fleet.states(other)[-1] == "active")


def main():
    build = Path(sys.argv[1]).resolve()
    work = build / "driver-history-test"
    shutil.rmtree(work, ignore_errors=True)
    with Fleet(work, build / "bin", build / "plugins") as fleet:
        # A gateway that is frozen for a moment is not to be lost: orders would not wait for it.
        fleet.start(gateways=2, more="registry.session_timeout: 60s")
        fleet.wait_until_ready()
        instance, other = fleet.deploy("gateway-1"), fleet.deploy("gateway-2")
        check_machine(fleet)
        check_crash(fleet, instance)
        check_channels(fleet, instance)
        check_logs(fleet, instance)
        check_gone(fleet, instance)
        check_silent(fleet, dict(fleet.children)["gateway-2"], instance, other)
        fleet.undeploy_all()
        fleet.require_alive()
    print("describe, history and logs told what became of the drivers")


if __name__ == "__main__":
    try:
        main()
    except StartError as error:
        sys.exit(str(error))

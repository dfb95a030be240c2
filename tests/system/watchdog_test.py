#!/usr/bin/python3
"""A robot that is on its way is told to be still 250 ms after its commands stop coming, whichever part has died: the
topology, the broker; it goes on when the gateway dies, whose driver hosts outlive it; and its base stops by itself when
the driver host dies. Each is killed (SIGKILL) in turn, in a cluster of processes, while the robot follows the person.

The robot is a ROS node of its own (ros_robot.py), which outlives all of them and writes what its base was asked and did,
and when; what is measured here comes from there. Times are printed, and judged with --judge.

usage: watchdog_test.py BUILD_DIR [--judge]     (exit status 77: there is no ROS here)
"""

import argparse
import csv
import os
import re
import shutil
import signal
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
sys.path[:0] = [str(HERE.parent / "servers"), str(HERE.parent / "cluster")]

from fault_cluster import add_judge, judge  # noqa: E402
from private_cluster import PrivateCluster, Unavailable, require, wait_for  # noqa: E402

WATCHDOG_S = 0.25  # the driver's, by default
BASE_S = 0.6       # the base's own (drivers/turtle/simulator/base.h, as a Kobuki's)
BRAKES = {"linear": 0.8, "angular": 6.0}  # the base's too: m/s and rad/s a second
GOAL_M = 0.55      # nearer to the person than it stands at first, so that it sets out at once
FAST_ENOUGH = 0.12  # m/s, to be on its way when something is killed
HOSTS_REST_S = 4   # before a driver host is started again: longer than a base takes to stand still


class Track:
    """What the base was asked and did, row by row: time_s on this machine's monotonic clock, commands so far, the velocity
    asked for, the velocity it has."""

    def __init__(self, path):
        self.path = Path(path)

    def rows(self):
        lines = self.path.read_text().splitlines(keepends=True)
        whole = [line for line in lines if line.endswith("\n")]
        return [{key: float(value) for key, value in row.items()} for row in csv.DictReader(whole)]

    def newest(self):
        return self.rows()[-1]

    def moves(self):
        row = self.newest()
        return row["commands"] > 5 and row["linear"] > FAST_ENOUGH

    def is_still(self):
        row = self.newest()
        return row["linear"] == 0 and row["angular"] == 0

    def is_told_to_be_still(self):
        row = self.newest()
        return row["asked_linear"] == row["asked_angular"] == 0

    def commands(self):
        """The rows in which a command came."""
        rows = self.rows()
        return [row for before, row in zip(rows, rows[1:]) if row["commands"] > before["commands"]]

    def last_command(self):
        """The row in which the last command came, behind the one before it."""
        rows = self.rows()
        return [pair for pair in zip(rows, rows[1:]) if pair[1]["commands"] > pair[0]["commands"]][-1]


def still_after(track, row):
    """Seconds from that row until the base stands still."""
    still = next(later for later in track.rows()
                 if later["time_s"] >= row["time_s"] and later["linear"] == later["angular"] == 0)
    return still["time_s"] - row["time_s"]


def braking_time(row):
    """Seconds that the base needs from the velocity in this row."""
    return max(abs(row[key]) / BRAKES[key] for key in BRAKES)


class Robot(PrivateCluster):
    def begin(self, build, given):
        self.given = given
        os.environ["ROS_IP"] = "127.0.0.1"
        ros = self.server("rosmaster")
        self.track = Track(self.server("ros_robot", "--program", build / "bin/ros_robot", "--master", ros))
        self.start(gateways=1, more=f"host_restart: {{first: {HOSTS_REST_S}s, longest: {HOSTS_REST_S}s}}\n"
                                     "host_environment: [ROS_IP]")
        topology = (ROOT / "examples/turtlebot_follower/follower.yaml").read_text()
        topology = re.sub(r"(?m)^zk\.servers:.*$", 'zk.servers: ["{zookeeper}"]\nregistry.session_timeout: 4s', topology)
        topology = topology.replace("goal_distance: 0.7", f"goal_distance: {GOAL_M}")
        library = self.plugins / "turtlebot_follower.so"
        self.topology("topology", re.sub(r"(?m)^topology\.library:.*$", f'topology.library: "{library}"', topology))
        self.wait_until_ready()
        # As its README says.
        example = (ROOT / "drivers/turtle/ros/turtlebot.yaml").read_text()
        manifest = self.out / "turtlebot.yaml"
        manifest.write_text(example.replace("http://turtlebot.local:11311", ros))
        self.cli("apply", "-f", manifest)

    def order(self, name, word, answer):
        """A command for a server's script."""
        child = dict(self.children)[name]
        child.stdin.write(word + "\n")
        child.stdin.flush()
        said = child.stdout.readline()
        require(said.startswith(answer), f"{name}: {word}: {said}")

    def set_out(self):
        """Another robot, near its person, that follows it: the last one has lost sight of it while it stood still."""
        self.order("ros_robot", "kill", "KILLED")
        self.order("ros_robot", "start", "READY")
        wait_for("the robot follows the person", self.track.moves)

    def must_stop(self, what):
        """Checks that the driver stops the base after its last command, and that the base stops."""
        # Where the driver gets no CPU for a while, the base stops by itself before it is told to.
        wait_for(f"the robot is told to be still after {what} was killed", self.track.is_told_to_be_still)
        wait_for(f"the robot stands still after {what} was killed", self.track.is_still)
        last, halt = self.track.commands()[-2:]
        require(halt["asked_linear"] == halt["asked_angular"] == 0, f"the last command is none to be still: {halt}")
        told, still = halt["time_s"] - last["time_s"], still_after(self.track, last)
        print(f"{what} killed at {halt['linear']:.2f} m/s: told to be still {told * 1000:.0f} ms after the last command, "
              f"still after {still * 1000:.0f} ms", flush=True)
        # The last command may have come late; the driver's own tests check that it does not stop earlier.
        judge(self.given, "told_to_be_still_s", told)
        judge(self.given, "still_late_s", still - WATCHDOG_S - braking_time(halt))

    def base_must_stop(self, what):
        """Checks that the base stops by itself, without a command."""
        wait_for(f"the robot stands still after {what} was killed", self.track.is_still)
        before, last = self.track.last_command()
        still = still_after(self.track, last)
        print(f"{what} killed at {last['linear']:.2f} m/s: nobody told it, still {still * 1000:.0f} ms after the last "
              "command", flush=True)
        require(last["asked_linear"] != 0 or last["asked_angular"] != 0, f"somebody told it to be still: {last}")
        # Until then it obeys its last command and may become faster.
        # The command came between these rows, which a busy machine writes late.
        longest = still + last["time_s"] - before["time_s"]
        require(longest >= BASE_S, f"it was still after {longest:.3f} s already, not {BASE_S} s after its last command")
        judge(self.given, "still_late_s", still - BASE_S - max(braking_time(row) for row in self.track.rows()))

    def must_go_on(self, what):
        """Checks that commands keep coming."""
        before = self.track.newest()
        wait_for(f"60 more commands after {what} was killed",
                 lambda: self.track.newest()["commands"] > before["commands"] + 60)
        came = [row["time_s"] for row in self.track.commands() if row["commands"] >= before["commands"]]
        longest = max(later - sooner for sooner, later in zip(came, came[1:]))
        print(f"{what} killed: 60 commands more, never more than {longest * 1000:.0f} ms apart", flush=True)
        judge(self.given, "between_commands_s", longest)


def end_process(process):
    try:
        os.kill(process, signal.SIGKILL)
    except ProcessLookupError:
        pass


def kill_while_it_drives(robot, host):
    """Kills the driver host while the base obeys a command to move. On a busy machine the driver may have told it to be still a
    moment before, because no command came."""
    while True:
        robot.set_out()
        os.kill(host, signal.SIGSTOP)
        time.sleep(0.1)  # in which the base gets what was sent
        if not robot.track.is_told_to_be_still():
            break
        os.kill(host, signal.SIGCONT)
    os.kill(host, signal.SIGKILL)


def kill_each(robot, host):
    robot.set_out()
    robot.end("topology", signal.SIGKILL)
    robot.must_stop("the topology")
    robot.again("topology")

    robot.set_out()
    robot.order("rabbitmq", "kill", "KILLED")
    robot.must_stop("the broker")
    robot.order("rabbitmq", "start", "READY")

    robot.set_out()
    former = robot.gateway_record("gateway-1")
    robot.end("gateway-1", signal.SIGKILL)
    robot.must_go_on("the gateway")
    robot.again("gateway-1")
    robot.wait_for_next_life("gateway-1", former)  # it adopts the driver host before

    kill_while_it_drives(robot, host)
    robot.base_must_stop("the driver host")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("build", type=Path)
    add_judge(parser)
    given = parser.parse_args()
    build = given.build.resolve()
    work = build / "watchdog"
    shutil.rmtree(work, ignore_errors=True)
    with Robot(work, build / "bin", build / "plugins") as robot:
        try:
            robot.begin(build, given)
        except Unavailable as reason:
            print(reason)
            sys.exit(77)

        host, = robot.hosts_of("gateway-1")
        try:
            kill_each(robot, host)
        finally:
            end_process(host)  # it outlives its gateway, even when the test ends here
        robot.set_out()  # with a new driver host
        # roscpp knows one node to a process: another instance has one of its own, without a word in its order.
        robot.deploy("turtle_ros.so", "gateway-1", {"source": "ros", "actuator": "none"})
        states = [driver["state"] for driver in robot.json("drivers")]
        require(states == ["active"] * 2 and len(robot.hosts_of("gateway-1")) == 2, f"{states} in fewer than two hosts")
        robot.undeploy_all()


if __name__ == "__main__":
    main()

#!/usr/bin/python3
"""The shipped unit of a robot's laptop with the shipped robot.env, under a systemd of its own (booted.py): as a user that systemd
makes for it, which may not read the token's file, it proves the token to the turtle driver in a gateway, and its frames come. It
stops in order. With the sample's OPTIONS taken in it does the same.

usage: robot_unit_test.py UNITS BUILD_DIR
"""

import argparse
import shutil
from pathlib import Path

import fleet
from booted import BootedCluster, require_means, status_of, with_own_programs
from private_cluster import free_port, require, wait_for

UNIT = "iotcloud-robot.service"
TOKEN = "a secret of both ends"
ETC = "/etc/iotcloud"


class Machine(BootedCluster):
    def deploy_driver(self):
        """The driver at the gateway; its frames go nowhere, because there is no broker."""
        self.listen = f"127.0.0.1:{free_port()}"
        self.deploy("turtle.so", "gateway-1", {"source": "robot", "listen": self.listen, "token": TOKEN, "silence_ms": 5000})
        wait_for("the driver listens", lambda: self.robot() == "away")

    def boot_robot(self, units):
        sample = fleet.replaced((units / "robot.env").read_text(), {"gateway.lan:7411": self.listen, "SOURCE=kinect": "SOURCE=simulator"})
        for name, text in {"robot.env": sample, "robot.token": f"{TOKEN}\n"}.items():
            (self.out / name).write_text(text)
        # A helper of systemd mounts the unit's credentials, and whoever boots a container lets others of the same space see mounts.
        self.boot(units, {UNIT: with_own_programs((units / UNIT).read_text())}, [UNIT], [self.bin / "iotcloud-robot"],
                  f"mount --make-rshared /\nmkdir -p {ETC}\ninstall -m 0600 {self.out}/robot.env {self.out}/robot.token {ETC}")

    def metadata(self):
        """Those of the driver's record."""
        driver, = self.json("drivers")
        return driver.get("metadata", {})

    def robot(self):
        return self.metadata().get("robot")

    def shown(self, *properties):
        """Properties of the unit, as systemd says them."""
        lines = self.systemctl("show", UNIT, f"--property={','.join(properties)}").stdout.splitlines()
        return dict(line.split("=", 1) for line in lines)

    def process(self):
        """Process id of the robot's program, as this machine sees it; None when there is none."""
        return next((process for process in self.descendants() if self.name_of(process) == "iotcloud-robot\n"), None)


def check_user(machine):
    process = machine.process()
    user = status_of(process, "Uid")[0]
    require(int(user) >= 61184, f"it runs as user {user}, which systemd did not make for it")  # the first of those that it makes
    for kind in ("CapPrm", "CapEff", "CapBnd", "CapAmb"):
        require(int(status_of(process, kind)[0], 16) == 0, f"it has {kind} {status_of(process, kind)}")
    read = machine.inside("setpriv", f"--reuid={user}", "--clear-groups", "cat", f"{ETC}/robot.token")
    require("Permission denied" in read.stderr, f"its user reads the token's file: {read}")


def check_stop(machine):
    done = machine.systemctl("stop", UNIT)
    require(done.returncode == 0 and machine.process() is None, f"it did not stop: {done}")
    ended = machine.shown("Result", "ExecMainStatus", "NRestarts")
    require(ended == {"Result": "success", "ExecMainStatus": "0", "NRestarts": "0"}, f"it did not end in order: {ended}")
    wait_for("the driver sees that it has gone", lambda: machine.robot() == "away")


def main():
    options = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    options.add_argument("units", type=Path)
    options.add_argument("build", type=Path)
    given = options.parse_args()
    require_means()
    out = given.build.resolve() / "robot_unit"
    shutil.rmtree(out, ignore_errors=True)
    with Machine(out, given.build / "bin", given.build / "plugins") as machine:
        machine.start(gateways=1, brokers=['main: {type: rabbitmq, urls: ["amqp://127.0.0.1:1/"]}'])
        machine.wait_until_ready()
        machine.deploy_driver()
        machine.boot_robot(given.units.resolve())
        wait_for("the robot is at its driver", lambda: machine.robot() == "connected")
        wait_for("its frames come, of which each has its place", lambda: "position" in machine.metadata())
        check_user(machine)
        check_stop(machine)

        taken_in = machine.inside("sed", "-i", "s/^# OPTIONS=/OPTIONS=/", f"{ETC}/robot.env")
        require(taken_in.returncode == 0, taken_in.stderr)
        require(machine.systemctl("start", UNIT).returncode == 0, "it does not start with OPTIONS")
        wait_for("the robot is at its driver again", lambda: machine.robot() == "connected")
        words = Path(f"/proc/{machine.process()}/cmdline").read_bytes().split(b"\0")
        require(b"codec=compact" in words and b"--watchdog-ms" in words, f"its OPTIONS are {words}")
        check_stop(machine)
    print("the robot's unit was at its driver, without and with OPTIONS, and stopped in order")


if __name__ == "__main__":
    main()

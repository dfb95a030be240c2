#!/usr/bin/python3
"""The Debian packages on a bare Debian (bare_root.py), by the commands of docs/packages.md, as they stand there. Lintian finds no fault
in them. Installed, they make users and start nothing; booted without a configuration, no daemon runs; configured, master, gateway,
driver, pool and topology work together. The next version installed over it goes on with their state and their files. Removed, all of
that stays, and installed again, they go on. Purged, nothing is left.

usage: installed_packages_test.py BUILD_DIR
"""

import argparse
import os
import re
import shutil
import sys
from pathlib import Path

import bare_root
from bare_root import BareMachine, must
from booted import require_means, status_of

from private_cluster import require, wait_for

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(HERE.parent / "cluster"))

import network_spaces  # noqa: E402

VERSIONS = "0.1.0~1", "0.1.0~2"
FIRST = ("iotcloud", "iotcloud-run", "iotcloud-recorder", "iotcloud-check", "iotcloud-master", "iotcloud-gateway", "iotcloud-driver-host",
         "iotcloud-topology", "loadgen", "files")  # CMake's components of the packages that the page installs first
# Not put on the machine, because it takes a compiler; apt is asked whether it could be.
NOT_ON_THE_MACHINE = ("iotcloud-dev",)
ENABLED = ["iotcloud-master.service", "iotcloud-gateway.service", "iotcloud-pool.service", "iotcloud-host.socket",
           "iotcloud-worker.socket", "iotcloud-registry-tunnel.service"]
USERS = [f"iotcloud-{name}" for name in ("gateway", "host", "master", "pool", "topology", "tunnel", "worker")]
# Who runs as whom, by the first 15 letters of a program's name.
RUNNING = {"iotcloud-master": "iotcloud-master", "iotcloud-gatewa": "iotcloud-gateway", "iotcloud-driver": "iotcloud-host"}
STATE = ("gateway", "master", "pool", "topology")
# What the packages' own tools write, and what is mounted.
OF_THE_SYSTEM = re.compile(r"(var/(cache|log|tmp)|var/lib/(apt|dpkg|systemd)|etc/ld\.so\.cache|etc/machine-id|run|tmp|proc|sys|dev|media|"
                           r"mnt|etc/\.(pwd\.lock|updated)|var/\.updated|root)(/|$)|etc/(passwd|group|g?shadow|sub[ug]id)-$")
ACCOUNTS = ("etc/passwd", "etc/group", "etc/shadow", "etc/gshadow")


def blocks():
    """The page's blocks of commands, by the section that they are in."""
    found = {}
    for section in re.split(r"^##? ", (ROOT / "docs/packages.md").read_text(encoding="utf-8"), flags=re.MULTILINE)[1:]:
        found[section.splitlines()[0]] = re.findall(r"^```sh\n(.*?)^```", section, re.DOTALL | re.MULTILINE)
    return found


def all_files(root):
    """Paths of all that is in the folder, but for what the system itself writes."""
    found = set()
    for folder, folders, files in os.walk(root):
        here = os.path.relpath(folder, root)
        folders[:] = [name for name in folders if not OF_THE_SYSTEM.match(os.path.normpath(os.path.join(here, name)))]
        found.update(os.path.normpath(os.path.join(here, name)) for name in [*folders, *files])
    return {path for path in found if not OF_THE_SYSTEM.match(path)}


def accounts(root):
    return {file: sorted(line.partition(":")[0] for line in (root / file).read_text().splitlines()) for file in ACCOUNTS}


def make_packages(build, out):
    """Two versions of the packages of a build, a number apart, in folders of their own: of those that are installed first, and of all,
    at which Lintian looks."""
    for version, options in zip(VERSIONS, (["--no-lint", "--components", *FIRST], [])):
        print(f"packages {version}", flush=True)
        must("/usr/bin/python3", ROOT / "development/package.py", "--build", build, "--out", out / version, "--version", version, "--fast",
             *options)
    for version in VERSIONS:
        there = out / f"{version}-there"
        there.mkdir()
        for package in sorted((out / version).glob("*.deb")):
            if not package.name.startswith(tuple(f"{name}_" for name in NOT_ON_THE_MACHINE)):
                os.link(package, there / package.name)


class Machine(BareMachine):
    def type(self, script, folder="/media"):
        """Types commands of the page into a shell of root's. Returns what they print."""
        done = self.inside("bash", "-e", "-c", f"cd {folder}\n{script}")
        if done.returncode:
            logs = self.inside("journalctl", "--no-pager", "--lines=60").stdout
            sys.exit(f"wrong: {script}: exit status {done.returncode}\n{done.stdout[-3000:]}{done.stderr[-3000:]}\n{logs}")
        return done.stdout

    def states(self, unit):
        """Whether a unit runs, whether its condition was met, and whether it is enabled."""
        shown = dict(line.split("=", 1) for line in self.systemctl(
            "show", unit, "--property=ActiveState,ConditionResult,UnitFileState").stdout.splitlines())
        return shown["ActiveState"], shown["ConditionResult"], shown["UnitFileState"]

    def command(self, *words):
        """The machine's own command line."""
        return ["nsenter", "--target", str(self.first()), "--mount", "--pid", "/usr/bin/iotcloud", *map(str, words)]

    def version(self, package):
        return self.type(f"dpkg-query -W -f='${{Version}}' {package}")

    def main_process(self, unit):
        return self.systemctl("show", unit, "--property=MainPID", "--value").stdout.strip()

    def processes_named(self, name):
        """Ids of processes by the first 15 letters of their program's name."""
        return [process for process in self.descendants() if self.name_of(process).strip() == name]

    def processed(self):
        """How many messages the topology has sent back."""
        return {entry["component"]: entry["sum"] for entry in self.json("topology", "metrics", "echo")["components"]}["echo_send"]["executed"]


def check_enabled(machine):
    """Users are made, and units will be started by a boot."""
    there = accounts(machine.root)["etc/passwd"]
    require(set(USERS) <= set(there), f"users are missing: {there}")
    links = {path.name for path in (machine.root / "etc/systemd/system").glob("*.wants/*")}
    require(set(ENABLED) <= links, f"enabled are {sorted(links)}")
    require(not list((machine.root / "etc/iotcloud").rglob("*.yaml")), "there is a configuration that nobody made")


def check_idle(machine):
    """The machine has booted, and no daemon runs, for lack of a configuration."""
    wait_for("the machine has booted", lambda: machine.systemctl("is-system-running").stdout.strip() in ("running", "degraded"))
    for unit in ENABLED:
        states = machine.states(unit)
        require(states == ("inactive", "no", "enabled"), f"{unit} before it is configured: {states}")
    failed = machine.systemctl("list-units", "--failed", "--plain", "--no-legend").stdout
    require("iotcloud" not in failed, f"failed: {failed}")


def check_work(machine):
    """The driver is active, the topology takes its messages, and everybody runs as the user who is meant. Returns the driver's id."""
    wait_for("the driver is active", lambda: [one["state"] for one in machine.json("drivers")] == ["active"])
    wait_for("the topology sends messages back", lambda: machine.processed() > 20)
    for name, user in RUNNING.items():
        uid = int(machine.type(f"id -u {user}"))
        found = machine.processes_named(name)
        require(found and all(int(status_of(process, "Uid")[0]) == uid for process in found), f"{name} as {user}: {found}")
    wait_for("the pool is there", lambda: len(machine.json("topology", "pools")) == 1)
    return machine.json("drivers")[0]["instance"]


def main():
    options = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    options.add_argument("build", type=Path)
    given = options.parse_args()
    require_means()
    build = given.build.resolve()
    out, cache = build / "bare_root/test", build / "bare_root"
    if not os.environ.get(network_spaces.MARK):
        shutil.rmtree(out, ignore_errors=True)
        out.mkdir(parents=True)
        make_packages(build, out)
        bare_root.prepare(cache, sorted((out / f"{VERSIONS[1]}-there").glob("*.deb")))
    # The page's daemons use the usual ports of the usual servers: on a network that nobody else has, and without any other.
    network_spaces.in_own_network("installed packages")
    network_spaces.run("ip", "link", "set", "lo", "up")
    old, new = (out / f"{version}-there" for version in VERSIONS)
    page = blocks()
    install, configure = page["A machine with everything"]
    [upgrade], (remove, purge) = page["Upgrades"], page["Removal"]
    with Machine(out / "cluster", "/usr/bin", "/usr/lib/iotcloud/plugins") as machine:
        machine.copy_root(cache / "debian")
        # What is left at the end is what was there before, with Debian's own packages: those that apt finds necessary.
        plan = machine.before_boot(new, "apt-get install --simulate ./*.deb")
        machine.before_boot(out / VERSIONS[1], "apt-get install --simulate ./iotcloud-dev_*.deb")
        needed = sorted(set(re.findall(r"^Inst (\S+)", plan, re.MULTILINE)) - {file.name.partition("_")[0] for file in new.iterdir()})
        machine.before_boot(old, f"apt-get install -y {' '.join(needed)}")
        before = all_files(machine.root), accounts(machine.root)

        machine.before_boot(old, install)
        check_enabled(machine)
        machine.boot_root(out)
        check_idle(machine)
        machine.server("zookeeper", "--port", "2181")
        machine.server("rabbitmq", "--port", "5672")
        machine.type(configure)
        driver = check_work(machine)

        machine.type("echo '# a line of mine' >>/etc/iotcloud/gateway.yaml")
        former = {unit: machine.main_process(unit) for unit in ENABLED[:3]}
        machine.type(upgrade, f"/media/{new.name}")
        require(machine.version("iotcloud-gateway") == VERSIONS[1], machine.version("iotcloud-gateway"))
        for unit, process in former.items():
            require(machine.main_process(unit) not in ("0", process), f"{unit} was not started again by the upgrade")
        require(check_work(machine) == driver, "the upgrade made another driver instance")
        require("# a line of mine" in machine.type("cat /etc/iotcloud/gateway.yaml"), "the upgrade changed a configuration")

        machine.type(remove)
        running = [machine.name_of(process) for process in machine.descendants() if machine.name_of(process).startswith("iotcloud")]
        require(not running, f"after the packages were removed there are {running}")
        for name in STATE:
            require((machine.root / f"var/lib/iotcloud-{name}").is_dir(), f"remove took the state of {name}")
        machine.type(upgrade, f"/media/{new.name}")
        require(check_work(machine) == driver, "after they were removed and installed again there is another driver instance")

        machine.type(purge)
        after = all_files(machine.root), accounts(machine.root)
        require(after[0] <= before[0], f"purge left {sorted(after[0] - before[0])}")
        require(before[0] <= after[0], f"purge took {sorted(before[0] - after[0])}")
        require(after[1] == before[1], f"accounts before: {before[1]}, and after: {after[1]}")
    print("installed, upgraded, removed, installed again and purged")


if __name__ == "__main__":
    main()

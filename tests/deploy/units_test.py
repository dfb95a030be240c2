#!/usr/bin/python3
"""systemd's own checks of the units: usage: units_test.py UNITS PROGRAMS"""

import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import unittest

UNITS, PROGRAMS = pathlib.Path(sys.argv[1]), sys.argv[2]
SKIPPED = 77
# Of 100, as `systemd-analyze security` counts what a service could still do: below 20 it calls it OK, a gateway has
# devices and a topology runs code of its own.
MOST_EXPOSED = 20


class Units(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.units = []
        for source in sorted(UNITS.glob("*.service")):
            # An instance of a template, with programs that exist.
            unit = pathlib.Path(folder.name, source.name.replace("@.", "@follower."))
            unit.write_text(source.read_text().replace("ExecStart=/usr/bin/iotcloud", f"ExecStart={PROGRAMS}/iotcloud"))
            self.units.append(unit)
        for name in ("host", "worker"):
            shutil.copy(UNITS / f"iotcloud-{name}.socket", folder.name)
            shutil.copy(UNITS / f"iotcloud-{name}@.service", folder.name)

    def analyze(self, *words):
        return subprocess.run(["systemd-analyze", *words], capture_output=True, text=True, timeout=60)

    def test_there_is_one_for_each_daemon(self):
        self.assertEqual([unit.name for unit in self.units],
                         ["iotcloud-gateway.service", "iotcloud-host@follower.service", "iotcloud-master.service", "iotcloud-pool.service",
                          "iotcloud-registry-tunnel.service",
                          "iotcloud-robot.service", "iotcloud-topology@follower.service", "iotcloud-worker@follower.service"])

    def test_systemd_understands_all_that_they_say(self):
        for unit in [*self.units, *(self.units[0].with_name(f"iotcloud-{name}.socket") for name in ("host", "worker"))]:
            done = self.analyze("verify", "--man=no", "--recursive-errors=no", str(unit))
            self.assertEqual((done.returncode, done.stderr), (0, ""), unit.name)

    def test_each_daemon_starts_after_the_tunnel_to_the_registry(self):
        for unit in self.units:
            # Those that have nothing to do with the registry, or are started by a daemon that comes after it.
            if not {"tunnel", "robot", "host@follower", "worker@follower"} & set(re.split(r"[-.]", unit.name)):
                lines = unit.read_text().splitlines()
                for key in ("After", "Wants"):
                    self.assertIn(f"{key}=network-online.target iotcloud-registry-tunnel.service", lines, unit.name)

    def test_hosts_and_workers_outlive_a_gateway_or_pool_that_dies(self):
        for unit in self.units:
            if unit.name in ("iotcloud-gateway.service", "iotcloud-pool.service"):
                lines = unit.read_text().splitlines()
                self.assertEqual([line for line in lines if line.startswith("KillMode=")], ["KillMode=process"], unit.name)

    def test_what_runs_drivers_or_components_takes_no_processes_without_end(self):
        limits = {unit.name: re.findall(r"^TasksMax=(\d+)$", unit.read_text(), re.MULTILINE) for unit in self.units}
        self.assertEqual({unit: limit for unit, limit in limits.items() if limit},
                         {"iotcloud-gateway.service": ["4096"], "iotcloud-host@follower.service": ["1024"],
                          "iotcloud-pool.service": ["4096"], "iotcloud-topology@follower.service": ["4096"],
                          "iotcloud-worker@follower.service": ["1024"]})

    def test_users_that_they_name_are_made(self):
        made = {line.split()[1] for line in (UNITS / "iotcloud.sysusers").read_text().splitlines() if line.startswith(("u ", "g "))}
        named = {line.split("=")[1] for file in UNITS.glob("iotcloud-*") for line in file.read_text().splitlines()
                 if line.startswith(("User=", "SocketUser=", "SupplementaryGroups=iotcloud"))}
        self.assertEqual(named, made)

    def set_of_calls(self, name):
        """The system calls of a word of SystemCallFilter: a call, or a set, with the sets in it."""
        if not name.startswith("@"):
            return {name}
        listed = self.analyze("syscall-filter", name).stdout.splitlines()
        words = [line.split()[0] for line in listed[1:] if line.strip() and not line.strip().startswith("#")]
        self.assertTrue(words, name)
        return set().union(*map(self.set_of_calls, words))

    def test_none_of_them_may_make_calls_by_the_kernels_rings(self):
        rings = {"io_uring_setup", "io_uring_enter", "io_uring_register"}
        self.assertLessEqual(rings, self.set_of_calls("@system-service"), "the sets of systemd allow them")
        for unit in self.units:
            allowed = set()
            for words in re.findall(r"^SystemCallFilter=(.*)$", unit.read_text(), re.MULTILINE):
                named = set().union(*map(self.set_of_calls, words.removeprefix("~").split()))
                allowed = allowed - named if words.startswith("~") else allowed | named
            self.assertIn("read", allowed, unit.name)
            self.assertEqual(allowed & rings, set(), unit.name)

    def test_their_daemons_may_do_little(self):
        for unit in self.units:
            done = self.analyze("security", "--offline=yes", f"--threshold={MOST_EXPOSED}", "--no-pager", str(unit))
            self.assertEqual(done.returncode, 0, done.stdout + done.stderr)


if __name__ == "__main__":
    if shutil.which("systemd-analyze") is None:
        print("systemd-analyze is not here: skipped")
        sys.exit(SKIPPED)
    unittest.main(argv=sys.argv[:1])

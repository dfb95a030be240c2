#!/usr/bin/python3
"""./dev storm up, status, down: Storm answers in the background, and nothing of it is left.

usage: usual_storm_test.py PROGRAM     (PROGRAM: iotcloud-storm)
"""
import os
import socket
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

import maven_jars
import private_server
from leftovers import left_behind

SCRIPT = Path(__file__).resolve().parent / "usual_storm.py"
SKIPPED = 77


class UsualStorm(unittest.TestCase):
    program = None

    def setUp(self):
        self.place = tempfile.TemporaryDirectory(prefix="iotcloud-usual-storm-")
        self.folder = self.place.name
        self.port = private_server.free_ports(1)[0]

    def tearDown(self):
        self.run_script("down")
        self.place.cleanup()

    def run_script(self, what):
        return subprocess.run(["/usr/bin/python3", SCRIPT, "--dir", self.folder, "--nimbus", str(self.port), what], text=True,
                              capture_output=True, check=False)

    def listed(self):
        return subprocess.run([self.program, "list", "-o", "json", "--patience", "0", "--nimbus", "127.0.0.1:%d" % self.port],
                              text=True, capture_output=True, check=False)

    def test_it_runs_in_the_background_until_it_is_ended(self):
        status = self.run_script("status")
        self.assertEqual((status.returncode, status.stdout), (1, "they do not run; ./dev storm up starts them\n"))
        for _ in range(2):  # its data are there again at the next `up`
            up = self.run_script("up")
            self.assertEqual((up.returncode, up.stdout), (0, "127.0.0.1:%d\n" % self.port), up.stderr)
            listed = self.listed()
            self.assertEqual((listed.returncode, listed.stdout.strip()), (0, "[]"), listed.stderr)
            status = self.run_script("status")
            self.assertEqual((status.returncode, status.stdout), (0, "they run\n"))
            again = self.run_script("up")
            self.assertEqual((again.returncode, again.stdout), (0, "they run already; ./dev storm down ends them\n"))
            down = self.run_script("down")
            self.assertEqual((down.returncode, down.stdout, down.stderr), (0, "", ""))
            self.assertEqual(left_behind(self.folder), {})
        self.assertIn("no Nimbus answers and leads", self.listed().stderr)
        self.assertEqual(self.run_script("down").stdout, "they do not run\n")

    def test_a_port_that_is_in_use_is_named(self):
        with socket.create_server(("127.0.0.1", self.port)):
            up = self.run_script("up")
        self.assertEqual(up.returncode, 1)
        self.assertIn("port %d, which is Nimbus's, is in use" % self.port, up.stderr)


if __name__ == "__main__":
    UsualStorm.program = Path(sys.argv[1])
    try:
        for jars in ("storm", "storm_worker"):
            maven_jars.fetch(jars)
    except private_server.Unavailable as reason:
        print(reason)
        sys.exit(1 if os.environ.get("CI") == "true" else SKIPPED)
    unittest.main(argv=sys.argv[:1])

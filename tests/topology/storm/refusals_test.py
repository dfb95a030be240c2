#!/usr/bin/python3
"""What `iotcloud-storm` refuses before anything reaches a cluster, and what it says when none answers.

usage: refusals_test.py BUILD LIBRARY OLD_LIBRARY FOREIGN_LIBRARY
       (LIBRARY: of components.cc; OLD_LIBRARY: of another SDK; FOREIGN_LIBRARY: of another C++ ABI)
"""
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "servers"))
from private_server import free_ports  # noqa: E402


class Refusals(unittest.TestCase):
    build = library = old = foreign = None

    def submit(self, library, spout="test.Numbers", more="", nimbus=("--nimbus", "127.0.0.1:1")):
        """The exit status and the error of a submission."""
        with tempfile.TemporaryDirectory(prefix="iotcloud-storm-") as folder:
            file = Path(folder) / "t.yaml"
            file.write_text("topology.name: t\ntopology.library: %s\nspouts:\n  in: {class: %s}\n%s" % (library, spout, more))
            done = subprocess.run([self.build / "bin" / "iotcloud-storm", "submit", file, "--patience", "0", *nimbus], text=True,
                                  capture_output=True, check=False)
        return done.returncode, done.stderr

    def test_a_library_that_is_not_there(self):
        status, said = self.submit("missing.so")
        self.assertEqual(status, 1)
        self.assertIn("t.yaml:2:1: topology.library: ", said)
        self.assertIn("missing.so", said)

    def test_a_class_that_is_not_there(self):
        status, said = self.submit(self.library, "test.Number")
        self.assertEqual(status, 1)
        self.assertIn('there is no class "test.Number"; did you mean "test.Numbers"?', said)

    def test_a_library_of_another_sdk(self):
        status, said = self.submit(self.old)
        self.assertEqual(status, 1)
        self.assertRegex(said, "topology SDK")

    def test_a_library_of_another_abi(self):
        status, said = self.submit(self.foreign)
        self.assertEqual(status, 1)
        self.assertIn('%s was built for C++ ABI "another", this program for "' % self.foreign, said)

    def test_what_storm_lacks(self):
        status, said = self.submit(self.library, more="bolts:\n  b: {class: test.Count, scope: worker, inputs: {from: in, grouping: global}}\n")
        self.assertEqual(status, 1)
        self.assertRegex(said, r"t\.yaml:6:\d+: bolts\.b\.scope: on Storm b gets the tuples of all workers")

    def test_no_nimbus(self):
        port = free_ports(1)[0]
        status, said = self.submit(self.library, nimbus=("--nimbus", "127.0.0.1:%d" % port))
        self.assertEqual(status, 1)
        self.assertIn("no Nimbus answers and leads (127.0.0.1:%d: " % port, said)
        status, said = self.submit(self.library, nimbus=())
        self.assertEqual(status, 1)
        self.assertIn("no Nimbus is named", said)


if __name__ == "__main__":
    Refusals.build, Refusals.library, Refusals.old, Refusals.foreign = map(Path, sys.argv[1:5])
    unittest.main(argv=sys.argv[:1])

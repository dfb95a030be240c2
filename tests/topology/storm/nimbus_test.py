#!/usr/bin/python3
"""What `iotcloud-storm` makes of the answers of Nimbuses that the test plays: it goes to the one that leads, also when another one
leads than before, says what the jar's sending does, and that a version of Storm was not tried.

usage: nimbus_test.py BUILD LIBRARY     (LIBRARY: of components.cc)
"""
import os
import re
import shutil
import subprocess
import sys
import tempfile
import unittest
import zipfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "servers"))
from fake_nimbus import FakeNimbus, topology  # noqa: E402


class Nimbuses(unittest.TestCase):
    build = library = None

    @classmethod
    def setUpClass(cls):
        """An installation whose jar of Java's classes has none: nobody here runs what is submitted."""
        cls.place = tempfile.TemporaryDirectory(prefix="iotcloud-storm-")
        cls.addClassCleanup(cls.place.cleanup)
        folder = Path(cls.place.name)
        library, classes = (folder / part / "iotcloud" / "storm" for part in ("lib", "share"))
        for made in (folder / "bin", library, classes):
            made.mkdir(parents=True)
        cls.program = shutil.copy(cls.build / "bin" / "iotcloud-storm", folder / "bin")
        shutil.copy(cls.library, library / "libiotcloud_storm.so")
        with zipfile.ZipFile(classes / "iotcloud-storm.jar", "w") as jar:
            jar.writestr("filler", os.urandom(2 << 20))  # several messages' worth
        cls.file = folder / "t.yaml"
        cls.file.write_text("topology.name: t\ntopology.library: %s\nspouts:\n  in: {class: test.Numbers}\n" % cls.library)

    def run_program(self, *words, patience="0"):
        return subprocess.run([self.program, *words, "--patience", patience], text=True, capture_output=True, check=False)

    def submit(self, nimbus):
        return self.run_program("submit", self.file, "--limit", "0", "--nimbus", nimbus.address)

    def test_the_leader_that_a_nimbus_names_is_asked(self):
        with FakeNimbus() as first, FakeNimbus() as leader:
            first.leads = leader.address
            leader.topologies["there"] = topology("there")
            done = self.run_program("list", "--nimbus", first.address)
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertIn("there", done.stdout)
            self.assertEqual(first.calls, ["getLeader"])
            self.assertEqual(leader.calls[0], "getTopologySummaries")

    def test_an_order_goes_to_the_next_leader_when_the_first_leads_no_longer(self):
        with FakeNimbus() as first, FakeNimbus() as second:
            def loses():
                first.leads = second.address
            first.failing["activate"] = loses
            done = self.run_program("activate", "t", "--nimbus", first.address)
            self.assertEqual((done.returncode, done.stderr), (0, ""))
            self.assertEqual((first.calls, second.calls), (["getLeader", "activate", "getLeader"], ["activate"]))

    def test_another_leader_is_waited_for_as_long_as_the_former_one_is_named(self):
        with FakeNimbus() as first, FakeNimbus() as second:
            answer = first.answer

            def answer_until_asked_often(method, arguments):
                if first.calls.count("getLeader") == 4:
                    first.leads = second.address
                return answer(method, arguments)
            first.answer, first.failing["activate"] = answer_until_asked_often, lambda: None
            done = self.run_program("activate", "t", "--nimbus", first.address, patience="60")
            self.assertEqual((done.returncode, done.stderr), (0, ""))
            self.assertEqual((first.calls, second.calls), (["getLeader", "activate"] + ["getLeader"] * 4, ["activate"]))

    def test_a_jar_is_sent_to_the_leader_that_takes_the_topology(self):
        with FakeNimbus() as first, FakeNimbus() as second:
            def loses():
                first.leads = second.address
            first.failing["submitTopologyWithOpts"] = loses
            done = self.submit(first)
            self.assertEqual(done.returncode, 0, done.stderr)
            self.assertEqual(done.stdout, "t was submitted to %s\n" % second.address)
            self.assertGreater(second.uploaded, 2 << 20)
            self.assertEqual(first.uploaded, second.uploaded)
            self.assertEqual([nimbus.calls.count("submitTopologyWithOpts") for nimbus in (first, second)], [1, 1])

    def test_an_error_of_a_nimbus_that_leads_is_told(self):
        with FakeNimbus() as nimbus:
            nimbus.failing["activate"] = lambda: None
            done = self.run_program("activate", "t", "--nimbus", nimbus.address)
            self.assertEqual(done.returncode, 1)
            self.assertIn("Nimbus %s failed: Internal error processing activate; no other one leads; its log says more" %
                          nimbus.address, done.stderr)
            self.assertEqual(nimbus.calls.count("activate"), 1)

    def test_why_no_other_leader_was_found_is_told(self):
        with FakeNimbus() as ended:
            pass
        with FakeNimbus() as nimbus:
            def loses():
                nimbus.leads = ended.address
            nimbus.failing["activate"] = loses
            done = self.run_program("activate", "t", "--nimbus", nimbus.address)
            self.assertEqual(done.returncode, 1)
            self.assertIn("no other one leads (%s: " % nimbus.address, done.stderr)

    def test_two_that_name_each_other_are_asked_once_each(self):
        with FakeNimbus() as first, FakeNimbus() as second:
            def loses():
                first.leads = second.address
            first.failing["activate"], second.failing["activate"] = loses, lambda: None
            done = self.run_program("activate", "t", "--nimbus", first.address)
            self.assertEqual(done.returncode, 1)
            self.assertIn("Nimbus %s failed" % second.address, done.stderr)
            self.assertEqual((first.calls.count("activate"), second.calls.count("activate")), (1, 1))

    def test_each_quarter_of_a_jar_is_told_where_no_terminal_is(self):
        with FakeNimbus() as nimbus:
            told = re.findall(r"^iotcloud-storm: sent (\d+) of (\d+) KiB$", self.submit(nimbus).stderr, re.M)
            self.assertEqual(len(told), 4)
            self.assertEqual(int(told[-1][0]), nimbus.uploaded // 1024)
            for number, (sent, whole) in enumerate(told, 1):
                self.assertGreaterEqual(int(sent), int(whole) * number // 4)

    def test_a_version_of_storm_that_was_not_tested_is_noted(self):
        with FakeNimbus(version="2.7.1") as other, FakeNimbus() as tested:
            said = "iotcloud-storm: Nimbus %s is of Storm 2.7.1; this was tested with 2.8.3" % other.address
            self.assertIn(said, self.submit(other).stderr)
            self.assertNotIn("this was tested with", self.submit(tested).stderr)


if __name__ == "__main__":
    Nimbuses.build, Nimbuses.library = map(Path, sys.argv[1:3])
    unittest.main(argv=sys.argv[:1])

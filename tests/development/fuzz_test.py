#!/usr/bin/python3
"""Tests what development/fuzz.py tells, with shell scripts in place of the fuzzers."""
import io
import sys
import tempfile
import unittest
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "development"))

import fuzz  # noqa: E402
import summary  # noqa: E402


class FuzzTest(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory(prefix="iotcloud-fuzz-")
        self.addCleanup(folder.cleanup)
        self.build = Path(folder.name)
        self.target("envelope", "echo 'stat::number_of_executed_units: 1234'")
        self.target("tuple", "echo 'ERROR: AddressSanitizer' >&2; exit 77")

    def target(self, name, script):
        program = self.build / f"bin/{name}_fuzzer"
        program.parent.mkdir(exist_ok=True)
        program.write_text(f"#!/bin/sh\n{script}\n")
        program.chmod(0o755)

    def run_them(self, *names):
        out = io.StringIO()
        return fuzz.run(names, 5, self.build, out), out.getvalue()

    def test_a_target_that_finds_something_does_not_end_the_others(self):
        found, said = self.run_them("tuple", "envelope")
        self.assertEqual(found, 1)
        self.assertIn("fuzz envelope: 1234 executions in 5 s, nothing found", said)
        self.assertIn("AddressSanitizer\nit found something", said)

    def test_each_target_is_a_test_of_the_summary(self):
        self.run_them("tuple", "envelope")
        tests = summary.read(self.build / "tests.xml")
        self.assertEqual({test.name: test.outcome for test in tests}, {"tuple": "failed", "envelope": "passed"})

    def test_how_far_it_is_counts_targets(self):
        targets = fuzz.Targets(24, 30)
        targets.left = 18
        self.assertEqual(targets.text()[0], "18 of 24 targets left, 30 s each")
        self.assertEqual(targets.share(), 0.25)


if __name__ == "__main__":
    unittest.main()

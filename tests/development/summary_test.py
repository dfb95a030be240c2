#!/usr/bin/python3
"""Tests how development/summary.py reads ctest's JUnit files."""
import contextlib
import io
import json
import re
import sys
import tempfile
import unittest
from pathlib import Path
from unittest import mock

TREE = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(TREE / "development"))

import summary  # noqa: E402

JUNIT = """<?xml version="1.0" encoding="UTF-8"?>
<testsuite name="Linux" tests="4" failures="1" disabled="0" skipped="2">
  <testcase name="Url.Reads" classname="Url.Reads" time="0.5" status="run"><system-out>fine</system-out></testcase>
  <testcase name="Slow.Fails" classname="Slow.Fails" time="12" status="fail"><failure message=""/>
    <system-out>no</system-out></testcase>
  <testcase name="DepthInversion.avx2" classname="x" time="0" status="notrun"><skipped message="SKIP_RETURN_CODE=77"/>
    <system-out>[ RUN      ] it
depth_inversion_test.cc:18: Skipped
this machine has no AVX2
[  SKIPPED ] it</system-out></testcase>
  <testcase name="Hosts.OfAnotherUser" classname="x" time="0" status="notrun"><skipped message=""/>
    <system-out>SKIPPED only root can become another user</system-out></testcase>
</testsuite>
"""
TEST = re.compile(r"^TEST_F\((\w+), (\w+)", re.MULTILINE)
CLASS = re.compile(r"^(?:class|struct) (\w+)(?: final)? : (?:public )?([\w:]+)", re.MULTILINE)
LIMITS = {"minutes": 1, "pace_s": 0.5, "slower_at_most": 1.25, "skips_allowed": {"avx2": ["not root", "no AVX2"]}}


class SummaryTest(unittest.TestCase):
    def setUp(self):
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "release", "tests.xml")
            file.parent.mkdir()
            file.write_text(JUNIT)
            self.tests = summary.read(file)

    def report(self, **given):
        out = io.StringIO()
        with contextlib.redirect_stdout(out):
            wrong = summary.report(self.tests, given.get("missing", []), given.get("steps", []), LIMITS, given.get("ci", False), True)
        return wrong, out.getvalue()

    @staticmethod
    def machine(**has):
        """A machine that has these causes, or has not; of the others nothing is changed."""
        return mock.patch.dict(summary.CAUSES, {cause: summary.CAUSES[cause]._replace(is_here=lambda so=so: so)
                                                for cause, so in has.items()})

    def test_reads_outcomes(self):
        self.assertEqual([(test.preset, test.outcome) for test in self.tests],
                         [("release", "passed"), ("release", "failed"), ("release", "skipped"), ("release", "skipped")])

    def test_says_why_tests_were_skipped(self):
        _, said = self.report()
        self.assertIn("DepthInversion.avx2 (release): this machine has no AVX2", said)
        self.assertIn("Hosts.OfAnotherUser (release): only root can become another user", said)

    def test_in_ci_only_the_skips_pass_that_are_allowed_for_a_cause_of_this_machine(self):
        for has_avx2, refused in {False: ["Hosts.OfAnotherUser"], True: ["DepthInversion.avx2", "Hosts.OfAnotherUser"]}.items():
            with self.machine(**{"not root": False, "no AVX2": not has_avx2}):
                wrong, _ = self.report(ci=True)
            self.assertEqual([text.split()[0] for text in wrong], refused)

    def test_in_ci_a_test_must_have_told_the_cause_for_which_its_skip_is_allowed(self):
        with self.machine(**{"not root": True, "no AVX2": True}):
            self.assertEqual(summary.allowed("avx2", "this machine has no AVX2", LIMITS["skips_allowed"]), "no AVX2")
            self.assertEqual(summary.allowed("avx2", "only root can see it", LIMITS["skips_allowed"]), "not root")
            self.assertIsNone(summary.allowed("avx2", "no server", LIMITS["skips_allowed"]))
        with self.machine(**{"not root": True, "no AVX2": False}):
            self.assertIsNone(summary.allowed("avx2", "this machine has no AVX2", LIMITS["skips_allowed"]))

    def test_tests_that_were_left_out_are_told_and_fail_in_ci(self):
        missing = [["components_run_on_storm", "it needs jni.h (Debian: openjdk)"]]
        wrong, said = self.report(missing=missing)
        self.assertEqual(wrong, [])
        self.assertIn("left out:\n  components_run_on_storm: it needs jni.h (Debian: openjdk)\n", said)
        with mock.patch.object(summary, "allowed", return_value="a cause"):
            self.assertEqual([text.split()[0] for text in self.report(missing=missing, ci=True)[0]], ["components_run_on_storm"])

    def test_tests_that_were_left_out_are_read_beside_the_results(self):
        with tempfile.TemporaryDirectory() as folder:
            junit = Path(folder, "tests.xml")
            junit.write_text(JUNIT)
            for listed, said in ((None, ""), ("", ""), ("on_storm\tit needs jni.h\n", ", 1 left out")):
                if listed is not None:
                    Path(folder, "tests_left_out.tsv").write_text(listed)
                out = io.StringIO()
                with mock.patch.object(sys, "argv", ["summary.py", str(junit)]), contextlib.redirect_stdout(out):
                    summary.main()
                self.assertTrue(out.getvalue().endswith(f"1 passed, 1 failed, 2 skipped{said}\n"), out.getvalue())

    def test_every_cause_for_a_skip_is_one_that_is_looked_at(self):
        named = {cause for causes in json.loads(summary.LIMITS.read_text())["skips_allowed"].values() for cause in causes}
        self.assertEqual(named, set(summary.CAUSES))
        for name, cause in summary.CAUSES.items():
            self.assertIn(cause.is_here(), (True, False), name)

    def test_what_tests_say_when_they_are_skipped_names_one_cause(self):
        told = [text for file in (TREE / "tests").rglob("*.cc")
                for text in re.findall(r'GTEST_SKIP\(\) << "([^"]*)"', file.read_text())]
        told += re.findall(r'skip\(f?"([^"]*)"', "".join(file.read_text() for file in (TREE / "tests/deploy").glob("*.py")))
        self.assertGreater(len(told), 10)
        elsewhere = {"there is no zsh", "systemd and unshare are needed", "no bare Debian"}  # packages, which ./dev installs
        for text in told:
            named = [name for name, cause in summary.CAUSES.items() if cause.said.search(text)]
            self.assertEqual(len(named), 0 if any(text.startswith(each) for each in elsewhere) else 1, text)

    def test_all_tests_that_boot_a_systemd_may_be_skipped_where_they_cannot(self):
        folder = TREE / "tests/deploy"
        calls = re.findall(r"NAME (\w+)[^#]*?/(\w+\.py)", (folder / "CMakeLists.txt").read_text())
        names = {name for name, script in calls if "require_means()" in (folder / script).read_text()}
        self.assertGreater(len(names), 2)
        allowed = json.loads(summary.LIMITS.read_text())["skips_allowed"]
        self.assertEqual({name for name in names if not any(re.search(each, name) for each in allowed)}, set())

    def test_all_tests_that_need_a_part_of_the_kernel_may_be_skipped_where_it_is_missing(self):
        causes = {"this kernel has no Landlock": "Landlock older than 1", "this kernel cannot restrict connections": "Landlock older than 4"}
        texts = [file.read_text() for file in (TREE / "tests").rglob("*.cc")]
        tests = [found.groups() for text in texts for found in TEST.finditer(text)]
        derived = [found.groups() for text in texts for found in CLASS.finditer(text)]
        allowed = json.loads(summary.LIMITS.read_text())["skips_allowed"]
        seen = set()
        for text in texts:
            for skip in re.finditer(r'GTEST_SKIP\(\) << "(this kernel[^"]*)"', text):
                before = [found for pattern in (TEST, CLASS) for found in pattern.finditer(text, 0, skip.start())]
                place = max(before, key=lambda found: found.start())
                names = {place[0].removeprefix("TEST_F(").replace(", ", ".")}
                if place.re is CLASS:  # all tests of the fixture, and of those that are made of it
                    fixtures = {place[1]}
                    while more := {name for name, base in derived if base in fixtures} - fixtures:
                        fixtures |= more
                    names = {f"{suite}.{name}" for suite, name in tests if suite in fixtures}
                self.assertTrue(names)
                seen |= names
                for name in names:
                    found = [cause for pattern, named in allowed.items() if re.search(pattern, name) for cause in named]
                    self.assertIn(causes[skip[1]], found, name)
        self.assertGreater(len({name.split(".")[0] for name in seen}), 3)

    def test_in_ci_the_whole_must_stay_within_its_minutes(self):
        steps = [(50, "building", 0.5, 100), (20, "testing", 0.4, 40)]
        self.assertEqual(self.report(steps=steps)[0], [])
        self.assertTrue(any("70 s" in text for text in self.report(ci=True, steps=steps)[0]))

    def test_a_slower_machine_is_allowed_more_minutes(self):
        steps = [(50, "building", 0.7, 100), (20, "testing", 0.6, 40), (1, "linting", 0.5, 2)]
        self.assertFalse(any("the whole took" in text for text in self.report(ci=True, steps=steps)[0]))
        steps = [(50, "building", 0.7, 100), (23, "testing", 0.6, 46), (1, "linting", 0.5, 2)]
        self.assertTrue(any("1.20 times as much" in text for text in self.report(ci=True, steps=steps)[0]))

    def test_a_much_slower_machine_is_not_allowed_ever_more(self):
        steps = [(50, "building", 1.5, 100), (24, "testing", 1.5, 40)]
        self.assertFalse(any("the whole took" in text for text in self.report(ci=True, steps=steps)[0]))
        steps = [(50, "building", 1.5, 100), (26, "testing", 1.5, 40)]
        self.assertTrue(any("75 s are allowed" in text for text in self.report(ci=True, steps=steps)[0]))

    def test_tells_the_cpu_time_of_each_step_and_of_all(self):
        _, said = self.report(steps=[(50, "building", 0.5, 90), (20, "testing", 0.5, 400)])
        self.assertIn("50 s  building (90 s of CPU)", said)
        self.assertIn("70 s  in all (8.2 min of CPU)", said)

    def test_names_files_that_clang_tidy_had_no_time_for(self):
        with tempfile.TemporaryDirectory() as folder:
            junit, left_out = Path(folder, "tests.xml"), Path(folder, "left_out")
            junit.write_text(JUNIT)
            for names, said in (("a.cc\nb c.h\n", True), ("", False)):
                left_out.write_text(names)
                out = io.StringIO()
                with mock.patch.object(sys, "argv", ["summary.py", "--left-out", str(left_out), str(junit)]), \
                        contextlib.redirect_stdout(out):
                    summary.main()
                self.assertEqual("no time for 2 files" in out.getvalue() and "a.cc b c.h" in out.getvalue(), said)

    def test_a_preset_that_was_not_built_is_a_failure_and_a_line_of_the_table(self):
        with tempfile.TemporaryDirectory() as folder:
            table = Path(folder, "long/tests.tsv")
            out = io.StringIO()
            with mock.patch.object(sys, "argv", ["summary.py", "--table", str(table), "--not-built", "asan fuzz"]), \
                    contextlib.redirect_stdout(out):
                self.assertEqual(summary.main(), 1)
            self.assertIn("0 passed, 2 failed, 0 skipped", out.getvalue())
            self.assertIn("asan\tbuilding\tfailed\t0.00\nfuzz\tbuilding\tfailed\t0.00\n", table.read_text())

    def test_names_the_slowest_first(self):
        _, said = self.report()
        self.assertLess(said.index("Slow.Fails"), said.index("Url.Reads"))


if __name__ == "__main__":
    unittest.main()

#!/usr/bin/python3
"""Tests how development/repeat.py reads ctest's summary and names a commit, and which runs it makes; no suite is run."""
import contextlib
import io
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path
from unittest import mock

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "development"))

import repeat  # noqa: E402

FAILED = """
50% tests passed, 2 tests failed out of 4

The following tests did not run:
\t  3 - Zsh.Completes (Skipped)

The following tests FAILED:
\t  1 - Url.Reads (Failed)
\t  4 - brokers_contract_test.kafka (Timeout)
Errors while running CTest
"""


class OutcomeTest(unittest.TestCase):
    def test_names_what_failed_and_not_what_was_skipped(self):
        self.assertEqual(repeat.outcome(FAILED), (4, ["Url.Reads", "brokers_contract_test.kafka"]))

    def test_nothing_failed(self):
        self.assertEqual(repeat.outcome("100% tests passed, 0 tests failed out of 7\n"), (7, []))

    def test_a_run_without_a_summary_is_no_success(self):
        with self.assertRaises(ValueError):
            repeat.outcome("No tests were found!!!\n")


CLEAN = "100% tests passed, 0 tests failed out of 7\n"


class RowTest(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory(prefix="iotcloud-repeat-")
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)
        self.table = self.folder / "chosen-R-Url.tsv"
        self.busy = []  # processes that keep cores busy now

    def repeat(self, runs, *said):
        """Runs main() with a suite that says these texts, one each time, then stops it as a person does. Returns its
        exit status, None when it was stopped, and of each run whether cores were kept busy meanwhile."""
        texts, loads = iter(said), []

        def suite(_build, options):
            self.assertEqual(options, ["-R", "Url"])
            loads.append(bool(self.busy))
            try:
                return next(texts)
            except StopIteration:
                raise KeyboardInterrupt from None

        def burners():
            process = mock.Mock(spec=subprocess.Popen)
            process.wait.side_effect = lambda: self.busy.remove(process)
            self.busy.append(process)
            return [process]

        words = ["repeat.py", str(runs), "--out", str(self.folder), "-R", "Url"]
        with (mock.patch.object(repeat, "run_suite", suite), mock.patch.object(repeat, "burners", burners),
              mock.patch.object(repeat, "commit_of", return_value="abc"), mock.patch.object(repeat.signal, "signal"),
              mock.patch.object(sys, "argv", words), contextlib.redirect_stdout(io.StringIO())):
            try:
                status = repeat.main()
            except KeyboardInterrupt:
                status = None
        self.assertEqual(self.busy, [])
        return status, loads

    def rows(self):
        return [line.split("\t") for line in self.table.read_text().splitlines()[1:]]

    def test_every_second_run_of_a_row_is_beside_busy_cores(self):
        self.assertEqual(self.repeat(4, *[CLEAN] * 4), (0, [False, True, False, True]))
        self.assertEqual([(row[0], row[2], row[6]) for row in self.rows()],
                         [("1", "idle", "0"), ("2", "loaded", "0"), ("3", "idle", "0"), ("4", "loaded", "0")])
        self.assertEqual(self.repeat(4), (0, []))

    def test_a_row_that_was_stopped_goes_on(self):
        self.assertEqual(self.repeat(4, CLEAN), (None, [False, True]))
        self.assertEqual(self.repeat(4, *[CLEAN] * 3), (0, [True, False, True]))
        self.assertEqual([row[0] for row in self.rows()], ["1", "2", "3", "4"])

    def test_a_failure_ends_it_and_the_row_begins_anew(self):
        self.assertEqual(self.repeat(4, CLEAN, FAILED), (1, [False, True]))
        self.assertEqual(self.rows()[1][6:], ["2", "Url.Reads brokers_contract_test.kafka"])
        self.assertIn("Url.Reads", (self.folder / "run-2.log").read_text())
        self.assertEqual(self.repeat(2, CLEAN, CLEAN), (0, [False, True]))
        self.assertEqual(len(self.rows()), 4)

    def test_of_a_row_that_began_beside_busy_cores_half_is_so(self):
        self.table.write_text(repeat.HEAD + "1\tabc\tidle\tnow\t9\t7\t1\tUrl.Reads\n2\tabc\tloaded\tnow\t9\t7\t0\t\n")
        self.assertEqual(self.repeat(4, *[CLEAN] * 3), (0, [False, False, True]))


class TableTest(unittest.TestCase):
    def test_runs_of_chosen_tests_do_not_count_as_runs_of_the_suite(self):
        tables = [repeat.table_for(options, Path("out")) for options in ([], ["-R", "Url"], ["-L", "^room:brokers$"])]
        self.assertEqual(tables, [repeat.TREE / "development/repeats.tsv", Path("out/chosen-R-Url.tsv"),
                                  Path("out/chosen-L-room-brokers-.tsv")])


class CommitTest(unittest.TestCase):
    def test_a_changed_table_is_no_change_of_the_tree(self):
        with tempfile.TemporaryDirectory() as folder:
            tree = Path(folder)
            def git(*words):
                subprocess.run(["git", "-C", folder, "-c", "user.name=t", "-c", "user.email=t@t", *words], check=True,
                               capture_output=True)
            git("init")
            (tree / "runs.tsv").write_text("head\n")
            (tree / "source").write_text("a\n")
            git("add", "-A")
            git("commit", "-m", "first")
            (tree / "runs.tsv").write_text("head\nrun\n")
            self.assertRegex(repeat.commit_of(tree, tree / "runs.tsv"), "^[0-9a-f]+$")
            (tree / "source").write_text("b\n")
            self.assertRegex(repeat.commit_of(tree, tree / "runs.tsv"), "^[0-9a-f]+-modified$")


if __name__ == "__main__":
    unittest.main()

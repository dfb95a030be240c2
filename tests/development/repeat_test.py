#!/usr/bin/python3
"""Tests how development/repeat.py reads ctest's summary and names a commit."""
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

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

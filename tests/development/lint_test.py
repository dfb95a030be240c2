#!/usr/bin/python3
"""Tests which files development/lint.py gives to clang-tidy, with a program in its place."""
import json
import os
import shutil
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

LINT = Path(__file__).resolve().parents[2] / "development/lint.py"
TIDY = """#!/bin/sh
for file; do :; done
echo "$file" >>looked_at
! grep -q bad "$file"
"""


class LintTest(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory(prefix="iotcloud-lint-")
        self.addCleanup(folder.cleanup)
        self.tree = Path(folder.name)
        self.git("init", "-q")
        (self.tree / "clang-tidy-14").write_text(TIDY)
        (self.tree / "clang-tidy-14").chmod(0o755)
        (self.tree / ".gitignore").write_text("build\nlooked_at\nclang-tidy-14\n__pycache__\n")
        self.write("good.cc", "int good;")
        self.write("bad.cc", "int bad;")
        self.write("any.h", "int any;")
        (self.tree / "development").mkdir()
        for name in ("lint.py", "progress.py", "limits.json"):
            shutil.copy(LINT.parent / name, self.tree / "development")
        self.git("add", ".")
        self.git("commit", "-q", "-m", "all")

    def git(self, *words):
        subprocess.run(["git", "-c", "user.name=it", "-c", "user.email=it@localhost", *words], cwd=self.tree, check=True)

    def write(self, name, text):
        (self.tree / name).write_text(text)

    def lint(self, *options, status):
        """Returns the files that clang-tidy looked at, and what was printed."""
        looked_at = self.tree / "looked_at"
        looked_at.write_text("")
        done = subprocess.run([sys.executable, "development/lint.py", "--build", "build", *options], cwd=self.tree,
                              text=True, capture_output=True,
                              env={**os.environ, "PATH": f"{self.tree}:{os.environ['PATH']}"})
        self.assertEqual(done.returncode, status, done.stderr)
        return sorted(looked_at.read_text().split()), done.stdout

    def test_only_what_is_not_known_to_be_clean_is_looked_at(self):
        self.assertEqual(self.lint(status=1)[0], ["bad.cc", "good.cc"])
        looked_at, said = self.lint(status=1)
        self.assertEqual(looked_at, ["bad.cc"])
        self.assertIn("2 files; 1 are as they were", said)
        self.write("bad.cc", "int mended;")
        self.assertEqual(self.lint(status=0)[0], ["bad.cc"])
        self.assertEqual(self.lint(status=0)[0], [])

    def test_a_change_is_looked_at(self):
        self.write("bad.cc", "int mended;")
        self.lint(status=0)
        self.write("good.cc", "int better;")
        self.assertEqual(self.lint(status=0)[0], ["good.cc"])

    def test_a_change_of_a_header_or_an_option_is_a_change_of_all(self):
        self.write("bad.cc", "int mended;")
        self.lint(status=0)
        self.write("any.h", "int other;")
        self.assertEqual(self.lint(status=0)[0], ["bad.cc", "good.cc"])
        self.write(".clang-tidy", "Checks: all")
        self.assertEqual(self.lint(status=0)[0], ["bad.cc", "good.cc"])

    def test_what_was_not_looked_at_in_time_is_named_and_not_taken_for_clean(self):
        limits = self.tree / "development/limits.json"
        limits.write_text(json.dumps({**json.loads(limits.read_text()), "lint_seconds": 0}))
        looked_at, said = self.lint("--in-time", status=0)
        self.assertEqual(looked_at, [])
        self.assertRegex(said, "; 2 left out after 0 s: (bad.cc good.cc|good.cc bad.cc)\n$")
        self.assertEqual(self.lint(status=1)[0], ["bad.cc", "good.cc"])

    def test_in_a_new_folder_each_commit_begins_at_another_file(self):
        limits = self.tree / "development/limits.json"
        limits.write_text(json.dumps({**json.loads(limits.read_text()), "lint_seconds": 0}))
        first = set()
        for count in range(40):
            self.git("commit", "-q", "--allow-empty", "-m", f"{count}")
            shutil.rmtree(self.tree / "build", ignore_errors=True)
            self.lint("--in-time", status=0)
            first.add((self.tree / "build/left_out").read_text().split()[0])
            if len(first) == 2:
                break
        self.assertEqual(first, {"bad.cc", "good.cc"})

    def test_what_was_left_out_is_looked_at_in_the_next_run_whatever_changed_there(self):
        limits = self.tree / "development/limits.json"
        text = limits.read_text()
        limits.write_text(json.dumps({**json.loads(text), "lint_seconds": 0}))
        self.write("good.cc", "int better;")
        self.lint("--since", "HEAD", "--in-time", status=0)
        self.assertEqual((self.tree / "build/left_out").read_text(), "good.cc\n")
        self.git("commit", "-q", "-a", "-m", "better")
        self.write("a.cc", "int a;")
        limits.write_text(text)
        self.assertEqual(self.lint("--since", "HEAD", "--in-time", status=0)[0], ["a.cc", "good.cc"])
        self.assertEqual((self.tree / "build/left_out").read_text(), "")
        self.assertEqual(self.lint("--since", "HEAD", status=0)[0], [])

    def test_since_a_commit_what_changed_and_what_git_does_not_know_is_looked_at(self):
        self.write("good.cc", "int better;")
        self.write("new.cc", "int it;")
        self.write("new with a space.h", "int it;")
        self.assertEqual(self.lint("--since", "HEAD", status=0)[0], sorted("good.cc new.cc new with a space.h".split()))
        self.assertEqual(self.lint(status=1)[0], ["bad.cc"])
        self.git("mv", "bad.cc", "worse.cc")
        self.assertEqual(self.lint("--since", "HEAD", status=1)[0], ["worse.cc"])


if __name__ == "__main__":
    unittest.main()

#!/usr/bin/python3
"""The checker finds long subjects of new commits, in whatever clone it runs."""

import subprocess
import tempfile
import unittest
from pathlib import Path

import check_subjects

FITS, LONG = "x" * 72, "y" * 73


class CheckSubjects(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory(prefix="iotcloud-subjects-")
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)
        self.upstream = self.folder / "upstream"
        self.git("init", "-q", "-b", "main", self.upstream, at=self.folder)

    def git(self, *words, at=None):
        subprocess.run(["git", "-c", "user.name=it", "-c", "user.email=it@localhost", *map(str, words)], cwd=at or self.upstream,
                       check=True, capture_output=True)

    def commit(self, *subjects, at=None):
        for subject in subjects:
            self.git("commit", "-q", "--allow-empty", "-m", subject, at=at)

    def clone(self, *options):
        self.git("clone", "-q", *options, f"file://{self.upstream}", self.folder / "clone", at=self.folder)
        return self.folder / "clone"

    def found(self, where):
        """The first letters of the subjects that are found."""
        return [line.split("'")[1][0] for line in check_subjects.check(str(where))]

    def test_without_an_upstream_the_last_commit_is_new(self):
        self.commit(LONG)
        self.assertEqual(self.found(self.upstream), ["y"])
        self.commit(FITS)
        self.assertEqual(self.found(self.upstream), [])

    def test_all_commits_since_the_upstreams_main_are_new(self):
        self.commit(LONG)
        clone = self.clone()
        self.commit("z" * 80, FITS, at=clone)
        self.assertEqual(self.found(clone), ["z"])

    def test_a_fresh_clone_and_a_shallow_one_are_checked(self):
        self.commit(LONG, LONG, FITS)
        self.assertEqual(self.found(self.clone("--depth", "1")), [])
        self.commit(LONG)
        clone = self.folder / "clone"
        self.git("pull", "-q", at=clone)
        self.assertEqual(self.found(clone), ["y"])

    def test_a_merge_may_name_a_long_branch(self):
        self.commit(FITS)
        self.git("switch", "-q", "-c", "other")
        self.commit(FITS)
        self.git("switch", "-q", "main")
        self.git("merge", "-q", "--no-ff", "-m", LONG, "other")
        self.assertEqual(self.found(self.upstream), [])


if __name__ == "__main__":
    unittest.main()

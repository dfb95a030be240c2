#!/usr/bin/python3
"""The checker finds what it is there to find, and nothing else."""

import tempfile
import unittest
from pathlib import Path

import check_documents


class CheckDocuments(unittest.TestCase):
    def problems(self, text):
        with tempfile.TemporaryDirectory() as folder:
            root = Path(folder)
            (root / "there.h").write_text("")
            (root / "meters.cc").write_text('counter("iotcloud_things_total");')
            file = root / "README.md"
            file.write_text(f"first\n{text}\n")
            return list(check_documents.problems(root, [file], {"test", "bench", "bench codec"}))

    def test_a_link_to_nothing_is_named_with_file_and_line(self):
        self.assertEqual(self.problems("see [it](gone.h)"), ["README.md:2: there is no gone.h"])

    def test_links_that_lead_somewhere_are_good(self):
        self.assertEqual(self.problems("[a](there.h), [b](there.h#part), [c](https://example.org/gone), [d](#part)"), [])

    def test_a_command_that_dev_does_not_know_is_named(self):
        self.assertEqual(self.problems("`./dev tests`"), ["README.md:2: there is no ./dev tests"])
        self.assertEqual(self.problems("`./dev bench codecs`"), ["README.md:2: there is no ./dev bench codecs"])

    def test_commands_that_dev_knows_are_good(self):
        self.assertEqual(self.problems("`./dev test --long`, `./dev bench`, `./dev bench codec --quick`"), [])

    def test_a_metric_that_nobody_counts_is_named(self):
        self.assertEqual(self.problems("`iotcloud_things_total`"), [])
        self.assertEqual(self.problems("`iotcloud_thing_total`"), ["README.md:2: there is no metric iotcloud_thing_total"])


if __name__ == "__main__":
    unittest.main()

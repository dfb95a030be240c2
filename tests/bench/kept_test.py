#!/usr/bin/python3
"""Results that the project keeps, and the documents that show them."""
import contextlib
import io
import json
import tempfile
import unittest
from pathlib import Path

import figures
import kept

DATA = {"machine": {"cpu": "Some CPU", "cores": 2, "load_average_before": 0.25}, "commit": "0123456789abcdef", "command": "./dev bench paper --figure 7",
        "taken": "2026-11-23T07:00:00+00:00", "versions": {"RabbitMQ": "3.10.8"},
        "plots": [{"title": "Mean", "x": "size", "series": [{"name": "ours", "kind": "ours", "points": [{"x": 1, "mean_ms": 1}]}]}],
        "results": [
            {"name": "100 B: mean", "value": 0.5, "unit": "ms", "baseline": "librabbitmq", "baseline_value": 0.4, "ratio": 1.25,
             "ratio_spread": [1.1, 1.3], "target": "<= 1.2 x", "met": False},
            {"name": "100 B: p50 | p99", "value": 2000, "unit": "/s", "baseline": None, "baseline_value": None, "ratio": None,
             "target": None, "met": None}]}
BLOCK = "# a\n\nSaid before.\n<!-- result: {} -->\nold\n<!-- end of result -->\nSaid behind.\n"


class KeptTest(unittest.TestCase):
    def setUp(self):
        temporary = tempfile.TemporaryDirectory()
        self.addCleanup(temporary.cleanup)
        self.root = Path(temporary.name)
        self.take()

    def test_a_command_is_told_without_where_its_programs_and_figures_are(self):
        typed = ["brokers", "--build", "x", "--quick", "--json", "y", "--figures", "60 KB", "--out=z"]
        self.assertEqual(figures.command_line(typed), "./dev bench brokers --quick --figures '60 KB'")

    def take(self, name="paper/figure-7", **other):
        file = self.root / f"build/bench/{name}.json"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(json.dumps({**DATA, **other}))

    def document(self, block="paper/figure-7", name="README.md"):
        file = self.root / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(BLOCK.format(block))
        return file

    def test_a_document_shows_what_was_kept_and_of_what_it_is(self):
        document = self.document()
        self.assertEqual(len(kept.check(self.root)), 1)
        self.assertEqual(kept.keep(self.root, ["paper/figure-7"]), ["paper/figure-7"])
        text = document.read_text()
        self.assertIn("`./dev bench paper --figure 7`, commit 0123456789ab, Some CPU, 2 cores, load 0.25 before, RabbitMQ 3.10.8, taken 2026-11-23", text)
        self.assertIn("| 100 B: mean | 0.5 ms | 0.4 librabbitmq | 1.25 (1.1 to 1.3) | <= 1.2 x, **missed** |", text)
        self.assertNotIn("p50", text)  # it has no target
        self.assertNotIn("old", text)
        self.assertTrue(text.startswith("# a\n\nSaid before.\n") and text.endswith("\nSaid behind.\n"))
        self.assertIn("![Mean](bench/results/plots/figure-7-1.svg)", text)
        self.assertTrue((self.root / "bench/results/plots/figure-7-1.svg").exists())
        self.assertEqual(kept.check(self.root), [])

    def test_a_document_in_a_folder_finds_the_pictures(self):
        document = self.document(name="bench/README.md")
        kept.keep(self.root, [])
        picture = document.read_text().partition("![Mean](")[2].partition(")")[0]
        self.assertTrue((document.parent / picture).exists(), picture)

    def test_an_expression_chooses_figures(self):
        document = self.document("paper/figure-7 p50|p90")
        kept.keep(self.root, [])
        self.assertIn("| 100 B: p50 \\| p99 | 2,000 /s |", document.read_text())
        self.assertNotIn("100 B: mean", document.read_text())
        self.document("paper/figure-7 nothing")
        self.assertIn("no figure that is called 'nothing'", kept.check(self.root)[0])

    def test_without_a_run_the_document_says_how_to_take_one(self):
        for name, command in (("paper/figure-12", "paper --figure 12"), ("paper/storm", "storm"), ("paper/storm-soak", "storm --soak"), ("runtime", "runtime")):
            document = self.document(name)
            self.assertIn("README.md: a block is not what its file says", kept.check(self.root)[0])
            (self.root / "build/bench/paper/figure-7.json").unlink(missing_ok=True)
            kept.keep(self.root, [])
            self.assertIn(f"`./dev bench {command}` takes these figures", document.read_text())
            self.assertEqual(kept.check(self.root), [])

    def test_figures_of_sources_that_no_commit_has_are_refused(self):
        kept.keep(self.root, [])
        before = (self.root / "bench/results/paper/figure-7.json").read_text()
        self.take("brokers")
        self.take(commit="0123-modified")
        with self.assertRaises(kept.Unusable):
            kept.keep(self.root, ["brokers", "paper/figure-7"])
        self.assertEqual((self.root / "bench/results/paper/figure-7.json").read_text(), before)
        self.assertFalse((self.root / "bench/results/brokers.json").exists())

    def test_without_names_what_cannot_be_kept_is_skipped_with_a_line(self):
        self.take("brokers")
        self.take("interop", commit="0123-modified")
        self.take("fleet", failed="a client ended")
        said = io.StringIO()
        with contextlib.redirect_stdout(said):
            self.assertEqual(kept.keep(self.root, []), ["brokers", "paper/figure-7"])
        self.assertRegex(said.getvalue(), r"skipped: .*fleet.json is of a run that failed: a client ended\n"
                                          r"skipped: .*interop.json is of sources that no commit has")
        self.assertFalse((self.root / "bench/results/interop.json").exists())
        with self.assertRaises(kept.Unusable):
            kept.keep(self.root, ["fleet"])

    def test_figures_that_do_not_say_of_what_they_are_are_found(self):
        kept.keep(self.root, [])
        file = self.root / "bench/results/paper/figure-7.json"
        for text in ("[]", "{}", "{", json.dumps({**DATA, "commit": "0123-modified"})):
            file.write_text(text)
            self.assertEqual(len(kept.check(self.root)), 1, text)

    def test_a_figure_that_somebody_typed_is_found(self):
        document = self.document()
        kept.keep(self.root, [])
        document.write_text(document.read_text().replace("0.5 ms", "0.4 ms"))
        self.assertEqual(kept.check(self.root), ["README.md: a block is not what its file says; ./dev bench keep writes it"])


if __name__ == "__main__":
    unittest.main()

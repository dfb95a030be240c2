#!/usr/bin/python3
"""How the discovery benchmark judges rounds that had company, and what its file says when it failed; no program runs."""
import contextlib
import io
import json
import tempfile
import unittest
from pathlib import Path
from unittest import mock

import discovery_report
import kept
import report as benchmarks
from brokers_report import Report
from discovery_report import newcomers

P99 = "fleet: a new driver is read, p99"


class NewcomersTest(unittest.TestCase):
    def judged(self, *rounds):
        """`rounds`: p99 in ms and CPUs that others took. Returns value and verdict of the p99, and what was printed."""
        report, said = Report(), io.StringIO()
        lines = [{"p50_ms": 50.0, "p99_ms": p99, "p99_waited_ms": 9.0, "others_cpu": others, "requests_each": 9.0}
                 for p99, others in rounds]
        with contextlib.redirect_stdout(said):
            newcomers(report, "fleet", lines)
        found = next(result for result in report.results if result["name"] == P99)
        return found["value"], found["met"], said.getvalue()

    def test_quiet_rounds_are_judged(self):
        self.assertEqual(self.judged((60.0, 0.1), (70.0, 0.2), (80.0, 0.0))[:2], (70.0, True))

    def test_a_late_driver_in_a_quiet_round_misses_the_target(self):
        value, met, said = self.judged((300.0, 0.1))
        self.assertEqual((value, met), (300.0, False))
        self.assertNotIn("other processes took", said)

    def test_a_round_with_company_is_left_out(self):
        value, met, said = self.judged((60.0, 0.1), (360.0, 1.5), (70.0, 0.1))
        self.assertEqual((value, met), (65.0, True))
        self.assertIn("in 1 of 3 rounds other processes took more than 0.2 of a CPU; left out", said)

    def test_with_company_all_the_time_the_figure_is_shown_and_not_judged(self):
        value, met, said = self.judged((360.0, 1.5))
        self.assertEqual((value, met), (360.0, None))
        self.assertIn("not judged: no round was quiet", said)


class FileTest(unittest.TestCase):
    """What `./dev bench discovery` leaves behind."""

    def run_with(self, figures):
        """Runs it with `figures` in place of the measurement, in a tree that is committed. Returns status and file."""
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        file = Path(folder.name) / "discovery.json"
        with mock.patch.object(discovery_report, "figures", figures), mock.patch.object(discovery_report, "selection"), \
                mock.patch.object(benchmarks, "commit", return_value="0123"), mock.patch.object(benchmarks.signal, "signal"), \
                mock.patch("sys.argv", ["report.py", "discovery", "--json", str(file)]), \
                contextlib.redirect_stdout(io.StringIO()), self.assertRaises(SystemExit) as ended:
            benchmarks.main()
        return ended.exception.code, file

    def test_a_fleet_that_is_given_up_fails_and_the_file_cannot_be_kept(self):
        def figures(_bench, report, kind, _rounds):
            if kind == "exclusive":
                raise discovery_report.StartError("no server")
            report.compare(f"{kind}: ready", "s", [1.0])
        status, file = self.run_with(figures)
        self.assertEqual((status, json.loads(file.read_text())["failed"]), (1, "exclusive: GIVEN UP: no server"))
        with self.assertRaisesRegex(kept.Unusable, "is of a run that failed: exclusive: GIVEN UP: no server"):
            kept.read(file)

    def test_a_good_run_can_be_kept(self):
        status, file = self.run_with(lambda _bench, report, kind, _rounds: report.compare(f"{kind}: ready", "s", [1.0]))
        self.assertEqual((status, [each["name"] for each in kept.read(file)["results"]]), (0, ["shared: ready", "exclusive: ready"]))


if __name__ == "__main__":
    unittest.main()

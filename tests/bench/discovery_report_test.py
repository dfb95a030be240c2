#!/usr/bin/python3
"""How the discovery benchmark judges rounds that had company; no program runs."""
import contextlib
import io
import unittest

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


if __name__ == "__main__":
    unittest.main()

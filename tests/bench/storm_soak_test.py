#!/usr/bin/python3
"""How the memory of Storm's workers is judged; no program runs."""
import contextlib
import io
import types
import unittest
from unittest import mock

import storm_soak
from brokers_report import Report
from figures import ProgramFailed
from paper import report as paper_report
from storm_board import FULL, Counts
from storm_soak import Soak, alive_mb, growth, slope

GC_LOG = """[0.012s] Using G1
[10.1s] GC(0) Pause Young (Normal) (G1 Evacuation Pause) 614M->12M(1024M) 5.123ms
[11.2s] GC(1) Concurrent Mark Cycle 3.1ms
[12.3s] GC(1) Pause Remark 20M->18M(1024M) 1.0ms
"""


class Workers:
    """Two workers on a Storm of its own clock, in which each sample of memory is `grown` MB above the one before."""

    def __init__(self, grown, carried=1.0):
        self.grown, self.carried, self.time, self.rate, self.ids, self.samples = grown, carried, 0.0, 0, [7, 8], 0
        self.sides = {storm_soak.CPP: self}
        self.board = types.SimpleNamespace(send=self.send, counts=self.counts)

    @contextlib.contextmanager
    def phase(self, *_):
        yield

    def turn(self, _side, rate, _seconds):
        return {"per_second": 1e5} if rate == FULL else None

    def send(self, rate):
        self.rate = rate

    def counts(self):
        results = round(self.time * self.rate * 10 * self.carried)
        return Counts(results, results, 0, ())

    def processes(self):
        return list(self.ids)

    def resident(self, _process):
        self.samples += 1
        return 500 + self.grown * self.samples / len(self.ids)

    def sleep(self, seconds):
        self.time += seconds

    def logs(self, _pattern):
        return [GC_LOG] * 2

    def errors(self):
        return "; a worker says: boom"

    def go_on(self):
        pass

    drain = go_on


class StormSoakTest(unittest.TestCase):
    def setUp(self):
        out = contextlib.redirect_stdout(io.StringIO())
        out.__enter__()
        self.addCleanup(out.__exit__, None, None, None)

    def soak(self, workers, minutes=10):
        report = Report()
        soak = Soak(workers, minutes, report, mock.Mock(), lambda: workers.time, workers.sleep)
        with mock.patch.object(storm_soak, "resident_mb", workers.resident):
            plots = soak.run()
        return {each["name"].rpartition(": ")[2]: each for each in report.results}, plots

    def test_the_load_is_a_part_of_the_highest_rate_and_its_results_are_counted(self):
        results, _ = self.soak(Workers(0))
        self.assertEqual((results["carried"]["value"], results["carried"]["baseline_value"]), (80.0, 80.0))
        self.assertTrue(results["carried"]["met"])
        self.assertFalse(self.soak(Workers(0, carried=0.9))[0]["carried"]["met"])

    def test_memory_that_stays_is_met_and_memory_that_grows_is_missed(self):
        self.assertTrue(self.soak(Workers(0))[0]["growth of a worker's memory"]["met"])
        results, plots = self.soak(Workers(0.1))
        self.assertFalse(results["growth of a worker's memory"]["met"])
        self.assertAlmostEqual(results["slope of a worker's memory"]["value"], 3600 * 0.1 / storm_soak.PERIOD_S, places=3)
        self.assertEqual(len(plots[0]["series"]), 2)

    def test_a_worker_that_was_started_again_fails_the_run(self):
        workers = Workers(0)
        workers.sleep = lambda seconds: (setattr(workers, "time", workers.time + seconds), setattr(workers, "ids", [7, 9]))
        with self.assertRaisesRegex(ProgramFailed, "a worker ended under load; a worker says: boom"):
            self.soak(workers)

    def test_growth_is_between_medians_of_quarters_and_the_first_quarter_does_not_count(self):
        self.assertEqual(growth([0, 100, 200, 200, 201, 300, 203, 203]), 3)
        self.assertEqual(growth([1, 2, 3]), 0)
        self.assertEqual(slope([0, 1, 2, 3], [90, 1, 3, 5]), 2)
        self.assertEqual(slope([0], [1]), 0)

    def test_a_log_of_collections_says_what_stayed_in_the_heap(self):
        self.assertEqual(alive_mb(GC_LOG), [12, 18])

    def test_the_soak_is_taken_only_when_it_is_named(self):
        given = types.SimpleNamespace(figure=None, broker=None)
        self.assertNotIn(storm_soak.SOAK, paper_report.chosen(given))
        given.figure = ["storm-soak"]
        self.assertEqual(paper_report.chosen(given), [storm_soak.SOAK])


if __name__ == "__main__":
    unittest.main()

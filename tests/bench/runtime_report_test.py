#!/usr/bin/python3
"""Which figures the runtime benchmark has, with which targets, and which rounds count; no program runs."""
import contextlib
import io
import re
import unittest
from pathlib import Path

from figures import ProgramFailed
from runtime_report import BEFORE, CALLS, OURS, PEER, RING, Report, Scale, WithBefore, measure

LATENCY = {"p50_us": 0.4, "p99_us": 4.0, "max_us": 9.0}
LINE = {"per_second": 30e6, "ns_per_hop": 20.0, "cpu_percent": 101.0, "switches_per_second": 100.0, "others_cpu": 0.0,
        "latency": LATENCY, "service": LATENCY}


class Programs:
    """In the place of the programs: `answer(engine, options, turn)` says how a line differs from a good one."""

    def __init__(self, answer=lambda *_: {}, without=()):
        self.answer, self.without, self.asked = answer, without, []

    def has(self, name):
        return name not in self.without

    def run(self, name, *options):
        options = " ".join(map(str, options))
        self.asked.append((name, options))
        return [{**LINE, **self.answer(name, options, self.asked.count((name, options)))}]


class RuntimeReportTest(unittest.TestCase):
    def setUp(self):
        self.said = io.StringIO()
        out = contextlib.redirect_stdout(self.said)
        out.__enter__()
        self.addCleanup(out.__exit__, None, None, None)

    def measured(self, answer=lambda *_: {}, quick=False, without=(), keep_noisy=False):
        self.programs, report = Programs(answer, without), Report()
        measure(self.programs, report, Scale(quick, keep_noisy))
        return report

    @staticmethod
    def targets(report):
        return {result["name"]: result["target"] for result in report.results if result["target"]}

    def test_all_that_is_to_be_shown_has_a_target(self):
        expected = {"chain of 3 at 100/s: p50": "<= 12", "chain of 3 at 100/s: p99": "<= 33", "chain of 3 at 100 k/s: p50": "<= 0.5",
                    "chain of 3, untracked: at most": ">= 25", "chain of 3, tracked: at most": ">= 20",
                    "chain of 3, untracked: share of the rings' rate": ">= 0.3",
                    "chain of 3, tracked: share of the rings' rate": ">= 0.25",
                    "word count, untracked: at most": ">= 12", "word count, tracked: at most": ">= 11",
                    "word count, untracked, two sources: at most": ">= 16", "word count, tracked, two sources: at most": ">= 16"}
        for dag in ("chain of 3", "word count", "fan 1-4-1", "60 KB chain"):
            for kind in ("untracked", "tracked"):
                expected |= {f"{dag}, {kind}: p99 at 50 % load": "<= 100", f"{dag}, {kind}: p99 at 90 % load": "<= 5000"}
                if dag in ("chain of 3", "word count"):
                    expected[f"{dag}, {kind}: cpu then"] = "<= 110"
                else:
                    expected[f"{dag}, {kind}: times the earlier build's rate"] = ">= 1.8"
        self.assertEqual(self.targets(self.measured()), expected)

    def test_every_figure_has_five_rounds_and_a_quick_one_the_same_tails(self):
        report = self.measured()
        self.assertEqual({result["rounds"] for result in report.results}, {5})
        quick = self.targets(self.measured(quick=True))
        for name in ("chain of 3, tracked: p99 at 50 % load", "word count, tracked: p99 at 90 % load", "chain of 3 at 100 k/s: p50"):
            self.assertIn(name, quick)

    def test_a_ratio_is_of_rounds_that_were_taken_together(self):
        def answer(engine, options, turn):
            if "chain" not in options or "--rate" in options:
                return {}
            return {"per_second": turn * (10e6 if engine == OURS else 50e6 if engine == RING else 1e6)}
        (share,) = [each for each in self.measured(answer).results if each["name"] == "chain of 3, tracked: share of the rings' rate"]
        self.assertAlmostEqual(share["value"], 0.2)
        self.assertIs(share["met"], False)

    def test_an_earlier_build_runs_beside_where_it_is_asked_for_and_need_not_tell_of_others(self):
        def answer(engine, options, _):
            return {"per_second": 15e6} if engine == BEFORE else {}
        report = self.measured(answer)
        self.assertEqual({re.search("--dag (fan|payload) ", options)[1] for engine, options in self.programs.asked if engine == BEFORE},
                         {"fan", "payload"})
        times = [each for each in report.results if "times the earlier" in each["name"]]
        self.assertEqual([(each["value"], each["met"]) for each in times], [(2, True)] * 4)
        self.assertNotIn("earlier", " ".join(self.targets(self.measured(without=(BEFORE,)))))

    def test_a_load_is_a_part_of_the_rate_with_the_same_items(self):
        self.measured(lambda engine, options, _: {"per_second": 8e6} if "--numbered" in options else {})
        rates = {engine: {options.split("--rate ")[1].split()[0] for each, options in self.programs.asked
                          if each == engine and "--dag words --rate" in options} for engine in (OURS, RING)}
        self.assertEqual(rates, {OURS: {"80000", "4000000", "7200000"}, RING: {"300000", "15000000", "27000000"}})

    def test_only_our_engine_has_two_sources(self):
        self.measured()
        self.assertEqual({engine for engine, options in self.programs.asked if "--sources 2" in options}, {OURS})

    def test_a_round_with_company_is_taken_again_and_without_a_quiet_one_there_is_no_figure(self):
        def once(engine, options, turn):
            return {"others_cpu": 0.5} if (engine, turn) == (PEER, 1) and "--rate 100 " in options else {}
        report = self.measured(once)
        self.assertEqual(report.thrown_away, 1)
        self.assertEqual({result["rounds"] for result in report.results}, {5})

        def always(engine, options, _):
            return {"others_cpu": 0.5} if engine == CALLS and "--dag words" in options else {}
        report = self.measured(always)
        self.assertNotIn("word count, untracked: at most", self.targets(report))
        self.assertIn("word count, untracked: at most: no round was quiet", self.said.getvalue())
        self.assertFalse(report.failed)
        self.assertIn("word count, untracked: at most", self.targets(self.measured(always, keep_noisy=True)))

    def test_a_program_that_fails_costs_its_figure_and_the_run_is_a_failed_one(self):
        def answer(engine, options, _):
            if engine == OURS and "--dag fan" in options and "--tracked" in options:
                raise ProgramFailed("3 results of 4 arrived")
            return {}
        report = self.measured(answer)
        self.assertIn("fan 1-4-1, tracked: at most: GIVEN UP: 3 results of 4 arrived", report.failed)
        self.assertIn("60 KB chain, tracked: p99 at 90 % load", self.targets(report))

    def test_the_program_of_an_earlier_build_is_run_where_it_is(self):
        here, elsewhere = Path("build/bin"), Path("elsewhere/program")
        self.assertFalse(WithBefore(here, "runtime", None).has(BEFORE))
        programs = WithBefore(here, "runtime", elsewhere)
        self.assertTrue(programs.has(BEFORE))
        self.assertEqual([programs.path(name) for name in (OURS, BEFORE)], [here / "bench_runtime_iotcloud", elsewhere])


if __name__ == "__main__":
    unittest.main()

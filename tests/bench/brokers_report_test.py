#!/usr/bin/python3
"""How the broker benchmark takes turns, throws rounds away, pairs and judges; no program runs."""
import contextlib
import io
import types
import unittest

import brokers_report
from brokers_report import OURS, Bench, Plan, Progress, Report


class Programs:
    """In the programs' place: `answer(engine, turn)` says how a run of this engine differs from a good one."""

    def __init__(self, answer):
        self.answer, self.order, self.options = answer, [], []

    def run(self, engine, *options):
        self.order.append(engine)
        self.options.append(options)
        line = {"sustained": True, "count": 1000, "per_second": 500.0, "p50_us": 400.0, "p99_us": 900.0,
                "max_us": 2000.0, "cpu_seconds": 0.1, "server_cpu_seconds": 0.3, "others_cpu": 0.0, "switches": 10,
                "seconds": 2.0}
        return [{**line, **self.answer(engine, self.order.count(engine))}]


class BrokersReportTest(unittest.TestCase):
    def bench(self, answer=lambda *_: {}, **given):
        given = types.SimpleNamespace(**{"quick": False, "rounds": 3, "keep_noisy": False, "figures": None, **given})
        return Bench("rabbitmq", "amqp://host/", [7], Programs(answer), Report(), Progress(), given)

    def setUp(self):
        out = contextlib.redirect_stdout(io.StringIO())
        out.__enter__()
        self.addCleanup(out.__exit__, None, None, None)

    def test_every_second_round_is_in_reverse_order(self):
        bench = self.bench()
        bench.pair("x", {"size": 100}, 2)
        self.assertEqual(bench.programs.order, [OURS, "rabbitmq", "rabbitmq", OURS, OURS, "rabbitmq"])
        self.assertEqual(bench.programs.options[0], (
            "--url", "amqp://host/", "--name", "bench-iotcloud-own", "--warm-up", 0.5, "--size", 100, "--seconds", 2.0,
            "--server", 7))

    def test_a_round_with_company_is_thrown_away_and_taken_again(self):
        bench = self.bench(lambda engine, turn: {"others_cpu": 0.3} if (engine, turn) == ("rabbitmq", 2) else {})
        ours, theirs = bench.pair("x", {}, 2)
        self.assertEqual((len(ours), len(theirs), bench.report.thrown_away), (3, 3, 1))

    def test_with_company_all_the_time_the_figure_is_missing(self):
        bench = self.bench(lambda *_: {"others_cpu": 1.0})
        brokers_report.paced(bench, {}, ["100 B"], [100])
        self.assertEqual(bench.report.results, [])
        self.assertEqual(bench.report.missing, 4)
        self.assertEqual(bench.report.thrown_away, 6)

    def test_a_load_that_is_too_much_is_not_tried_again(self):
        bench = self.bench(lambda engine, _: {"sustained": engine != OURS})
        self.assertEqual(bench.pair("x", {}, 2), ([], []))
        self.assertEqual(len(bench.programs.order), 2)

    def test_a_program_that_fails_costs_its_figure_alone(self):
        def answer(engine, turn):
            if (engine, turn) == (OURS, 2):
                raise brokers_report.ProgramFailed("out of order")
            return {}
        bench = self.bench(answer)
        self.assertEqual(bench.pair("x", {}, 2), ([], []))
        self.assertTrue(bench.report.failed)
        self.assertEqual(len(bench.pair("y", {}, 2)[0]), 3)

    def test_only_the_figures_that_are_asked_for_are_taken(self):
        bench = self.bench(figures="1000 x .*shared")
        brokers_report.figures(bench, False)
        names = [result["name"] for result in bench.report.results]
        self.assertEqual(len(names), 7)
        self.assertTrue(all(name.startswith("rabbitmq, 1000 x 5/s, shared: ") for name in names), names)
        self.assertEqual(bench.report.missing, 0)

    def test_the_ratio_is_the_median_of_the_ratios_of_one_round(self):
        rates = {OURS: [90, 190, 100], "rabbitmq": [100, 200, 400]}
        bench = self.bench(lambda engine, turn: {"per_second": rates[engine][(turn - 1) % 3]})
        brokers_report.most(bench, {})
        result = bench.report.results[0]
        self.assertEqual(result["name"], "rabbitmq, 100 B, 1000 under way: rate")
        self.assertEqual(result["ratio"], 0.9)
        self.assertEqual(result["ratio_spread"], [0.25, 0.95])
        self.assertEqual((result["value"], result["baseline_value"]), (100, 200))

    def test_a_figure_that_misses_one_of_its_targets_is_missed(self):
        bench = self.bench()
        ours, few, many = ([{"p99_us": us}] for us in (3000.0, 1000.0, 2900.0))
        for theirs, beside in ((few, "ours, 4 x 100/s"), (many, "ours, 4 x 1250/s")):
            bench.compare("p99", "ms", brokers_report.p99, ours, theirs, beside, ratio_at_most=1.5)
        self.assertEqual([result["met"] for result in bench.report.results], [False, True])
        self.assertIn("0 of 1 targets met", bench.report.verdict())
        self.assertIn("missed: rabbitmq, p99", bench.report.verdict())

    def test_targets_are_judged_by_the_ratio(self):
        bench = self.bench(lambda engine, _: {"p50_us": 460.0 if engine == OURS else 400.0,
                                              "p99_us": 1300.0 if engine == OURS else 900.0})
        brokers_report.paced(bench, {}, ["60 KB"], [100])
        met = {result["name"].split(": ")[1]: result["met"] for result in bench.report.results}
        self.assertEqual(met, {"p50": True, "p99": False, "client CPU": True, "broker CPU": None})
        self.assertIn("2 of 3 targets met", bench.report.verdict())

    def test_an_idle_client_that_takes_a_core_misses_its_target(self):
        bench = self.bench(lambda engine, _: {"count": 0, "cpu_seconds": 0.02 if engine == OURS else 0.0})
        brokers_report.idle(bench, {})
        self.assertEqual([result["met"] for result in bench.report.results], [False])

    def test_the_plan_asks_for_the_seconds_that_the_bench_takes(self):
        for quick in (False, True):
            bench = self.bench(quick=quick)
            plan = Plan("rabbitmq", bench.given)
            brokers_report.figures(plan, quick)
            brokers_report.figures(bench, quick)
            self.assertAlmostEqual(plan.seconds, bench.progress.seconds_done)


if __name__ == "__main__":
    unittest.main()

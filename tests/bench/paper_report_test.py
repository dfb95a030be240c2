#!/usr/bin/python3
"""How the paper's figures pair, judge, merge and are written; no program runs."""
import contextlib
import io
import json
import tempfile
import types
import unittest
from pathlib import Path

import kept
from brokers_report import Report
from figures import ProgramFailed
from paper import drivers, sizes
from paper import report as paper_report
from paper.points import Pair, Progress, bytes_text, point
from paper.systems import StartError, merge, quantile

LINE = {"mean_ms": 1.0, "p50_ms": 0.9, "p99_ms": 2.0, "max_ms": 5.0, "stddev_ms": 0.4, "n": 800, "lost": 0,
        "carried": 400.0, "others_cpu": 0.0}


class Running:
    """In a system's place. `answer(who, turn)` says how a line differs from a good one."""

    label, bare = "RabbitMQ", "librabbitmq"

    def __init__(self, answer=lambda *_: {}):
        self.answer, self.order, self.drivers, self.deployed = answer, [], 0, []

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def line(self, who):
        self.order.append(who)
        return {**LINE, **self.answer(who, self.order.count(who))}

    def measure(self, *_):
        return self.line("ours")

    def measure_bare(self, *_):
        return self.line("theirs")

    def warm_up(self, *_):
        pass

    def deploy(self, drivers, shared):
        self.deployed.append((drivers, shared))
        self.drivers += drivers

    def undeploy(self):
        self.drivers = 0

    def partitions_read(self):
        return self.answer("partitions", self.drivers)


class PaperTest(unittest.TestCase):
    def setUp(self):
        self.out = io.StringIO()
        out = contextlib.redirect_stdout(self.out)
        out.__enter__()
        self.addCleanup(out.__exit__, None, None, None)
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        (Path(folder.name) / "paper").mkdir()
        self.given = types.SimpleNamespace(scale="usual", quick=False, full=False, out=Path(folder.name) / "paper", build=Path("/build"),
                                           figure=None, broker=None, points=None, rounds=None)

    class Figure:
        broker, title, servers = None, "a figure", []

        def __init__(self, name, take):
            self.name, self.take = name, take

        def seconds(self, _given):
            return 1

    def write(self, *figures):
        self.addCleanup(setattr, paper_report, "FIGURES", paper_report.FIGURES)
        paper_report.FIGURES = figures
        return paper_report.run_paper(self.given)

    @staticmethod
    def keepable(file):
        """Raises Unusable when `./dev bench keep` refuses the file for what was measured: as of a tree that is committed."""
        file.write_text(json.dumps({**json.loads(file.read_text()), "commit": "0123"}))
        return kept.read(file)

    def run_figure(self, module, figure, running):
        self.addCleanup(setattr, module, "system", module.system)
        module.system = lambda *_, **__: running
        report = Report()
        return figure.take(self.given, report, Progress(figure.seconds(self.given))), report

    def by_size(self, answer=lambda *_: {}):
        return self.run_figure(sizes, sizes.BySize("7", "rabbitmq"), Running(answer))


class PairTest(PaperTest):
    def rounds(self, answer=lambda *_: {}, rounds=3):
        running, pair = Running(answer), Pair("x")
        for _ in range(rounds):
            pair.round(running.measure, running.measure_bare)
        return running, pair

    def test_every_second_round_is_in_reverse_order(self):
        running, _ = self.rounds()
        self.assertEqual(running.order, ["ours", "theirs", "theirs", "ours", "ours", "theirs"])

    def test_a_round_with_company_is_taken_again(self):
        _, pair = self.rounds(lambda who, turn: {"others_cpu": 0.3, "mean_ms": 9.0} if (who, turn) == ("ours", 2) else {})
        self.assertEqual(([line["mean_ms"] for line in pair.ours], pair.noisy), ([1.0, 1.0, 1.0], 0))

    def test_with_company_all_the_time_the_quieter_turn_counts_and_that_is_said(self):
        _, pair = self.rounds(lambda _, turn: {"others_cpu": 1.0 / turn, "n": turn}, rounds=1)
        self.assertEqual((pair.ours[0]["n"], pair.noisy), (2, 1))
        pair.compare(Report(), "bare")
        self.assertIn("x: other processes took more than 0.2 of a CPU in 1 rounds", self.out.getvalue())

    def test_a_point_that_cannot_be_served_says_why_and_the_bare_client_is_measured(self):
        def answer(who, _turn):
            if who == "ours":
                raise ProgramFailed("too much")
            return {}
        _, pair = self.rounds(answer, rounds=1)
        report = Report()
        pair.compare(report, "bare")
        self.assertTrue(report.failed)
        self.assertEqual(point(7, pair.ours, pair.our_problem), {"x": 7, "failed": "too much"})
        self.assertEqual(point(7, pair.theirs, pair.their_problem)["mean_ms"], 1.0)
        self.assertIn("x: NOT SERVED: too much", self.out.getvalue())

    def test_a_bare_client_that_fails_costs_its_own_curve_alone(self):
        def answer(who, turn):
            if who == "theirs":
                raise ProgramFailed("gone")
            return {}
        running, pair = self.rounds(answer)
        self.assertEqual((len(pair.ours), pair.their_problem, running.order.count("theirs")), (3, "gone", 1))

    def test_a_lost_message_fails_the_benchmark(self):
        _, pair = self.rounds(lambda who, _: {"lost": 2} if who == "ours" else {}, rounds=1)
        report = Report()
        pair.compare(report, "bare")
        self.assertTrue(report.failed)
        self.assertIn("2 of 802 did not come back", self.out.getvalue())
        for statistic in ("p50_ms", "p99_ms"):
            pair.compare(report, "bare", statistic)
        self.assertEqual(report.reasons, ["x: 2 of 802 did not come back"])  # told once, whatever is compared

        def take(_given, report, _progress):
            pair.compare(report, "bare")
            return []
        whole, _ = self.write(self.Figure("7", take), self.Figure("8", lambda *_: []))
        self.assertTrue(whole.failed)
        file = self.given.out / "figure-7.json"
        self.assertEqual(json.loads(file.read_text())["failed"], "x: 2 of 802 did not come back")
        with self.assertRaisesRegex(kept.Unusable, "is of a run that failed: x: 2 of 802 did not come back"):
            self.keepable(file)
        self.keepable(self.given.out / "figure-8.json")


class SizesTest(PaperTest):
    def test_targets_hold_up_to_200_kb_and_are_the_median_of_paired_ratios(self):
        slow = {1: 3.0, 2: 1.1, 3: 1.3}
        _, report = self.by_size(lambda who, turn: {"mean_ms": slow[(turn - 1) % 3 + 1] if who == "ours" else 1.0})
        first, last = report.results[0], report.results[-1]
        self.assertEqual((first["name"], first["ratio"], first["met"]), ("RabbitMQ, 100 B, 4 x 10/s: mean", 1.3, False))
        self.assertEqual((last["name"], last["target"]), ("RabbitMQ, 1 MB, 4 x 100/s: mean", None))

    def test_a_curve_has_a_point_for_each_size_beside_its_limit(self):
        plots, _ = self.by_size()
        lines = plots[0]["series"]
        self.assertEqual([line["name"] for line in lines[:2]], ["IoTCloud, 10/s", "librabbitmq, 10/s"])
        self.assertEqual([one["x"] for one in lines[0]["points"]], list(sizes.SIZES["usual"]))
        self.assertEqual((lines[0]["points"][0]["n"], lines[0]["points"][0]["mean_ms"]), (2400, 1.0))
        paper = [line for line in lines if line["kind"] == "paper"]
        self.assertEqual([(line["name"], line["points"][0]["mean_ms"]) for line in paper], [("paper, 20/s", 10)])

    def test_only_the_points_that_are_asked_for_are_taken(self):
        self.given.points, self.given.rounds = "60 KB, 4 x (20|100)/s", 2
        plots, report = self.by_size()
        self.assertEqual([line["name"] for line in plots[0]["series"] if line["kind"] == "ours"],
                         ["IoTCloud, 20/s", "IoTCloud, 100/s"])
        self.assertEqual([result["rounds"] for result in report.results], [2, 2])

    def test_figure_9_judges_the_deviation_by_what_figure_7_measured(self):
        plots, _ = self.by_size(lambda who, _: {"stddev_ms": 0.6 if who == "ours" else 0.4})
        (self.given.out / "figure-7.json").write_text(json.dumps({"plots": plots}))
        report = Report()
        drawn = sizes.Deviation().take(self.given, report, None)
        self.assertEqual((drawn[0]["statistic"], report.results[0]["met"]), ("stddev_ms", False))
        self.assertAlmostEqual(report.results[0]["ratio"], 1.5)
        self.assertEqual([result["target"] for result in report.results if "1 MB" in result["name"]], [None] * 4)
        self.assertFalse(report.failed)

    def test_figure_9_of_a_run_that_failed_is_one_that_failed(self):
        plots, _ = self.by_size()
        (self.given.out / "figure-7.json").write_text(json.dumps({"plots": plots, "failed": "2 did not come back"}))
        report = Report()
        sizes.Deviation().take(self.given, report, None)
        self.assertEqual(report.failed, "figure 7, of which it is drawn: 2 did not come back")

    def test_figure_9_without_the_others_says_what_to_run(self):
        with self.assertRaisesRegex(ProgramFailed, "--figure 7"):
            sizes.Deviation().take(self.given, Report(), None)

    def test_sizes_are_written_as_people_do(self):
        self.assertEqual([bytes_text(size) for size in (100, 1000, 60_000, 1_000_000)], ["100 B", "1 KB", "60 KB", "1 MB"])


class DriversTest(PaperTest):
    def by_drivers(self, answer=lambda *_: {}):
        running = Running(answer)
        plots, report = self.run_figure(drivers, drivers.FIGURES[0], running)
        return running, plots, report

    def test_each_round_adds_drivers_to_those_that_are_there(self):
        running, _, _ = self.by_drivers()
        self.assertEqual(running.deployed[:7], [(count, True) for count in (4, 96, 400, 500, 1000, 3000, 5000)])
        self.assertEqual(running.deployed[-4:], [(count, False) for count in (4, 96, 400, 500)])

    def test_a_thousand_are_judged_by_the_p99_of_four(self):
        def answer(who, turn):
            return {"p99_ms": 4.0 if turn == 4 else 2.0} if who == "ours" else {}
        _, _, report = self.by_drivers(answer)
        flat = [result for result in report.results if result["baseline"] == "ours, 4 drivers"]
        self.assertEqual([(result["name"], result["ratio"], result["met"]) for result in flat], [
            ("RabbitMQ, 1000 x 5/s, shared: p99", 1.5, True), ("RabbitMQ, 1000 x 5/s, exclusive: p99", 1.0, True)])

    def test_a_thousand_alone_are_judged_by_nothing(self):
        self.given.points = "1000 x"
        _, _, report = self.by_drivers()
        self.assertEqual([result["name"] for result in report.results if result["target"] is not None
                          and result["name"].startswith("RabbitMQ, 1000 x")], [])

    def test_ten_thousand_are_served_when_nothing_is_lost_and_all_comes_in_time(self):
        _, _, report = self.by_drivers(lambda *_: {"carried": 9000.0})
        served = [(result["name"].split(": ")[1], result["met"]) for result in report.results if "10000 x 1/s" in result["name"]]
        self.assertEqual(served, [("mean", None), ("p99", None), ("lost", True), ("carried", False)])

    def test_plots_are_titled_with_the_loads_that_they_have(self):
        def titles():
            return [plot["title"] for plot in self.by_drivers()[1]]
        load = "messages of 100 B, 5/s each up to 1000 drivers"
        self.assertEqual(titles(), [f"RabbitMQ: {text}, {load}, 1/s each up to 10000 drivers"
                                    for text in ("mean round trip", "p99 of the round trip")])
        self.given.points = "(4|1000) x 5/s"
        self.assertEqual(titles(), [f"RabbitMQ: {text}, {load}" for text in ("mean round trip", "p99 of the round trip")])

    def test_of_kafkas_partitions_all_are_read_or_a_target_is_missed(self):
        self.given.points = "(4|1000) x 5/s"
        running = Running(lambda who, turn: 8.0 if who == "partitions" else {})
        _, report = self.run_figure(drivers, drivers.FIGURES[1], running)
        read = {result["name"]: (result["value"], result["baseline_value"], result["met"], result["rounds"])
                for result in report.results if result["name"].endswith("partitions read")}
        self.assertEqual(read, {"Kafka, shared: partitions read": (8, 8, True, 2),
                                "Kafka, shared, 1 partition: partitions read": (8, 2, True, 2),
                                "Kafka, shared, 8 partitions: partitions read": (8, 16, False, 2)})

    def test_drivers_that_cannot_be_deployed_are_a_point_that_is_not_served(self):
        running = Running()

        def deploy(drivers, shared):
            Running.deploy(running, drivers, shared)
            if running.drivers >= 5000:
                raise StartError("too many")
        running.deploy = deploy
        plots, report = self.run_figure(drivers, drivers.FIGURES[0], running)
        points = plots[0]["series"][0]["points"]
        self.assertEqual(["failed" in one for one in points], [False] * 5 + [True] * 2)
        self.assertIn("RabbitMQ, 5000 x 1/s, shared: NOT SERVED: too many", report.reasons)


class FilesTest(PaperTest):
    def test_a_figure_that_is_taken_again_leaves_the_others_alone(self):
        self.write(self.Figure("7", lambda *_: [{"series": []}]), self.Figure("storm", lambda *_: [1]))
        self.given.figure = ["7"]
        self.write(self.Figure("7", lambda *_: [{"series": [2]}]), self.Figure("storm", lambda *_: [3]))
        first, other = (json.loads((self.given.out / name).read_text()) for name in ("figure-7.json", "storm.json"))
        self.assertEqual((first["plots"], other["plots"]), ([{"series": [2]}], [1]))
        self.assertTrue((self.given.out.parent / "report.html").exists())
        self.assertEqual((first["figure"], first["title"], first["quick"]), ("7", "a figure", False))

    def test_a_figure_that_cannot_be_taken_is_told_and_the_run_goes_on(self):
        def fail(*_):
            raise StartError("no server")
        whole, _ = self.write(self.Figure("7", fail), self.Figure("8", lambda *_: [4]))
        self.assertTrue(whole.failed)
        self.assertEqual(json.loads((self.given.out / "figure-7.json").read_text())["failed"], "figure 7: GIVEN UP: no server")
        self.assertEqual(json.loads((self.given.out / "figure-8.json").read_text())["plots"], [4])

    def test_a_broker_chooses_its_figures(self):
        self.given.broker = ["kafka"]
        self.assertEqual([figure.name for figure in paper_report.chosen(self.given) if figure.broker], ["8", "11"])

    def test_a_quick_run_takes_minutes(self):
        self.given.scale = "quick"
        mine = [figure for figure in paper_report.FIGURES if figure.name in ("7", "8", "7a", "7e", "9", "10", "11")]
        self.assertLess(sum(figure.seconds(self.given) for figure in mine), 300)


class MergeTest(unittest.TestCase):
    @staticmethod
    def report(values):
        mean = sum(values) / len(values)
        return {"n": len(values), "mean_us": mean, "stddev_us": (sum((v - mean) ** 2 for v in values) / len(values)) ** 0.5,
                "max_us": max(values), "histogram_us": [[value, values.count(value)] for value in sorted(set(values))],
                "planned": len(values) + 1, "came_back": len(values), "in_time": len(values)}

    def test_two_hosts_are_as_one(self):
        one, two = [1000] * 90 + [2000] * 10, [3000] * 50
        merged, whole = merge([self.report(one), self.report(two)], 2), merge([self.report(one + two)], 2)
        for name in ("mean_ms", "stddev_ms", "p50_ms", "p99_ms", "max_ms", "n", "carried"):
            self.assertAlmostEqual(merged[name], whole[name], msg=name)
        self.assertEqual((merged["p50_ms"], merged["p99_ms"], merged["lost"], merged["carried"]), (1.0, 3.0, 2, 75))

    def test_a_quantile_is_the_programs_own(self):
        self.assertEqual([quantile({1: 50, 2: 50}, share) for share in (0, 0.49, 0.5, 0.99)], [1, 1, 2, 2])


if __name__ == "__main__":
    unittest.main()

#!/usr/bin/python3
"""How the Storm benchmark takes turns, throws rounds away, judges and plots; no program runs."""
import contextlib
import io
import json
import tempfile
import types
import unittest
from pathlib import Path
from unittest import mock

from paper import report as paper_report
import storm_report
from brokers_report import Report
from figures import ProgramFailed
from storm_report import BARE, DEFAULTS, LIBRARY, OURS, POINTS, STORM, TUNED, Measurement, Rounds, Scale, StartError
from paper.systems import Unavailable
from storm_turns import settings_of, worker_yaml

ECHO = {"count": 400, "lost": 0, "mean_us": 500.0, "p50_us": 400.0, "p99_us": 900.0, "max_us": 2000.0, "stddev_us": 100.0,
        "processor_cpu_seconds": 0.04, "server_cpu_seconds": 0.1, "others_cpu": 0.0}
MEMORY = {"per_second": 1e6, "cpus": 2.0, "others_cpu": 0.0}


class Turns:
    """In the place of servers and processes: `answer(side, turn)` says how a turn differs from a good one."""

    def __init__(self, answer=lambda *_: {}):
        self.answer, self.order, self.under_way = answer, [], None

    @contextlib.contextmanager
    def phase(self, *what):
        self.under_way = what
        yield
        self.under_way = None

    echo = memory = phase

    def turn(self, side, line):
        if not self.under_way:
            raise AssertionError("a turn without its phase")
        self.order.append(side)
        return {**line, **self.answer(side, self.order.count(side))}

    def echo_turn(self, side, *_):
        return self.turn(side, ECHO)

    def memory_turn(self, side, *_):
        return self.turn(side, MEMORY)


class Steps:
    def __init__(self):
        self.seconds = 0

    def step(self, _text, seconds):
        self.seconds += seconds


class StormReportTest(unittest.TestCase):
    def setUp(self):
        self.said = io.StringIO()
        out = contextlib.redirect_stdout(self.said)
        out.__enter__()
        self.addCleanup(out.__exit__, None, None, None)

    def measure(self, answer=lambda *_: {}, scale="quick", rounds=2, phases=None):
        scale = Scale(scale, rounds)
        scale.phases = phases or scale.phases
        measurement = Measurement(Turns(answer), scale, Report(), Steps())
        measurement.made = measurement.run()
        return measurement

    @staticmethod
    def met(measurement):
        return {result["name"]: result["met"] for result in measurement.report.results if result["target"]}

    def test_every_second_round_is_in_reverse_order(self):
        measurement = self.measure(phases=[("words", False, TUNED)], rounds=3)
        self.assertEqual(measurement.turns.order, [OURS, STORM, STORM, OURS, OURS, STORM])

    def test_the_bare_client_takes_its_turn_in_the_echo(self):
        measurement = self.measure(phases=[("echo", True, TUNED)], rounds=1)
        self.assertEqual(measurement.turns.order[:3], [OURS, STORM, BARE])

    def test_the_plan_asks_for_the_seconds_that_the_turns_take(self):
        for scale in ("quick", "usual"):
            measurement = self.measure(scale=scale)
            self.assertAlmostEqual(measurement.progress.seconds, measurement.scale.seconds())

    def test_the_usual_run_has_storm_as_it_comes_and_tuned_on_everything(self):
        phases = Scale("usual").phases
        self.assertEqual(len(set(phases)), 12)
        self.assertEqual({setting for _, _, setting in phases}, {TUNED, DEFAULTS})

    def test_only_what_is_asked_for_is_measured(self):
        scale = Scale("usual", 1, lambda title: title in ("60 KB, 4 x 20/s, tracked, Storm, tuned",
                                                          "word count, untracked, Storm, defaults"))
        self.assertEqual(scale.phases, [("echo", True, TUNED), ("words", False, DEFAULTS)])
        measurement = Measurement(Turns(), scale, Report(), Steps())
        measurement.run()
        self.assertEqual({result["name"] for result in measurement.report.results if result["target"]},
                         {"60 KB, 4 x 20/s, tracked: p99", "60 KB, 4 x 20/s, tracked: CPU", "word count, untracked: rate"})
        self.assertAlmostEqual(measurement.progress.seconds, scale.seconds())

    def test_a_round_with_company_is_thrown_away_and_taken_again(self):
        measurement = self.measure(lambda side, turn: {"others_cpu": 0.3} if (side, turn) == (STORM, 1) else {},
                                   phases=[("words", True, TUNED)])
        self.assertEqual(measurement.report.thrown_away, 1)
        self.assertEqual(measurement.report.results[0]["rounds"], 2)

    def test_with_company_all_the_time_the_figure_is_missing_and_its_point_says_why(self):
        measurement = self.measure(lambda *_: {"others_cpu": 1.0}, phases=[("echo", True, TUNED)])
        self.assertEqual(measurement.report.results, [])
        points = [point for series in measurement.made[0]["series"] for point in series["points"]]
        self.assertEqual({point["failed"] for point in points}, {"no round was quiet"})

    def test_the_targets_are_judged_by_the_ratio_to_storm(self):
        def answer(side, _):
            return {"p99_us": 2700.0, "processor_cpu_seconds": 0.19, "per_second": 0.1e6} if side == STORM else {}
        met = self.met(self.measure(answer))
        self.assertEqual([met[f"100 B, 4 x 20/s, tracked: {figure}"] for figure in ("p99", "CPU")], [True, False])
        self.assertEqual([met[f"word count, {kind}: rate"] for kind in ("untracked", "tracked")], [True, False])

    def test_a_target_that_only_one_of_storms_settings_lets_us_meet_is_missed(self):
        def answer(side, turn):
            return {"per_second": 0.1e6 if turn <= 2 else 0.5e6} if side == STORM else {}
        measurement = self.measure(answer, phases=[("words", False, TUNED), ("words", False, DEFAULTS)])
        self.assertEqual([result["met"] for result in measurement.report.results if result["target"]], [True, False])
        self.assertIn("0 of 1 targets met", measurement.report.verdict())

    def test_a_turn_that_fails_costs_its_figure_alone(self):
        def answer(side, turn):
            if (side, turn) == (STORM, 2):
                raise ProgramFailed("399 of 400 messages came back")
            return {}
        measurement = self.measure(answer, phases=[("echo", True, TUNED)])
        self.assertTrue(measurement.report.failed)
        self.assertEqual(len(measurement.report.results), 5 * (len(POINTS) - 1))
        failed = [point for series in measurement.made[0]["series"] for point in series["points"] if "failed" in point]
        self.assertEqual(len(failed), 3)

    def test_a_phase_that_does_not_start_costs_itself_alone(self):
        measurement = Measurement(Turns(), Scale("quick", 1), Report(), Steps())
        measurement.turns.echo = mock.Mock(side_effect=StartError("Storm: it ended"))
        measurement.run()
        self.assertTrue(measurement.report.failed)
        self.assertIn("echo, tracked, Storm, tuned: GIVEN UP: Storm: it ended", self.said.getvalue())
        self.assertEqual(len(measurement.report.results), 6)

    def test_a_point_has_medians_the_largest_and_the_sums(self):
        rounds = Rounds("x", 3, (OURS, STORM))
        for p50, most, lost in ((300.0, 5000.0, 0), (500.0, 1000.0, 1), (400.0, 2000.0, 0)):
            rounds.take(lambda side: {**ECHO, "p50_us": p50, "max_us": most, "lost": lost})
        point = storm_report.point_of(100, rounds, OURS)
        self.assertEqual((point["p50_ms"], point["max_ms"], point["lost"], point["n"]), (0.4, 5.0, 1, 1200))
        self.assertAlmostEqual(point["processor_cpu_s"], 1e-4)

    def test_plots_have_ours_once_and_each_setting(self):
        made = self.measure(scale="usual").made
        names = [series["name"] for series in made[0]["series"]]
        sides = ("IoTCloud", TUNED, DEFAULTS, LIBRARY)
        self.assertEqual(sorted(names), sorted(f"{who}, {rate}/s" for who in sides for rate in (20, 100)))
        self.assertEqual([point["x"] for point in made[0]["series"][0]["points"]], [100, 60_000])
        self.assertEqual([plot["title"] for plot in made[4:]], ["word count in memory", "chain of 3 in memory"])
        self.assertEqual([point["x"] for point in made[4]["series"][0]["points"]], ["tracked", "untracked"])

    def test_storm_as_it_comes_has_no_settings_but_what_is_under_way(self):
        self.assertEqual(settings_of("echo", True, DEFAULTS), {})
        self.assertEqual(settings_of("words", True, DEFAULTS), {"topology.max.spout.pending": 4096})
        self.assertEqual(settings_of("echo", True, TUNED)["topology.producer.batch.size"], 1)

    def test_our_topology_reads_and_serves_the_devices_queues(self):
        text = worker_yaml("ours-untracked", False, "127.0.0.1:9")
        for line in ("topology.name: ours-untracked", "driver: ours-untracked, channel: data", "channel: control",
                     "ackMode: auto", "acking: false"):
            self.assertIn(line, text)
        self.assertNotIn("ackMode", worker_yaml("ours-tracked", True, "127.0.0.1:9"))

    def test_what_cannot_be_built_is_given_up_with_its_cause_and_the_file_says_it(self):
        with tempfile.TemporaryDirectory() as folder, \
                mock.patch.object(storm_report, "build", side_effect=Unavailable("Maven Central cannot be reached: x")), \
                mock.patch.object(paper_report.page, "write"):
            given = types.SimpleNamespace(quick=True, full=False, rounds=None, build=Path("build"), figure=["storm"],
                                          broker=None, points=None, out=Path(folder) / "paper")
            report, verdict = paper_report.run_paper(given)
            written = json.loads((given.out / "storm.json").read_text())
        self.assertTrue(report.failed)
        self.assertEqual((written["figure"], written["failed"]), ("storm", "figure storm: GIVEN UP: Maven Central cannot be reached: x"))
        self.assertIn("FAILED", verdict)


if __name__ == "__main__":
    unittest.main()

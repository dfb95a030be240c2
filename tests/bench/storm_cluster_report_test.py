#!/usr/bin/python3
"""How the part of the Storm benchmark that runs on a cluster takes turns, judges, counts and plots; no program runs."""
import contextlib
import io
import re
import subprocess
import tempfile
import unittest
from pathlib import Path

from brokers_report import Report
from figures import ProgramFailed
from storm_board import BUCKETS, FIRST_LATENCY, FULL, NUMBER, SIZE, Board, middle_of
from storm_cluster import CPP, JAVA, LOADS, OWN, StartError, is_stopped, topology_yaml
from private_server import freeze
from storm_cluster_report import PACE, ClusterMeasurement, ClusterScale, title_of

LINE = {"per_second": 1e5, "cpu_us": 10.0, "cpus": 1.0, "others_cpu": 0.0, "p50_us": 2000.0, "p99_us": 8000.0}
CHAIN = title_of("chain", 1, True)


class Cluster:
    """In the place of Storm: `answer(side, turn)` says how a turn differs from a good one."""

    def __init__(self, answer):
        self.answer, self.order, self.under_way, self.phases = answer, [], None, []

    @contextlib.contextmanager
    def phase(self, load, workers, tracked, _warm_up_s, sides):
        self.under_way = sides
        self.phases.append((load, workers, tracked))
        yield
        self.under_way = None

    def turn(self, side, rate, _seconds):
        if side not in self.under_way:
            raise AssertionError(f"{side} does not run")
        self.order.append((side, rate))
        return {**LINE, **self.answer(side, len(self.order))}


class Steps:
    seconds = 0

    def step(self, _text, seconds):
        self.seconds += seconds


class StormClusterTest(unittest.TestCase):
    def setUp(self):
        self.said = io.StringIO()
        out = contextlib.redirect_stdout(self.said)
        out.__enter__()
        self.addCleanup(out.__exit__, None, None, None)

    @staticmethod
    def measure(answer=lambda *_: {}, scale="usual", rounds=1, points="", **more):
        scale = ClusterScale(scale, rounds, lambda title: re.search(points, title), **more)
        measurement = ClusterMeasurement(Cluster(answer), scale, Report(), Steps())
        measurement.made = measurement.run()
        return measurement

    @staticmethod
    def result(measurement, name, beside=JAVA):
        found = [each for each in measurement.report.results if each["name"] == name and each["baseline"] == beside]
        return found[0]

    def test_the_usual_run_has_every_load_on_one_and_two_workers_acked_and_not(self):
        phases = self.measure().cluster.phases
        self.assertEqual(len(set(phases)), len(LOADS) * 2 * 2)

    def test_a_quick_run_takes_less_than_eight_minutes(self):
        self.assertLess(ClusterScale("quick").seconds(), 450)

    def test_the_plan_asks_for_the_seconds_that_the_turns_take(self):
        for scale in ("quick", "usual"):
            measurement = self.measure(scale=scale, rounds=None)
            self.assertAlmostEqual(measurement.progress.seconds, measurement.scale.seconds())

    def test_our_own_worker_takes_its_turn_where_there_is_one_worker(self):
        self.assertEqual(self.measure(points=CHAIN + "$", rounds=2).cluster.order,
                         [(side, FULL) for side in (CPP, JAVA, OWN, OWN, JAVA, CPP)])
        self.assertEqual(self.measure(points="chain of 3, 2 workers, not acked").cluster.order, [(CPP, FULL), (JAVA, FULL)])

    def test_only_what_is_asked_for_is_measured(self):
        measurement = self.measure(points=f"chain of 3, 1 worker, acked, {PACE}/s")
        self.assertEqual({rate for _, rate in measurement.cluster.order}, {PACE})
        self.assertEqual({each["name"] for each in measurement.report.results if each["target"]},
                         {f"{CHAIN}, {PACE}/s: p50", f"{CHAIN}, {PACE}/s: p99"})
        self.assertEqual(measurement.made, [])
        self.assertEqual(self.measure(points="60 KB, 4 x 20/s").cluster.phases, [])

    def test_rate_cpu_and_latency_are_judged_by_the_ratio_to_plain_java(self):
        def answer(side, _):
            return {"per_second": 1.2e5, "cpu_us": 8.5, "p50_us": 2000.0, "p99_us": 7000.0} if side == JAVA else {}
        measurement = self.measure(answer, points=CHAIN)
        for name, met in (("rate", False), ("CPU", True), (f"{PACE}/s: p50", True), (f"{PACE}/s: p99", False)):
            separator = ", " if "/s" in name else ": "
            self.assertEqual(self.result(measurement, CHAIN + separator + name)["met"], met, name)
        self.assertIsNone(self.result(measurement, f"{CHAIN}: rate", OWN)["met"])

    def test_a_word_is_the_unit_of_the_word_count(self):
        measurement = self.measure(points="word count, 2 workers, acked")
        self.assertEqual({each["unit"] for each in measurement.report.results}, {"k words/s", "us/word"})

    def test_a_round_with_company_counts_only_when_noisy_rounds_are_kept(self):
        def answer(*_):
            return {"others_cpu": 0.5}
        measurement = self.measure(answer, points=CHAIN + "$")
        self.assertEqual((measurement.report.results, measurement.report.thrown_away), ([], 2))
        self.assertIn("no round was quiet", self.said.getvalue())
        self.assertEqual(measurement.made[0]["series"][0]["points"], [{"x": "chain of 3", "failed": "no round was quiet"}])
        self.assertEqual(len(self.measure(answer, points=CHAIN + "$", keep_noisy=True).report.results), 4)

    def test_a_turn_that_fails_costs_its_figure_alone(self):
        def answer(side, turn):
            if turn == 2:
                raise ProgramFailed("plain-1: 399 of 400 results arrived")
            return {}
        measurement = self.measure(answer, points=CHAIN)
        self.assertIn("399 of 400", measurement.report.failed)
        self.assertEqual({each["name"].rpartition(": ")[0] for each in measurement.report.results}, {f"{CHAIN}, {PACE}/s"})

    def test_a_phase_that_does_not_start_costs_itself_alone(self):
        def answer(*_):
            raise StartError("cpp-1: no results within 180 s")
        measurement = self.measure(answer, points="chain of 3, 1 worker")
        self.assertEqual(len(measurement.report.reasons), 2)
        self.assertIn(f"{CHAIN}: GIVEN UP: cpp-1", measurement.report.failed)

    def test_plots_have_a_point_of_each_load_and_side(self):
        made = self.measure().made
        self.assertEqual(len(made), 4)
        for plot in made:
            sides = [series["name"] for series in plot["series"]]
            self.assertEqual(sides, [CPP, JAVA, OWN] if "1 worker," in plot["title"] else [CPP, JAVA])
            for series in plot["series"]:
                self.assertEqual([point["x"] for point in series["points"]], [load.name for load in LOADS.values()])

    def test_counts_of_all_tasks_are_added_and_what_was_there_before_is_not(self):
        with tempfile.TemporaryDirectory() as folder:
            board = Board(Path(folder) / "board")
            board.send(PACE)
            self.assertEqual(NUMBER.unpack_from((board.folder / "control").read_bytes())[0], PACE)
            self.task(board, "source-1", 100, 90, {10: 50})
            before = board.counts()
            self.task(board, "source-1", 300, 280, {10: 50, 40: 99, 703: 1})
            self.task(board, "sink-3", 0, 5, {})
            (board.folder / "pass-2").touch()  # it has just begun
            counts = board.counts() - before
        self.assertEqual((counts.emitted, counts.results, counts.failed), (200, 195, 0))
        self.assertEqual((counts.latency_us(0.5), counts.latency_us(1)), (40.5, middle_of(BUCKETS - 1)))
        self.assertIsNone((before - before).latency_us(0.5))

    @staticmethod
    def task(board, name, emitted, results, latencies):
        numbers = bytearray(SIZE)
        for place, number in {0: emitted, 1: results, **{FIRST_LATENCY + b: n for b, n in latencies.items()}}.items():
            NUMBER.pack_into(numbers, NUMBER.size * place, number)
        (board.folder / name).write_bytes(numbers)

    def test_a_bucket_is_a_thirty_second_of_its_latency_wide(self):
        for us, bucket in ((0, 0), (63, 63), (64, 64), (127, 95), (128, 96), (1000, 32 * 4 + (1000 >> 4))):
            self.assertLessEqual(abs(middle_of(bucket) - us), max(1, us / 32))

    def test_a_process_has_stopped_when_all_its_threads_have_or_when_it_is_gone(self):
        process = subprocess.Popen(["sleep", "60"])
        self.assertFalse(is_stopped(process.pid))
        freeze(process)
        self.assertTrue(is_stopped(process.pid))
        process.kill()
        process.wait()
        self.assertTrue(is_stopped(process.pid))

    def test_the_topologys_file_says_what_its_load_needs(self):
        text = topology_yaml("cpp-1", LOADS["100 KB"], 2, {"board": "/b", "tracked": False}, "/lib.so", "registry: r\n")
        for line in ("topology.name: cpp-1", '  board: "/b"', "acking: false", "max_spout_pending: 100", "mailbox_capacity: 128",
                     "workers: 2", "\nregistry: r\n"):
            self.assertIn(line, text)
        self.assertNotIn("mailbox", topology_yaml("cpp-1", LOADS["words"], 1, {"tracked": True}, "/lib.so"))


if __name__ == "__main__":
    unittest.main()

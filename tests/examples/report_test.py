#!/usr/bin/python3
"""Tests the demo's report on its robots' traces, and on its bolts' times."""

import argparse
import sys
import tempfile
import unittest
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "examples/turtlebot_follower"))

import modes  # noqa: E402
import report  # noqa: E402

PERIOD_S = 0.1
SECONDS = 5


def trace(unanswered=()):
    """Frames of a robot that follows well, all answered except these."""
    return [report.Row(seq=number, seconds=number * PERIOD_S, robot=(0.0, 0.0), person=(0.7, 0.0), distance=report.GOAL_M,
                       in_box=True, encode_ms=0.5, raw_bytes=614400, payload_bytes=60000, answered=number not in unanswered,
                       latency_ms=2.0) for number in range(50)]


def report_of(*traces):
    robots = [argparse.Namespace(gateway="gateway-1", properties={"seed": number}) for number in range(len(traces))]
    return report.make_report(robots, traces, argparse.Namespace(seconds=SECONDS, cluster=False, engine=None, seed=1),
                              {"broker": "embedded", "bolts_ms": {}, "cpu_cores": {}})


class ReportTest(unittest.TestCase):
    def test_a_robot_whose_frames_were_all_answered_followed(self):
        self.assertTrue(report_of(trace())["followed"])

    def test_the_frame_that_was_under_way_at_the_end_does_not_count(self):
        found = report_of(trace(), trace(unanswered=[49]))
        self.assertTrue(found["followed"])
        self.assertEqual((found["frames_sent"], found["frames_answered"]), (99, 99))

    def test_a_frame_without_a_command_counts(self):
        found = report_of(trace(unanswered=[20]))
        self.assertFalse(found["followed"])
        self.assertEqual((found["frames_sent"], found["frames_answered"]), (50, 49))

    def test_so_do_all_but_the_last_of_those_at_the_end(self):
        self.assertFalse(report_of(trace(), trace(unanswered=[48, 49]))["followed"])


class TimesTest(unittest.TestCase):
    def test_of_several_tasks_of_a_bolt_the_slowest_counts(self):
        with tempfile.NamedTemporaryFile("w", suffix=".tsv") as file:
            file.write("follow\t0.5\t2\nfollow\t0.75\t1.5\ndecode\t1\t1.25\n")
            file.flush()
            times = modes.slowest_tasks(modes.times_in_file(Path(file.name)))
        self.assertEqual(times, {"follow": {"p50": 0.75, "p99": 2.0}, "decode": {"p50": 1.0, "p99": 1.25}})


if __name__ == "__main__":
    unittest.main()

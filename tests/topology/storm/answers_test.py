#!/usr/bin/python3
"""`iotcloud topology VERB --engine storm`, and `iotcloud-storm VERB`, in front of a Nimbus that the test plays: what they tell it,
and what they answer.

usage: answers_test.py BUILD LIBRARY     (BUILD: build/release; LIBRARY: the library of components.cc)
"""
import json
import os
import shutil
import stat
import subprocess
import sys
import tempfile
import time
import unittest
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "servers"))
import storm_jar  # noqa: E402
from fake_nimbus import FakeNimbus, topology  # noqa: E402
from private_server import Unavailable  # noqa: E402

SKIPPED = 77
OF_TUPLE = "iotcloud.storm.ComponentError: not number 100\n\tat nowhere"
FATAL = "java.lang.RuntimeException: there is no class\n\tat nowhere"
# What its file says of a topology; the rest of it stands in topology_file().
ON_STORM = "engine: {storm: {workers: 2}}\n"


class Answers(unittest.TestCase):
    build = library = None

    def setUp(self):
        place = tempfile.TemporaryDirectory(prefix="iotcloud-storm-")
        self.addCleanup(place.cleanup)
        self.place = Path(place.name)
        self.nimbus = FakeNimbus(topology("words"))
        self.addCleanup(self.nimbus.stop)

    def run_cli(self, *words, program=None):
        return subprocess.run([program or self.build / "bin" / "iotcloud", "topology", *map(str, words)], text=True,
                              capture_output=True, check=False)

    def on_storm(self, *words):
        """What a verb prints about Storm."""
        done = self.run_cli(*words, "--engine", "storm", "--nimbus", self.nimbus.address)
        self.assertEqual((done.returncode, done.stderr), (0, ""))
        return done.stdout

    def data(self, *words):
        return json.loads(self.on_storm(*words, "-o", "json"))

    def file(self, more="", text="topology.name: t\ntopology.library: %s\nspouts:\n  in: {class: test.Numbers}\n"):
        file = self.place / "t.yaml"
        file.write_text((text % self.library if "%s" in text else text) + more)
        return file

    def recorder(self):
        """A copy of `iotcloud` beside an `iotcloud-storm` that only tells with which words it was called."""
        program = self.place / "bin" / "iotcloud"
        program.parent.mkdir()
        shutil.copy(self.build / "bin" / "iotcloud", program)
        stand_in = program.with_name("iotcloud-storm")
        stand_in.write_text('#!/bin/sh\nprintf "%s\\n" "$@"\n')
        stand_in.chmod(stand_in.stat().st_mode | stat.S_IXUSR)
        return program

    def test_list_has_the_keys_of_our_own_topologies(self):
        (row,) = self.data("list")
        self.assertEqual((row["topology"], row["state"], row["workers"]), ("words", "active", ["lab1:6700", "lab2:6701"]))
        self.assertEqual((row["spouts"], row["bolts"]), (["in"], ["count"]))
        self.assertLessEqual(abs(time.time() * 1000 - 60_000 - row["since_ms"]), 30_000)
        table = self.on_storm("list")
        self.assertRegex(table, r"TOPOLOGY +STATE +WORKERS +SINCE +SPOUTS +BOLTS\nwords +active +2 +\S+ +in +count\n")
        self.assertIn("topology: words", self.on_storm("list", "-o", "yaml"))

    def test_show_has_workers_components_and_executors(self):
        self.nimbus.topologies["words"]["errors"] = [("count", OF_TUPLE, 7, "lab2", 6701)]
        shown = self.data("show", "words")
        self.assertEqual([(worker["worker"], worker["host"], worker["state"]) for worker in shown["workers"]],
                         [("lab1:6700", "lab1", "active"), ("lab2:6701", "lab2", "active")])
        spout, bolt = shown["components"]
        self.assertEqual((spout["id"], spout["kind"], spout["emitted"], spout["failed"]), ("in", "spout", 10, 1))
        self.assertEqual((bolt["id"], bolt["kind"], bolt["executed"], bolt["errors"], bolt["last_error"]),
                         ("count", "bolt", 10, 1, "not number 100"))
        self.assertEqual([(each["component"], each["tasks"], each["runs"]) for each in shown["executors"]],
                         [("in", "1-2", True), ("count", "3-4", True)])
        self.assertRegex(self.on_storm("show", "words"), r"words: active, 2 workers of Apache Storm\n(.|\n)*count +bolt +2/2")

    def test_metrics_are_sums_of_components(self):
        told = self.data("metrics", "words", "--window", "600")
        self.assertEqual((told["topology"], told["workers"], told["window"]), ("words", 2, "600"))
        spout, bolt = told["components"]
        self.assertEqual((spout["component"], spout["kind"], spout["sum"]["acked"], spout["sum"]["complete"]["mean_us"]),
                         ("in", "spout", 9, 2500))
        self.assertEqual((bolt["sum"]["executed"], bolt["sum"]["execute"]["mean_us"], bolt["sum"]["capacity"]), (10, 500, 0.25))

    def test_watch_shows_it_again_and_again(self):
        process = subprocess.Popen([self.build / "bin" / "iotcloud", "topology", "metrics", "words", "--watch", "0.1", "-o", "json",
                                    "--engine", "storm", "--nimbus", self.nimbus.address], text=True, stdout=subprocess.PIPE)
        with process:
            self.assertEqual([json.loads(process.stdout.readline())["topology"] for _ in range(2)], ["words"] * 2)
            process.send_signal(2)
            process.stdout.read()
            self.assertEqual(process.wait(), 0)

    def test_orders_reach_nimbus_and_are_answered_as_ours(self):
        self.assertEqual(self.data("deactivate", "words"), {"ok": True, "text": "words is inactive", "outcomes": []})
        self.assertEqual(self.data("list")[0]["state"], "inactive")
        self.assertEqual(self.on_storm("activate", "words"), "words is active\n")
        moved = self.data("rebalance", "words", "count=4", "--workers", "2")
        self.assertEqual([(each["worker"], each["outcome"]) for each in moved["outcomes"]],
                         [("lab1:6700", "done"), ("lab2:6701", "done")])
        self.assertEqual(self.on_storm("kill", "words", "--drain", "3"), "words was killed\n")
        orders = {method: arguments for method, arguments in self.nimbus.told}
        self.assertEqual(orders["rebalance"][2][2], 2)
        self.assertEqual(orders["rebalance"][2][3], [(b"count", 4)])
        self.assertEqual(orders["killTopologyWithOpts"], {1: b"words", 2: {1: 3}})
        self.assertEqual(self.data("list"), [])

    def test_errors_are_told_with_component_worker_and_time(self):
        self.nimbus.topologies["words"]["errors"] = [("count", OF_TUPLE, 7, "lab2", 6701)]
        self.assertEqual(self.data("errors", "words"), [
            {"component": "count", "worker": "lab2:6701", "time_ms": 7000, "error": "not number 100"}])

    def test_a_topology_that_is_not_there_is_refused_with_those_that_are(self):
        done = self.run_cli("show", "letters", "--engine", "storm", "--nimbus", self.nimbus.address)
        self.assertEqual(done.returncode, 1)
        self.assertIn('no topology "letters" runs; there are words', done.stderr)

    def test_options_of_storm_need_storm(self):
        for words in (("list", "--nimbus", "a:1"), ("metrics", "t", "--window", "600"), ("rebalance", "t", "--workers", "2"),
                      ("kill", "t", "--patience", "1")):
            done = self.run_cli(*words)
            self.assertEqual(done.returncode, 2, done)
            self.assertIn("add --engine storm", done.stderr)
        self.assertIn("COMPONENT=N is required", self.run_cli("rebalance", "t").stderr)
        for words in (("metrics", "t", "--rates"), ("activate", "t", "--timeout", "3")):
            self.assertEqual(self.run_cli(*words, "--engine", "storm").returncode, 2)
        self.assertIn("--nimbus", self.run_cli("list", "--help").stdout)

    def test_the_engine_may_stand_in_the_file(self):
        program = self.recorder()
        done = self.run_cli("submit", "--nimbus", "a:1,b:2", self.file(ON_STORM), "--workers", 3, "--wait", "7.5", program=program)
        self.assertEqual((done.returncode, done.stdout.split()), (0, [
            "submit", str(self.place / "t.yaml"), "--workers", "3", "--limit", "8", "--nimbus", "a:1,b:2", "--output", "table"]))
        done = self.run_cli("submit", self.file(), "--engine", "storm", "-o", "json", program=program)
        self.assertEqual(done.stdout.split(), ["submit", str(self.place / "t.yaml"), "--output", "json"])

    def test_an_engine_that_the_file_contradicts_is_refused_at_its_line(self):
        for words in (("submit", self.file(ON_STORM), "--engine", "pool"), ("update", self.file(ON_STORM))):
            done = self.run_cli(*words)
            self.assertNotEqual(done.returncode, 0)
            self.assertRegex(done.stderr, r"t\.yaml:5:\d+: engine\.storm: the file gives the topology to Apache Storm")
        done = self.run_cli("submit", self.file(), "--nimbus", "a:1")
        self.assertEqual(done.returncode, 2)
        self.assertIn("--nimbus: it is for topologies on Apache Storm", done.stderr)

    def submit(self, errors=(), reported=True, wait="60"):
        """Submits a topology whose components say this as soon as it is submitted. `wait`: seconds."""
        def submitted(name):
            self.nimbus.topologies[name] = topology(name, errors=list(errors), executors=[
                ("in", 1, 2, "lab1", 6700, 1, reported), ("count", 3, 4, "lab2", 6701, 1, True)])
        self.nimbus.submitted = submitted
        return self.run_cli("submit", self.file(ON_STORM), "--nimbus", self.nimbus.address, "--wait", wait, "-o", "json")

    def test_a_submission_is_answered_when_all_tasks_run(self):
        done = self.submit()
        self.assertEqual(done.returncode, 0, done.stderr)
        answer = json.loads(done.stdout)
        self.assertEqual((answer["ok"], answer["text"]), (True, "t runs: 4 tasks in 2 workers"))
        self.assertEqual([each["worker"] for each in answer["outcomes"]], ["lab1:6700", "lab2:6701"])

    def test_an_error_of_a_tuple_is_noted_and_the_topology_runs(self):
        done = self.submit([("count", OF_TUPLE, 7, "lab2", 6701)])
        self.assertEqual(done.returncode, 0, done.stderr)
        self.assertIn("its component count says: not number 100 (lab2:6701), and goes on", done.stderr)

    def test_an_error_that_ends_a_worker_is_why_it_does_not_run(self):
        done = self.submit([("count", FATAL, 7, "lab2", 6701)])
        self.assertEqual(done.returncode, 1)
        self.assertIn("t does not run: its component count says: java.lang.RuntimeException: there is no class", done.stderr)

    def test_tasks_that_do_not_run_in_time_are_named(self):
        done = self.submit([("in", OF_TUPLE, 7, "lab2", 6701)], reported=False, wait="3")
        self.assertEqual(done.returncode, 1)
        self.assertIn("tasks of in do not run yet", done.stderr)


if __name__ == "__main__":
    Answers.build, Answers.library = map(Path, sys.argv[1:3])
    os.environ.pop("IOTCLOUD_MASTER", None)
    try:
        storm_jar.build()
    except Unavailable as reason:
        print(reason)
        sys.exit(1 if os.environ.get("CI") == "true" else SKIPPED)
    unittest.main(argv=sys.argv[:1])

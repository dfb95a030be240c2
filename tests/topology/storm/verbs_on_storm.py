#!/usr/bin/python3
"""What `iotcloud-storm` does to a topology that runs on a private Storm: metrics, deactivate, activate, rebalance,
errors, kill; the report of a crash; Nimbus away and back; tuples that are late.

usage: verbs_on_storm.py BUILD LIBRARY     (BUILD: build/release; LIBRARY: the library of components.cc)
"""
import re
import subprocess
import sys
import urllib.request
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "servers"))
from fake_nimbus import FakeNimbus  # noqa: E402
from private_server import free_ports  # noqa: E402
from storm_case import StormCase, run  # noqa: E402

WAITS = "spout_wait: 5ms, bolt_wait: 5ms, back_pressure_wait: 5ms"
COUNT = 400


def steady(library, out, name, workers):
    return f"""
topology.name: {name}
topology.library: {library}
conf: {{out: "{out}", period_ms: 50}}
runtime: {{max_spout_pending: 500, message_timeout: 30s}}
engine: {{storm: {{workers: {workers}, {WAITS}}}}}
metrics: {{address: "127.0.0.1:{free_ports(1)[0]}"}}
spouts:
  numbers: {{class: test.Steady}}
bolts:
  crash: {{class: test.Crash, inputs: {{from: numbers}}}}
  count: {{class: test.Count, tick: 200ms, parallelism: 2, inputs: {{from: numbers}}}}
"""


def late(library, out):
    return f"""
topology.name: late
topology.library: {library}
conf: {{out: "{out}", count: {COUNT}}}
runtime: {{max_spout_pending: {COUNT}, message_timeout: 120s}}
engine: {{storm: {{{WAITS}}}}}
spouts:
  numbers: {{class: test.Numbers}}
bolts:
  slow: {{class: test.Slow, deadline: 2s, late_stream: late, inputs: {{from: numbers}}}}
  in_time: {{class: test.Count, tick: 200ms, inputs: {{from: slow}}}}
  too_late: {{class: test.Count, tick: 200ms, inputs: {{from: slow, stream: late}}}}
"""


def untracked(library, out):
    return f"""
topology.name: untracked
topology.library: {library}
conf: {{out: "{out}", count: {COUNT}}}
runtime: {{acking: false}}
engine: {{storm: {{{WAITS}}}}}
spouts:
  numbers: {{class: test.Numbers}}
bolts:
  count: {{class: test.Count, tick: 200ms, inputs: {{from: numbers}}}}
  direct: {{class: test.Count, tick: 200ms, parallelism: 2, inputs: {{from: numbers, grouping: direct, stream: chosen}}}}
"""


class VerbsOnStorm(StormCase):
    limit_s = 300

    def setUp(self):
        self.out = Path(self.place.name) / self.id().rpartition(".")[2]
        self.out.mkdir()

    def submit(self, text, *words):
        file = self.out / "topology.yaml"
        file.write_text(text)
        print(self.ask("submit", str(file), *words, "--limit", str(self.limit_s)), end="", flush=True)

    def spout(self):
        """What the steady spout wrote last, of all its processes the one that emits."""
        (words,) = self.counts(self.out, "numbers").values()
        return words

    def numbers(self):
        """How many numbers the bolt's tasks have seen."""
        return sum(words["numbers"] for words in self.counts(self.out, "count").values())

    def wait_for_more(self, what):
        before = (self.spout()["acked"], self.numbers())
        self.wait_for("more tuples " + what, lambda: self.spout()["acked"] != before[0] and self.numbers() != before[1])

    def has_workers(self, count):
        """Whether the topology has so many workers, in which all its executors run, and no worker of before runs."""
        (topology,) = [row for row in self.table("list") if row["topology"] == "steady"]
        return (len(topology["workers"]) == count == len(self.storm.running_workers()) and
                all(row["runs"] for row in self.table("show", "steady")["executors"]))

    def test_verbs_while_tuples_flow(self):
        self.submit(steady(self.library, self.out, "steady", 2))
        self.wait_for("tuples flow", lambda: self.counts(self.out, "count") and self.spout()["acked"])
        self.check_metrics()
        self.check_activation()
        for count in (1, 4):
            said = self.ask("rebalance", "steady", "--workers", str(count), "--wait", "1", "--limit", str(self.limit_s))
            self.assertRegex(said, r"steady runs: \d+ tasks in %d workers" % count)
            rows = self.table("show", "steady")["executors"]
            self.assertEqual((len({row["worker"] for row in rows}), {row["runs"] for row in rows}), (count, {True}))
            self.wait_for("only %d workers" % count, lambda n=count: self.has_workers(n))
            self.wait_for_more("in %d workers" % count)
        self.check_log_level()
        self.check_crash()
        self.check_nimbus()
        self.ask("kill", "steady", "--wait", "0")
        self.assertNotIn("steady", [row["topology"] for row in self.table("list")])
        refused = self.run_program("show", "steady", "--nimbus", self.storm.url())
        self.assertEqual(refused.returncode, 1)
        self.assertIn('no topology "steady" runs', refused.stderr)

    def test_a_spout_without_acks_that_emits_twice_in_a_call(self):
        """Storm calls ack() inside of the first emit."""
        self.submit(untracked(self.library, self.out))

        def seen(component):
            return sum(words["numbers"] for words in self.counts(self.out, component).values())
        self.wait_for("all numbers are done", lambda: self.counts(self.out, "numbers"))
        (done,) = self.counts(self.out, "numbers").values()
        self.assertEqual(done, {"done": COUNT, "failed": 0})
        for component in ("count", "direct"):
            self.wait_for("%s has all" % component, lambda c=component: seen(c) == COUNT)
        self.ask("kill", "untracked", "--wait", "0")

    def check_metrics(self):
        def counts():
            return {row["component"]: row["sum"] for row in self.table("metrics", "steady")["components"]}
        self.wait_for("Storm's counts", lambda: counts()["count"]["executed"] > 0 and counts()["numbers"]["acked"] > 0)
        rows = counts()
        self.assertEqual(set(rows), {"numbers", "crash", "count"})
        self.assertEqual((rows["count"]["tasks"], rows["count"]["failed"]), (2, 0))
        pages = self.worker_pages()
        self.assertEqual(len(pages), 2)
        texts = [urllib.request.urlopen(page, timeout=60).read().decode() for page in pages]
        self.assertEqual([bool(re.search(r"^test_emissions_total [1-9]", text, re.M)) for text in texts].count(True), 1)
        for name in ("iotcloud_spout_complete_seconds", "iotcloud_task_execute_seconds"):
            self.assertTrue(any(re.search(r"^%s_count\S* [1-9]" % name, text, re.M) for text in texts), name)
        self.assertGreater(rows["count"]["execute"]["mean_us"] + rows["numbers"]["complete"]["mean_us"], 0)

    def check_activation(self):
        active = self.spout()
        self.assertEqual((active["activated"], active["deactivated"]), (1, 0))
        self.assertIn("steady is inactive", self.ask("deactivate", "steady"))
        self.wait_for("the spout is inactive", lambda: self.spout()["deactivated"] == 1)
        self.assertEqual([row["state"] for row in self.table("list") if row["topology"] == "steady"], ["inactive"])
        self.wait_for("what was under way is acked", lambda: self.spout()["acked"] == self.spout()["emitted"])
        self.assertIn("steady is active", self.ask("activate", "steady"))
        self.wait_for("the spout is active", lambda: self.spout()["activated"] == 2)
        self.wait_for_more("after the activation")

    def check_log_level(self):
        def lines():
            return [line for log in self.artifacts("worker.log") for line in log.read_text(errors="replace").splitlines()
                    if re.search(r"\[DEBUG\] number \d+ is emitted", line)]
        self.assertEqual(lines(), [])
        self.assertIn("the workers' logger iotcloud has DEBUG", self.ask("set_log_level", "steady", "iotcloud=DEBUG"))
        self.wait_for("the component library's lines", lines)
        refused = self.run_program("set_log_level", "steady", "iotcloud=LOUD", "--nimbus", self.storm.url())
        self.assertEqual(refused.returncode, 1)
        self.assertIn('"iotcloud=LOUD" is not of the form LOGGER=LEVEL', refused.stderr)

    def check_crash(self):
        (self.out / "crash").touch()
        self.wait_for("the crash's report", lambda: self.artifacts("hs_err_*.log"))
        (report,) = self.artifacts("hs_err_*.log")
        self.wait_for("its frame", lambda: "crash_of_the_test" in report.read_text(errors="replace"))
        self.wait_for("four workers after the crash", lambda: len(self.storm.running_workers()) == 4)
        self.wait_for_more("after the crash")

    def check_nimbus(self):
        dead = "127.0.0.1:%d" % free_ports(1)[0]
        self.ask("list", "--nimbus", dead)  # and then the real one, which ask() adds
        with FakeNimbus() as other:
            other.leads = self.storm.url()
            said = self.run_program("list", "--nimbus", other.address)
            self.assertIn("steady", said.stdout)
            self.assertEqual(other.calls, ["getLeader"])
        self.storm.kill("nimbus")
        refused = self.run_program("list", "--nimbus", dead + "," + self.storm.url(), "--patience", "0")
        self.assertEqual(refused.returncode, 1)
        self.assertIn("no Nimbus answers and leads", refused.stderr)
        self.wait_for_more("without Nimbus")
        waiting = subprocess.Popen([self.build / "bin" / "iotcloud-storm", "list", "--nimbus", dead + "," + self.storm.url(),
                                    "--patience", str(self.limit_s)], text=True, stdout=subprocess.PIPE)
        self.storm.start("nimbus")
        said, _ = waiting.communicate()
        self.assertEqual(waiting.returncode, 0)
        self.assertIn("steady", said)
        self.assertIn("steady is rebalanced in 1 s",
                      self.ask("rebalance", "steady", "--workers", "2", "--wait", "1", "--limit", "0"))
        self.wait_for("two workers", lambda: self.has_workers(2))
        again = self.out / "again"
        again.mkdir()
        file = again / "again.yaml"
        file.write_text(steady(self.library, again, "again", 1))
        self.assertIn("again runs: 4 tasks in 1 workers", self.ask("submit", str(file), "--limit", str(self.limit_s)))
        self.wait_for_more("beside another topology")
        self.ask("kill", "again", "--wait", "0")

    def test_a_tuple_that_waited_too_long_goes_to_the_late_stream(self):
        self.submit(late(self.library, self.out))

        def seen(component):
            return sum(words["numbers"] for words in self.counts(self.out, component).values())
        self.wait_for("all tuples are seen", lambda: seen("in_time") + seen("too_late") == COUNT)
        self.assertGreater(seen("too_late"), 0)
        (done,) = self.counts(self.out, "numbers").values()
        self.assertEqual(done, {"done": COUNT, "failed": 0})
        self.ask("kill", "late", "--wait", "0")


if __name__ == "__main__":
    sys.exit(run(VerbsOnStorm, *sys.argv[1:3]))

#!/usr/bin/python3
"""C++ components on a private Storm: a chain and every grouping over two workers, with exact counts; exceptions, of groupings
too, ticks, answers from other threads; what `iotcloud-storm` says of them.

usage: components_run_on_storm.py BUILD LIBRARY     (BUILD: build/release; LIBRARY: the library of components.cc)
"""
import re
import sys
import urllib.request
import zipfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "servers"))
from private_server import free_ports  # noqa: E402
from storm_case import StormCase, run  # noqa: E402

COUNT = 4000
TASKS = 4
GROUPINGS = {
    "shuffle": "grouping: shuffle", "fields": "grouping: fields, fields: [key]",
    "partial": "grouping: partial_key, fields: [key]", "all": "grouping: all", "global": "grouping: global",
    "none": "grouping: none", "near": "grouping: local_or_shuffle", "own": "grouping: custom, class: test.ByNumber",
    "direct": "grouping: direct, stream: chosen", "picky": "grouping: custom, class: test.Picky"}


def yaml(library, out):
    bolts = "".join("  %s: {class: test.Count, parallelism: %d, tick: 100ms, inputs: {from: numbers, %s}}\n" %
                    (name, TASKS, grouping) for name, grouping in GROUPINGS.items())
    return f"""
topology.name: counts
topology.library: {library}
conf: {{out: "{out}", count: {COUNT}}}
metrics: {{address: "127.0.0.1:{free_ports(1)[0]}"}}
runtime: {{max_spout_pending: 500, message_timeout: 600s}}
engine:
  storm:
    workers: 2
    # Long waits: the test shares its cores with others.
    spout_wait: 5ms
    bolt_wait: 5ms
    back_pressure_wait: 5ms
spouts:
  numbers: {{class: test.Numbers}}
bolts:
  later: {{class: test.Later, inputs: {{from: numbers}}}}
  fussy: {{class: test.Fussy, inputs: {{from: later}}}}
  choosy: {{class: test.Count, parallelism: {TASKS}, tick: 100ms, inputs: {{from: later, grouping: custom, class: test.Picky}}}}
  relay: {{class: test.Relay, parallelism: {TASKS}, inputs: {{from: fussy, grouping: fields, fields: [key]}}}}
  end: {{class: test.Count, tick: 1s, deadline: 590s, inputs: {{from: relay, grouping: global}}}}
{bolts}"""


class ComponentsOnStorm(StormCase):
    def test_a_chain_and_every_grouping_over_two_workers(self):
        out = Path(self.place.name) / "out"
        out.mkdir()
        file = Path(self.place.name) / "counts.yaml"
        file.write_text(yaml(self.library, out))
        # The chain fails tuples on purpose, from the first second on: it runs all the same.
        submitted = self.run_program("submit", str(file), "--nimbus", self.storm.url(), "--wait", str(self.limit_s),
                                     program=("iotcloud", "topology"))
        self.assertEqual(submitted.returncode, 0, submitted.stderr + self.logs())
        self.assertRegex(submitted.stderr, r"the jar has, beside the component libraries: .*libyaml-cpp\.so\.0\.7")
        self.assertRegex(submitted.stderr, r"expected on the workers' machines: .*libc\.so\.6")
        self.assertRegex(submitted.stdout, r"counts runs: \d+ tasks in 2 workers")
        self.assertRegex(submitted.stderr, r"sent \d+ of \d+ KiB")
        self.wait_for("all numbers are done", lambda: self.counts(out, "numbers"))
        (done,) = self.counts(out, "numbers").values()
        # Each of these numbers is refused by a grouping of the spout, then by one of the bolt `later`, then by the bolt `fussy`.
        refused = COUNT // 100
        self.assertEqual(done, {"done": COUNT, "failed": 3 * refused}, self.logs())

        def total(component):
            return sum(number for task in self.counts(out, component).values() for word, number in task.items() if word[0] == "k")
        # A failed tuple is emitted again, to the other bolts, too; one that a grouping refuses goes to nobody.
        emitted = COUNT + 2 * refused
        expected = {**dict.fromkeys(GROUPINGS, emitted), "all": TASKS * emitted, "direct": COUNT, "choosy": COUNT + refused,
                    "end": COUNT}
        for component, count in expected.items():
            self.wait_for("%s has %d" % (component, count), lambda c=component, n=count: total(c) == n)
        self.check_groupings(out, emitted)
        processes = {task["process"] for name in GROUPINGS for task in self.counts(out, name).values()}
        self.assertEqual(len(processes), 2)
        damaged = [task for name in expected for task in self.counts(out, name).values() if task["damaged"]]
        self.assertEqual(damaged, [])
        self.assertTrue(all(task["ticks"] for name in expected for task in self.counts(out, name).values()))
        self.check_parcels()
        self.check_answers()

    def test_storms_own_client_takes_a_packed_jar(self):
        folder = Path(self.place.name)
        file, jar = folder / "packed.yaml", folder / "packed.jar"
        file.write_text(yaml(self.library, folder).replace("topology.name: counts", "topology.name: packed"))
        packed = self.run_program("pack", file, jar)
        self.assertEqual(packed.returncode, 0, packed.stderr)
        with zipfile.ZipFile(jar) as archive:
            names = archive.namelist()
        for name in ("resources/topology.yaml", "resources/libiotcloud_storm.so", "resources/" + self.library.name,
                     "resources/libyaml-cpp.so.0.7", "iotcloud/storm/CppBolt.class"):
            self.assertIn(name, names)
        self.assertNotIn("resources/libc.so.6", names)
        done = self.storm_jar(jar, "iotcloud.storm.Submit")
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        self.assertIn("packed", [row["topology"] for row in self.table("list")])
        self.ask("kill", "packed", "--wait", "0")

    def check_groupings(self, out, emitted):
        by_task = {name: self.counts(out, name) for name in GROUPINGS}

        def tasks_of_key(name, key):
            return [task for task, words in by_task[name].items() if key in words]
        keys = ["k%d" % i for i in range(10)]
        for key in keys:
            self.assertEqual(len(tasks_of_key("fields", key)), 1, key)
            self.assertLessEqual(len(tasks_of_key("partial", key)), 2, key)
        self.assertEqual(len(by_task["global"]), 1)
        for name in ("shuffle", "none"):
            for words in by_task[name].values():
                share = sum(words[key] for key in keys if key in words)
                self.assertAlmostEqual(share, emitted / TASKS, delta=COUNT / TASKS / 4, msg=name)
        for name in ("all", "own", "direct", "picky"):
            self.assertEqual(len(by_task[name]), TASKS, name)
        for words in by_task["all"].values():
            self.assertEqual(words["numbers"], COUNT)
        for name in ("own", "direct", "picky"):
            for words in by_task[name].values():
                self.assertEqual(words["numbers"], COUNT // TASKS, name)

    def check_parcels(self):
        """Large payloads on the way from `fussy` to `relay` and to `end` stayed in C++, as far as they stayed in a worker, and all
        were taken or opened."""
        pages = [urllib.request.urlopen(page, timeout=60).read().decode() for page in self.worker_pages()]
        self.assertEqual(len(pages), 2)
        made = [int(count) for page in pages for count in re.findall(r"^iotcloud_storm_parcels_total (\d+)", page, re.M)]
        left = [int(count) for page in pages for count in re.findall(r"^iotcloud_storm_parcel_bytes (\d+)", page, re.M)]
        self.assertGreater(sum(made), 0)
        self.assertEqual(sum(left), 0)

    def check_answers(self):
        (topology,) = [row for row in self.table("list") if row["topology"] == "counts"]
        self.assertEqual((topology["state"], len(topology["workers"])), ("active", 2))
        self.assertEqual((topology["spouts"], set(topology["bolts"])), (["numbers"], {"later", "fussy", "choosy", "relay", "end", *GROUPINGS}))
        expected = {"fussy": r"execute\(\) threw: not number \d+00",
                    "later": r"the grouping of later/default threw: nobody takes number \d+00",
                    "numbers": r"the grouping of numbers/default threw: nobody takes number \d+00"}

        def errors():
            return {row["component"]: row["error"] for row in self.table("errors", "counts")}
        self.wait_for("the components' errors", lambda: set(errors()) == set(expected))
        for component, text in expected.items():
            self.assertRegex(errors()[component], text)
        self.assertEqual({row["component"] for row in self.table("show", "counts")["executors"]},
                         {"numbers", "later", "fussy", "choosy", "relay", "end", *GROUPINGS})
        again = self.run_program("submit", str(Path(self.place.name) / "counts.yaml"), "--nimbus", self.storm.url())
        self.assertEqual(again.returncode, 1)
        self.assertIn("runs already", again.stderr)
        self.ask("kill", "counts", "--wait", "0")
        self.assertNotIn("counts", [row["topology"] for row in self.table("list")])


if __name__ == "__main__":
    sys.exit(run(ComponentsOnStorm, *sys.argv[1:3]))

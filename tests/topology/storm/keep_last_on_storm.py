#!/usr/bin/python3
"""keep_last of an input on a private Storm: while a bolt hangs, the tuples that wait for it are replaced and acked; then it
executes the newest of each key.

usage: keep_last_on_storm.py BUILD LIBRARY     (BUILD: build/release; LIBRARY: the library of components.cc)
"""
import os
import sys
from pathlib import Path

from storm_case import StormCase, run

COUNT = 4000
KEYS = 10
# The bolt hangs with one tuple, and the newest of each key waits.
NOT_REPLACED = KEYS + 1


def yaml(library, out):
    return f"""
topology.name: newest
topology.library: {library}
conf: {{out: "{out}", count: {COUNT}, told_from: {COUNT - NOT_REPLACED}}}
runtime: {{max_spout_pending: 500, message_timeout: 300s}}
engine: {{storm: {{workers: 2, spout_wait: 5ms, bolt_wait: 5ms, back_pressure_wait: 5ms}}}}
spouts:
  numbers: {{class: test.Numbers}}
bolts:
  newest: {{class: test.Newest, inputs: {{from: numbers, keep_last: 1, keep_key: [key]}}}}
"""


class KeepLastOnStorm(StormCase):
    def test_a_bolt_that_hangs_gets_the_newest_of_each_key(self):
        out = Path(self.place.name) / "out"
        out.mkdir()
        os.mkfifo(out / "go")
        file = Path(self.place.name) / "newest.yaml"
        file.write_text(yaml(self.library, out))
        print(self.ask("submit", str(file)), end="")

        def done():
            return [words["done"] for words in self.counts(out, "numbers").values()]
        self.wait_for("the replaced tuples are acked", done)
        self.assertEqual(done(), [COUNT - NOT_REPLACED])
        self.assertEqual(self.counts(out, "newest"), {})
        (out / "go").write_text("go")
        self.wait_for("all tuples are acked", lambda: done() == [COUNT])
        (newest,) = self.counts(out, "newest").values()
        last = range(COUNT - KEYS + 1, COUNT + 1)
        self.assertEqual(newest, {"executed": NOT_REPLACED, **{"k%d" % (number % KEYS): number for number in last}})
        self.assertEqual(self.table("errors", "newest"), [])
        self.ask("kill", "newest", "--wait", "0")


if __name__ == "__main__":
    sys.exit(run(KeepLastOnStorm, *sys.argv[1:3]))

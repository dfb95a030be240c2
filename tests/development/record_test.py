#!/usr/bin/python3
"""Tests what development/record.py measures of a command, and what it writes."""
import os
import sys
import tempfile
import unittest
import unittest.mock
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "development"))

import record  # noqa: E402

# Takes memory in its first step, and none in its second; each ends when the test has looked.
COMMAND = """
import os, sys, time
steps, folder = sys.argv[1:]
def wait_for(file):
    while not os.path.exists(os.path.join(folder, file)):
        time.sleep(0.01)
def end(name):
    with open(steps, "a") as file:
        file.write("1\\t" + name + "\\t0.5\\t2\\n")
taken = bytearray(os.urandom(1 << 20) * 200)
wait_for("seen_big")
del taken
end("big")
wait_for("seen_small")
end("small")
sys.exit(3)
"""


class RecordTest(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory(prefix="iotcloud-record-")
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)
        for name, value in (("STEPS", self.folder / "steps.tsv"), ("PERIOD_S", 0.05)):
            self.enterContext(unittest.mock.patch.object(record, name, value))

    def test_each_step_has_its_own_most_memory_and_a_failure_is_told(self):
        measure, looks = record.memory_mb, []

        def look(pid):
            memory = measure(pid)
            if memory > 200:
                (self.folder / "seen_big").touch()
            elif record.steps() and memory > 0:
                looks.append(pid)  # the first one may belong to a look that began before the big step's end
                if looks.count(pid) > 1:
                    (self.folder / "seen_small").touch()
            return memory

        with unittest.mock.patch.object(record, "memory_mb", look):
            status, rows, _ = record.run([sys.executable, "-c", COMMAND, str(record.STEPS), str(self.folder)],
                                         dict(os.environ))
        self.assertEqual(status, 3)
        self.assertEqual([row[0] for row in rows], ["big", "small", "whole (failed: 3)"])
        big, small, whole = (row[3] for row in rows)
        self.assertGreater(big, 200)
        self.assertLess(small, 100)
        self.assertEqual(whole, big)

    def test_processes_stay_the_commands_when_their_parents_end(self):
        family = record.Family(10)
        self.assertEqual(family.update({10: (1, "dev", 0), 11: (10, "sh", 0), 12: (11, "java", 0), 9: (1, "sshd", 0)}),
                         {10, 11, 12})
        self.assertEqual(family.update({10: (1, "dev", 0), 12: (1, "java", 0), 13: (12, "java", 0), 9: (1, "sshd", 0)}),
                         {10, 12, 13})

    def test_what_ran_beside_is_named_with_its_share(self):
        others = record.Others()
        others.update({9: (1, "burner", 0), 10: (1, "dev", 0)}, {10})
        others.update({9: (1, "burner", 3 * record.TICKS), 10: (1, "dev", 9 * record.TICKS)}, {10})
        self.assertEqual(others.text(3 / os.cpu_count()), "100 %: burner")

    def test_what_was_installed_before_it_could_run_counts(self):
        rows = [("packages", 60.0, 20.0, 50.0), ("compiling", 100.0, 190.0, 900.0), ("whole (failed: 1)", 161.0, 211.0, 900.0)]
        self.assertEqual(record.with_before(rows, 30.0, 7.0),
                         [("packages", 90.0, 27.0, 50.0), ("compiling", 100.0, 190.0, 900.0), ("whole (failed: 1)", 191.0, 218.0, 900.0)])

    def test_a_table_has_one_head(self):
        table = self.folder / "times.tsv"
        for _ in range(2):
            record.write(table, "2026-01-02 03:04", "abc", ["demo", "--robots", "8"], [("whole", 61.4, 90.6, 512.2)], "0 %")
        lines = table.read_text().splitlines()
        self.assertEqual(len(lines), 3)
        row = dict(zip(lines[0].split("\t"), lines[2].split("\t")))
        self.assertEqual(row, {"began": "2026-01-02 03:04", "commit": "abc", "command": "demo --robots 8",
                               "cores": str(os.cpu_count()), "step": "whole", "seconds": "61", "cpu_s": "91",
                               "memory_mb": "512", "beside": "0 %"})


if __name__ == "__main__":
    unittest.main()

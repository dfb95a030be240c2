#!/usr/bin/python3
"""What benchmarks say while they measure."""
import io
import json
import tempfile
import unittest
from pathlib import Path

import heartbeat


class LastRunTest(unittest.TestCase):
    def seconds(self, text, command):
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "runtime.json")
            file.write_text(text)
            return heartbeat.seconds_of_last_run(file, command)

    def test_is_that_of_the_same_command(self):
        written = json.dumps({"command": "./dev bench runtime", "seconds": 12.5})
        self.assertEqual(self.seconds(written, "./dev bench runtime"), 12.5)
        self.assertIsNone(self.seconds(written, "./dev bench runtime --quick"))

    def test_is_unknown_without_a_file_that_can_be_read(self):
        self.assertIsNone(self.seconds("{", "./dev bench runtime"))
        self.assertIsNone(heartbeat.seconds_of_last_run(Path("/nowhere.json"), "./dev bench runtime"))


class SignTest(unittest.TestCase):
    def test_without_a_terminal_there_is_a_line_every_30_s(self):
        now, out = [0.0], io.StringIO()
        line = heartbeat.Line(out, lambda: now[0])
        for now[0] in (2.0, 29.0, 31.0, 40.0, 62.0):
            line.say(f"at {now[0]:.0f}")
        self.assertEqual(out.getvalue(), "at 31\nat 62\n")

    def test_says_what_is_left_by_the_time_of_the_last_run(self):
        self.assertEqual(heartbeat.Heartbeat("runtime", 200).text(80), "runtime: 80 s, about 2.0 min left")
        self.assertEqual(heartbeat.Heartbeat("runtime", None).text(80), "runtime: 80 s")


if __name__ == "__main__":
    unittest.main()

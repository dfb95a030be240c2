#!/usr/bin/python3
"""What development/loop.py writes of its times; nothing is built."""
import contextlib
import io
import json
import sys
import tempfile
import unittest
from pathlib import Path
from unittest import mock

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "development"))

import loop  # noqa: E402  (it finds bench/figures.py)
import kept  # noqa: E402

TIMES = {"gateway": 20.0, "brokers": 50.0, "master": 30.0}


class LoopTest(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory(prefix="iotcloud-loop-")
        self.addCleanup(folder.cleanup)
        self.file = Path(folder.name, "loop.json")

    def measured(self, *rooms):
        """Measures with given times in place of builds; returns what was written."""
        def timed(file, command):
            return TIMES.get(command[2], 100.0 if file.suffix == ".h" else 10.0) if len(command) > 2 else 100.0
        words = ["loop.py", "--json", str(self.file), *(word for room in rooms for word in ("--room", room))]
        with (mock.patch.object(loop, "timed", timed), mock.patch.object(loop.subprocess, "run"),
              mock.patch.object(loop.figures, "commit", return_value="0123"), mock.patch.object(sys, "argv", words),
              contextlib.redirect_stdout(io.StringIO())):
            loop.main()
        return json.loads(self.file.read_text())

    def test_the_median_of_the_rooms_is_judged(self):
        written = self.measured(*TIMES)
        self.assertEqual(written["command"], "./dev bench loop --room gateway --room brokers --room master")
        first, *rows = written["results"]
        self.assertEqual((first["name"], first["value"], first["target"], first["met"]),
                         ("one changed room, median", 30.0, "<= 45", True))
        self.assertEqual([row["value"] for row in rows], [20.0, 50.0, 30.0])
        self.assertRegex(rows[0]["name"], r"^one changed room: gateway/.*\.cc$")

    def test_it_tells_meanwhile_how_long_the_last_run_took(self):
        last = self.measured("gateway")
        with mock.patch.object(loop, "Heartbeat") as heartbeat:
            self.measured("gateway")
        heartbeat.assert_called_once_with("loop", last["seconds"])

    def test_all_rooms_and_the_headers_can_be_kept_and_shown(self):
        self.measured()
        data = kept.read(self.file)
        self.assertEqual(len(data["results"]), 2 + len(loop.ROOMS) + len(loop.HEADERS))
        text = kept.shown(self.file.parent, "loop", ".")
        self.assertIn("| one changed header, median | 100 s |  |  | <= 240, met |", text)
        self.assertIn("| one changed header: config/error.h | 100 s |", text)


if __name__ == "__main__":
    unittest.main()

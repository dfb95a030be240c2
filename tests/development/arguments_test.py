#!/usr/bin/python3
"""Tests which tests ./dev test asks ctest for; nothing is installed, compiled or tested."""
import os
import re
import shutil
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path

TREE = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(TREE / "development"))

import choose  # noqa: E402

STAND_INS = {
    "dpkg-query": "printf installed",
    "cmake": "mkdir -p build/release; touch build/release/build.ninja",
    "ninja": """case "$*" in
  *build.ninja*) ;;
  *release*) echo 'ninja: no work to do.' ;;
  *) exit 1 ;;
esac""",
    "ctest": """printf '%s\\n' "$@" >asked
echo '<testsuite><testcase name="Url.Reads" time="1" status="run"/></testsuite>' >build/release/tests.xml""",
}


class ArgumentsTest(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory(prefix="iotcloud-arguments-")
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)
        shutil.copy(TREE / "dev", self.folder)
        shutil.copytree(TREE / "development", self.folder / "development", ignore=shutil.ignore_patterns("__pycache__"))
        (self.folder / "development/pace.py").write_text("print(0.5)\n")  # it takes a while
        (self.folder / "build/release").mkdir(parents=True)
        (self.folder / "build/release/test_list.tsv").write_text("url_test\ttest\tunit room:brokers\turl_test\t\t\n")
        for name, text in STAND_INS.items():
            (self.folder / name).write_text(f"#!/bin/sh\n{text}\n")
            (self.folder / name).chmod(0o755)

    def run_dev(self, *words):
        environment = {name: value for name, value in os.environ.items() if name != "IOTCLOUD_STEPS"}
        return subprocess.run([self.folder / "dev", "test", *words], capture_output=True, text=True,
                              stdin=subprocess.DEVNULL, env={**environment, "PATH": f"{self.folder}:{environment['PATH']}"})

    def choice(self, *words):
        """The words of a choice that ctest got."""
        done = self.run_dev(*words)
        self.assertEqual(done.returncode, 0, done.stdout + done.stderr)
        asked = (self.folder / "asked").read_text().splitlines()
        return asked[asked.index("-L"):]

    def refusal(self, *words):
        (self.folder / "asked").unlink(missing_ok=True)
        done = self.run_dev(*words)
        self.assertEqual(done.returncode, 1, done.stdout + done.stderr)
        self.assertFalse((self.folder / "asked").exists())
        return done.stderr

    def test_a_room_is_chosen_by_its_own_label(self):
        self.assertEqual(self.choice("system", "brokers", "--unit"),
                         ["-L", "^(unit|contract|server|system)$", "-L", "^room:(system|brokers)$", "-L", "^unit$",
                          "-LE", "^long$"])

    def test_options_of_ctest_are_passed_on_with_their_values(self):
        for option in ("-L", "--label-regex", "-j"):
            self.assertEqual(self.choice(option, "brokers")[-2:], [option, "brokers"])
        self.assertEqual(self.choice("--schedule-random", "brokers")[-1], "--schedule-random", "it has no value")
        self.assertIn("-L needs a value", self.refusal("-L"))

    def test_what_cannot_be_chosen_is_refused_with_what_to_do_instead(self):
        self.assertIn("there is no room \"borkers\"", self.refusal("borkers"))
        self.assertIn("./dev test brokers", self.refusal("--quick", "brokers"))
        self.assertIn("./dev test --unit -R Url", self.refusal("--unit", "--quick", "-R", "Url"))
        self.assertIn("./dev test --long -L '^room:brokers$'", self.refusal("brokers", "--long"))
        self.assertIn("./dev test --long -L '^room:brokers$'", self.refusal("--long", "--preset", "asan"))
        self.assertIn("./dev test --repeat 3 -L '^room:brokers$'", self.refusal("--repeat", "3", "gateway"))

    def test_both_know_the_same_options_with_values(self):
        listed = re.search(r"^ctest_options_with_value=\((.*?)\)", (TREE / "dev").read_text(), re.MULTILINE | re.DOTALL)
        self.assertEqual(listed[1].split(), list(choose.WITH_VALUE))

    def test_a_preset_that_cannot_be_built_is_in_the_table_of_the_long_tests(self):
        for preset in ("asan", "tsan", "fuzz", "lint"):
            (self.folder / "build" / preset).mkdir()
            (self.folder / "build" / preset / "test_list.tsv").write_text(
                f"url_test\ttest\tunit room:brokers {preset}_long\turl_test\t\t\n")
        done = self.run_dev("--long")
        self.assertEqual(done.returncode, 1)
        self.assertIn("not built: asan tsan fuzz\n", done.stdout)
        rows = [line.split("\t")[:3] for line in (self.folder / "build/long/tests.tsv").read_text().splitlines()[2:]]
        self.assertEqual(rows, [["release", "Url.Reads", "passed"],
                                *([preset, "building", "failed"] for preset in ("asan", "tsan", "fuzz"))])

    def test_every_room_with_tests_can_be_chosen(self):
        text = (TREE / "dev").read_text()
        rooms = re.search(r"^rooms=\((.*?)\)", text, re.MULTILINE | re.DOTALL)[1].split()
        folders = {file.parent.name for file in (TREE / "tests").glob("*/CMakeLists.txt")}
        self.assertEqual(set(rooms), folders)


if __name__ == "__main__":
    unittest.main()

#!/usr/bin/python3
"""Tests how development/progress.py reads the output of ninja, ctest and CMake."""
import io
import sys
import tempfile
import unittest
from pathlib import Path
from unittest import mock

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "development"))

import progress  # noqa: E402


class BuildTest(unittest.TestCase):
    def test_counts_steps_and_names_the_last(self):
        build = progress.Build({})
        self.assertIsNone(build.take("[12/48] Building CXX object brokers/CMakeFiles/x.dir/url.cc.o"))
        self.assertEqual(build.text(), ("step 12 of 48", "url.cc"))
        self.assertEqual(build.share(), 0.25)

    def test_passes_on_what_a_compiler_says(self):
        self.assertEqual(progress.Build({}).take("url.cc:3:1: error: no"), "url.cc:3:1: error: no")
        self.assertIsNone(progress.Build({}).take("ninja: Entering directory `build/release'"))


class TestsTest(unittest.TestCase):
    def take(self, tests, *lines):
        return [text for text in map(tests.take, lines) if text]

    def test_counts_and_names_those_that_run(self):
        tests = progress.Tests({})
        said = self.take(tests, "      Start  1: Url.Reads", "      Start  2: brokers_contract_test.kafka",
                         " 1/40 Test  #1: Url.Reads ...........................   Passed    0.03 sec")
        self.assertEqual(said, [])
        self.assertEqual(tests.text(), ("39 of 40 left", "brokers_contract_test.kafka"))

    def test_tells_failures_at_once_and_skips_not(self):
        tests = progress.Tests({})
        said = self.take(tests, " 1/3 Test  #1: A.b ....***Failed    0.30 sec", " 2/3 Test  #2: C.d ....***Skipped   0.30 sec",
                         " 3/3 Test  #3: E.f ....***Timeout 300.01 sec")
        self.assertEqual(said, ["FAILED after 0.3 s: A.b", "FAILED after 300.0 s: E.f"])

    def test_knows_by_earlier_runs_how_far_it_is(self):
        tests = progress.Tests({"Short": 1.0, "Long": 99.0})
        self.take(tests, " 1/2 Test  #1: Long ....   Passed    50.00 sec")
        self.assertEqual(tests.share(), 0.99)


class ConfigurationTest(unittest.TestCase):
    def test_tells_the_last_line_and_passes_on_none(self):
        configuration = progress.Configuration({})
        self.assertIsNone(configuration.take("-- Found OpenSSL: /usr/lib/libcrypto.so"))
        self.assertIsNone(configuration.take(""))
        self.assertEqual(configuration.text(), ("under way", "Found OpenSSL: /usr/lib/libcrypto.so"))


    def test_in_a_new_folder_its_lines_say_how_far_it_is(self):
        configuration = progress.Configuration({})
        for _ in range(progress.Configuration.LINES // 2):
            configuration.take("-- Found it")
        self.assertEqual(configuration.share(), 0.5)
        for _ in range(progress.Configuration.LINES):
            configuration.take("-- and more than was thought")
        self.assertEqual(configuration.share(), 0.0, "that is not known")


class TellerTest(unittest.TestCase):
    def test_without_a_terminal_tells_every_30_s_how_much_is_left(self):
        now = [0.0]
        out = io.StringIO()
        build = progress.Build({})
        teller = progress.Teller("building release", build, out, lambda: now[0])
        build.take("[10/40] Linking CXX executable bin/x")
        for now[0] in (10.0, 29.0, 31.0, 45.0):
            teller.tick()
        self.assertEqual(out.getvalue(), "building release: step 10 of 40, 31 s, about 1.6 min left   x\n")

    def test_what_it_took_the_last_time_says_how_much_is_left(self):
        now = [0.0]
        out = io.StringIO()
        teller = progress.Teller("docs", progress.Other({}), out, lambda: now[0], before=40.0)
        for now[0] in (31.0, 62.0):
            teller.tick()
        self.assertEqual(out.getvalue(), "docs: under way, 31 s, about 9 s left\ndocs: under way, 62 s\n")

    def test_what_took_long_is_kept_for_the_next_time(self):
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder, "took", "docs")
            self.assertEqual(progress.Took(file).seconds, 0.0)
            progress.Took(file).keep(40.2)
            progress.Took(file).keep(1.0)  # nothing had changed
            self.assertEqual(progress.Took(file).seconds, 40.0)
            with mock.patch.object(sys, "argv", ["progress.py", "other", "docs", "--took", str(file)]), \
                    mock.patch.object(progress, "lines_with_pauses", return_value=iter([])), \
                    mock.patch.object(progress.Teller, "spent", return_value=7.0):
                progress.main()
            self.assertEqual(file.read_text(), "7\n")

    def test_of_another_program_it_tells_the_time_and_passes_on_all_lines(self):
        now = [0.0]
        out = io.StringIO()
        other = progress.Other({})
        teller = progress.Teller("the Java servers", other, out, lambda: now[0])
        for now[0] in (29.0, 31.0, 60.0, 62.0):
            teller.tick()
        self.assertEqual(out.getvalue(), "the Java servers: under way, 31 s\nthe Java servers: under way, 62 s\n")
        self.assertEqual(other.take("Maven cannot fetch the jars"), "Maven cannot fetch the jars")


if __name__ == "__main__":
    unittest.main()

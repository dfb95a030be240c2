#!/usr/bin/python3
"""Tests what development/failures.py shows of ctest's log."""
import sys
import unittest
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "development"))

import failures  # noqa: E402

PASSED = " 1/3 Test  #1: A.b ....   Passed    0.30 sec"
FAILED = " 2/3 Test  #2: C.d ....***Failed    0.30 sec"
SKIPPED = " 3/3 Test  #3: E.f ....***Skipped   0.30 sec"
END = "50% tests passed, 1 tests failed out of 2"


class FailuresTest(unittest.TestCase):
    def shown(self, *lines):
        return list(failures.failures(lines, "tests.log"))

    def test_only_failed_tests_are_shown_and_of_them_not_the_cases_that_passed(self):
        self.assertEqual(
            self.shown(PASSED, "fine", FAILED, "begins", "[ RUN      ] C.one", "said", "[       OK ] C.one (3 ms)",
                       "[ RUN      ] C.two", "wrong", "[  FAILED  ] C.two (1 ms)", SKIPPED, "no server", END),
            [FAILED, "begins", "[ RUN      ] C.two", "wrong", "[  FAILED  ] C.two (1 ms)"])

    def test_a_long_output_keeps_its_first_and_last_lines(self):
        shown = self.shown(FAILED, *map(str, range(200)), END)
        self.assertEqual(len(shown), 121)
        self.assertEqual((shown[0], shown[60], shown[-1]), (FAILED, "[81 lines are left out: tests.log]", "199"))


if __name__ == "__main__":
    unittest.main()

#!/usr/bin/python3
"""What slowness.py makes of its measurements."""

import time
import unittest

from slowness import Slowness


class SlownessTest(unittest.TestCase):
    def test_a_wait_counts_in_full_and_work_as_on_a_free_processor(self):
        slowness = Slowness()
        for second in range(1, 11):
            slowness.note(second, took=0.004, worked=0.001)
        self.assertAlmostEqual(slowness.factor(2, 9), 4)
        self.assertAlmostEqual(slowness.without(2, 9, idle=5), 5.5)
        self.assertAlmostEqual(slowness.without(2, 9), 7 / 4)
        self.assertAlmostEqual(slowness.without(2, 4, idle=5), 2)

    def test_what_was_measured_before_and_after_does_not_count(self):
        slowness = Slowness()
        for second, took in ((1, 1), (2, 0.002), (3, 0.002), (4, 1)):
            slowness.note(second, took, worked=0.001)
        self.assertAlmostEqual(slowness.factor(1.5, 2.5), 2)

    def test_nothing_gets_longer_by_it(self):
        slowness = Slowness()
        for second in (1, 2):
            slowness.note(second, took=0.0009, worked=0.001)
        self.assertEqual(slowness.factor(1, 2), 1)

    def test_a_machine_is_measured(self):
        with Slowness() as slowness:
            began = time.time()
            self.assertGreaterEqual(slowness.factor(began, began + 0.1), 1)


if __name__ == "__main__":
    unittest.main()

#!/usr/bin/python3
"""Schedules that show a violation are made smaller."""
import unittest

from shrink import shrink


class ShrinkTest(unittest.TestCase):
    def smallest(self, count, needed, budget=1000):
        """The part of 0, 1, ... that is left, and how many runs that took; a part fails that has all of `needed`."""
        runs = []

        def fails(part):
            runs.append(part)
            return set(needed) <= set(part)

        return shrink(range(count), fails, budget), len(runs)

    def test_one_cause_is_found_among_many(self):
        for cause in range(16):
            self.assertEqual(self.smallest(16, [cause])[0], [cause])
        self.assertLessEqual(self.smallest(64, [40])[1], 13)

    def test_causes_that_are_needed_together_are_kept_in_order(self):
        self.assertEqual(self.smallest(20, [3, 17])[0], [3, 17])
        self.assertEqual(self.smallest(33, [0, 16, 32])[0], [0, 16, 32])
        self.assertEqual(self.smallest(5, range(5))[0], list(range(5)))

    def test_the_budget_of_runs_is_kept(self):
        for budget in (0, 1, 5, 20):
            part, runs = self.smallest(40, [1, 20, 39], budget)
            self.assertEqual(runs, min(runs, budget))
            self.assertLessEqual({1, 20, 39}, set(part))

    def test_a_violation_that_does_not_come_again_leaves_the_schedule_as_it_is(self):
        self.assertEqual(shrink([1, 2, 3], lambda part: False, 50), [1, 2, 3])
        self.assertEqual(shrink([1], lambda part: True, 50), [1])

    def test_each_smaller_part_is_told(self):
        kept = []
        shrink(range(8), lambda part: 5 in part, 50, lambda part, runs: kept.append((list(part), runs)))
        self.assertEqual(kept[-1][0], [5])
        self.assertEqual([len(part) for part, _ in kept], sorted((len(part) for part, _ in kept), reverse=True))


if __name__ == "__main__":
    unittest.main()

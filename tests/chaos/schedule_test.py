#!/usr/bin/python3
"""Schedules of faults: from a seed, and from text."""
import unittest

import schedule
from schedule import Action, generate, parse, text


def faults(actions):
    return [action for action in actions if not action.is_order]


class ScheduleTest(unittest.TestCase):
    def test_a_seed_gives_the_same_schedule_each_time_and_another_seed_another_one(self):
        self.assertEqual(generate(7, 60), generate(7, 60))
        self.assertNotEqual(generate(7, 60), generate(8, 60))
        self.assertNotEqual(generate(7, 60), generate(7, 60, "activemq"))

    def test_text_gives_the_same_schedule_back(self):
        for seed in range(50):
            actions = generate(seed, 60)
            self.assertEqual(parse(text(actions, "a title")), actions)

    def test_at_most_two_faults_are_under_way_and_no_target_has_two(self):
        for seed in range(200):
            made = faults(generate(seed, 120))
            for action in made:
                others = [other for other in made if other is not action and other.begin <= action.begin < other.end]
                self.assertLessEqual(len(others), 1, seed)
                self.assertNotIn(action.target, [other.target for other in others], seed)

    def test_faults_keep_to_their_limits(self):
        for seed in range(200):
            for action in faults(generate(seed, 60)):
                kind = schedule.FAULTS[action.kind]
                self.assertIn(action.target, kind.targets)
                self.assertLessEqual(action.length, kind.longest)
                self.assertLessEqual(action.end, 60.01)

    def test_every_kind_of_fault_on_every_target_comes_sometime(self):
        seen = {(action.kind, action.target) for seed in range(400) for action in generate(seed, 300)}
        for name, kind in schedule.FAULTS.items():
            for target in kind.targets:
                self.assertIn((name, target), seen)
        self.assertLessEqual({(order, guest) for order in schedule.ORDERS for guest in schedule.GUESTS}, seen)

    def test_two_faults_at_once_are_common(self):
        made = faults(generate(3, 600))
        both = [action for action in made if any(other is not action and other.begin <= action.begin < other.end
                                                 for other in made)]
        self.assertGreater(len(both), len(made) / 4)

    def test_chosen_kinds_and_targets_only(self):
        made = faults(generate(1, 600, kinds=("kill", "cut"), targets=("worker-1", "gateway-1>broker")))
        self.assertEqual({action.kind for action in made}, {"kill", "cut"})
        self.assertEqual({action.target for action in made}, {"worker-1", "gateway-1>broker"})
        with self.assertRaisesRegex(ValueError, "there is no fault \"kil\""):
            generate(1, 60, kinds=("kil",))

    def test_what_a_broker_cannot_do_is_left_out(self):
        self.assertNotIn("forbid", {action.kind for seed in range(50) for action in generate(seed, 300, "activemq")})

    def test_text_that_is_no_schedule_is_refused_with_its_line(self):
        self.assertEqual(parse("# nothing\n\n 1.5 kill worker-1 2 # why\n"), [Action(1.5, "kill", "worker-1", 2.0)])
        for wrong, why in (("1 kill worker-1", "line 1: .* is no action"), ("\nx kill worker-1 2", "line 2"),
                           ("1 kill worker-9 2", "there is no \"kill\" of \"worker-9\""),
                           ("1 tickle worker-1 2", "there is no \"tickle\""), ("1 deploy worker-1 0", "there is no")):
            with self.assertRaisesRegex(ValueError, why):
                parse(wrong)


if __name__ == "__main__":
    unittest.main()

#!/usr/bin/python3
"""What is known of a guest after the command line has answered, and answers that are not true."""
import json
import unittest
from pathlib import Path
from types import SimpleNamespace

from orders import ABSENT, ACTIVE, FAILED, INACTIVE, NOT_THERE, Guest, Orders, Person, UntrueAnswer


def answer(outcome):
    return {"outcomes": [{"instance": "1", "outcome": outcome}]}


def guest(*answers):
    made = Guest("guest-1", "gateway-1", ("one.so", "two.so"))
    for kind, outcome in answers:
        made.learn(kind, 0, answer(outcome) if outcome else None)
    return made


class OrdersTest(unittest.TestCase):
    def test_an_order_that_is_done_or_pending_leaves_one_state(self):
        self.assertEqual(guest().possible, {ABSENT})
        self.assertEqual(guest(("deploy", "done")).possible, {ACTIVE})
        self.assertEqual(guest(("deploy", "unknown"), ("stop", "done")).possible, {INACTIVE})
        self.assertEqual(guest(("deploy", "done"), ("undeploy", "pending")).possible, {ABSENT})

    def test_an_order_of_which_nothing_is_known_leaves_both_states(self):
        self.assertEqual(guest(("deploy", "unknown")).possible, {ABSENT, ACTIVE})
        self.assertEqual(guest(("deploy", None)).possible, {ABSENT, ACTIVE})
        self.assertEqual(guest(("deploy", "done"), ("stop", "failed")).possible, {ACTIVE, INACTIVE, FAILED})
        self.assertEqual(guest(("deploy", "done"), ("update", "failed")).possible, {ACTIVE})

    def test_a_state_that_no_answer_permits_is_found(self):
        orders = Orders(SimpleNamespace(), [], ("one.so", "two.so"))
        self.assertEqual(orders.untrue([]), [])
        orders.guests["guest-1"].learn("deploy", 0, answer("done"))
        self.assertEqual(len(orders.untrue([])), 1)
        self.assertIn("guest-1 is absent", orders.untrue([])[0])
        self.assertEqual(orders.untrue([{"name": "guest-1", "state": "active"}]), [])
        self.assertIn("guest-1 is failed (why)", orders.untrue([{"name": "guest-1", "state": "failed", "reason": "why"}])[0])
        self.assertIn("guest-2 is active", orders.untrue([{"name": "guest-1", "state": "active"},
                                                          {"name": "guest-2", "state": "active"}])[0])

    def test_a_guest_that_is_there_and_was_not_found_is_an_untrue_answer(self):
        printed = f"iotcloud: {NOT_THERE} by these options"
        guest().learn("stop", 1, None, printed)
        guest(("deploy", "unknown")).learn("stop", 1, None, printed)
        with self.assertRaisesRegex(UntrueAnswer, "iotcloud stop --name guest-1 found no such instance; it is active"):
            guest(("deploy", "done")).learn("stop", 1, None, printed)

    def test_a_wiped_registry_makes_every_state_possible_and_the_order_under_way_void(self):
        orders = Orders(SimpleNamespace(), [], ("one.so", "two.so"))
        asked, idle = orders.guests["guest-1"], orders.guests["guest-2"]
        asked.under_way = ("deploy",)
        orders.registry_wiped()
        asked.learn("deploy", 0, answer("done"))
        idle.learn("deploy", 0, answer("done"))
        self.assertEqual(asked.possible, {ABSENT, ACTIVE, INACTIVE, FAILED})
        self.assertEqual(idle.possible, {ACTIVE})


def gateways(*states, frozen=""):
    """What the command line lists."""
    return json.dumps([{"gateway": f"gateway-{number}", "state": state, "frozen": frozen}
                       for number, state in enumerate(states, 1)])


class PersonTest(unittest.TestCase):
    def setUp(self):
        self.person = Person(SimpleNamespace(out=Path("/nowhere")), lambda text: None)

    def learn(self, status, printed=""):
        """The next command ends so; returns its first two words."""
        words = self.person.to_do[0]
        self.person.learn(words, status, printed)
        return words[:2]

    def test_imports_and_adopts_until_all_gateways_are_ready(self):
        self.assertTrue(self.person.idle)
        self.person.put_right()
        self.assertEqual(self.learn(1, "no master"), ("registry", "import"))
        self.assertEqual(self.learn(0), ("registry", "import"))
        self.assertEqual(self.learn(0), ("registry", "adopt"))
        for left in (gateways(), gateways("lost"), gateways("ready"), gateways("ready", "ready", frozen="wiped")):
            self.assertEqual(self.learn(0, left), ("gateways", "-o"), left)
            self.assertEqual(self.learn(0), ("registry", "adopt"))
        self.learn(0, gateways("ready", "ready"))
        self.assertTrue(self.person.idle)

    def test_begins_again_when_the_registry_is_wiped_once_more(self):
        self.person.put_right()
        self.learn(0)
        self.person.put_right()
        self.person.learn(("registry", "adopt", "--all"), 0, "")  # of the time before
        self.assertEqual(self.learn(0), ("registry", "import"))


if __name__ == "__main__":
    unittest.main()

#!/usr/bin/python3
"""What is known of a guest after the command line has answered, and answers that are not true."""
import json
import tempfile
import time
import unittest
from pathlib import Path
from types import SimpleNamespace

import schedule
from orders import ABSENT, ACTIVE, FAILED, INACTIVE, NOT_THERE, Guest, Orders, Person, UntrueAnswer


def answer(outcome, reason=""):
    return {"outcomes": [{"instance": "1", "outcome": outcome, "reason": reason}]}


def listed(name, state, plugin="one.so", **more):
    return {"name": name, "state": state, "plugin": {"file": plugin}, **more}


def guest(*answers):
    made = Guest("guest-1", "gateway-1", ("one.so", "two.so"))
    for kind, outcome in answers:
        order(made, kind, answer(outcome) if outcome else None)
    return made


def order(made, kind, said):
    """An order to a guest, and the command line's answer with the status that goes with it."""
    made.words(SimpleNamespace(books="", shared="false"), kind)
    done = said and all(each["outcome"] == "done" for each in said["outcomes"])
    return made.learn(kind, 0 if done else 1, said)


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
        order(orders.guests["guest-1"], "deploy", answer("done"))
        self.assertEqual(len(orders.untrue([])), 1)
        self.assertIn("guest-1 is absent", orders.untrue([])[0])
        self.assertEqual(orders.untrue([listed("guest-1", "active")]), [])
        self.assertIn("guest-1 is failed (why)", orders.untrue([listed("guest-1", "failed", reason="why")])[0])
        self.assertIn("guest-2 is active", orders.untrue([listed("guest-1", "active"), listed("guest-2", "active")])[0])

    def test_an_update_leaves_the_plugin_that_its_answer_says(self):
        deployed = [("deploy", "done")]
        self.assertEqual(guest(*deployed).runs, {"one.so"})
        self.assertEqual(guest(*deployed, ("update", "done")).runs, {"two.so"})
        self.assertEqual(guest(*deployed, ("update", "done"), ("update", "done")).runs, {"one.so"})
        for said in ("unknown", "failed", None):
            self.assertEqual(guest(*deployed, ("update", said)).runs, {"one.so", "two.so"}, said)
        undone = guest(*deployed)
        order(undone, "update", answer("failed", "back on one.so: it came up and did not stay so: failed"))
        self.assertEqual(undone.runs, {"one.so"})
        self.assertEqual(guest(("deploy", "unknown"), ("update", "done"), ("undeploy", "done"), ("deploy", "done")).runs,
                         {"one.so"})

    def test_a_plugin_that_no_answer_permits_is_found(self):
        orders = Orders(SimpleNamespace(), [], ("one.so", "two.so"))
        order(orders.guests["guest-1"], "deploy", answer("done"))
        order(orders.guests["guest-1"], "update", answer("done"))
        self.assertEqual(orders.untrue([listed("guest-1", "active", "two.so")]), [])
        self.assertEqual(orders.untrue([listed("guest-1", "active", "one.so")]),
                         ["guest-1 runs one.so; after what the command line answered it runs two.so"])

    def test_an_exit_status_that_says_something_else_than_the_outcome_is_an_untrue_answer(self):
        for outcome, status in (("failed", 0), ("unknown", 0), ("done", 1)):
            with self.assertRaisesRegex(UntrueAnswer, f"ended with status {status} and says {outcome}"):
                guest(("deploy", "done")).learn("update", status, answer(outcome))

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
        order(asked, "deploy", answer("done"))
        order(idle, "deploy", answer("done"))
        self.assertEqual(asked.possible, {ABSENT, ACTIVE, INACTIVE, FAILED})
        self.assertEqual(asked.runs, {"one.so", "two.so"})
        self.assertEqual(idle.possible, {ACTIVE})


class AnAnswer(unittest.TestCase):
    def test_is_read_although_the_command_line_tells_meanwhile_what_it_waits_for(self):
        with tempfile.TemporaryDirectory() as folder:
            script = Path(folder) / "iotcloud"
            script.write_text("echo 'iotcloud: waits: it is starting' >&2\n"
                              f"echo '{json.dumps(answer('done'))}'\n")
            cluster = SimpleNamespace(out=Path(folder), books=folder, shared="false",
                                      command=lambda *words: ["/bin/sh", script])
            told = []
            orders = Orders(cluster, [schedule.Action(0.0, "deploy", "guest-1")], ("one.so", "two.so"), told.append)
            orders.start()
            deadline = time.monotonic() + 60
            while not orders.over and time.monotonic() < deadline:
                orders.step()
                time.sleep(0.01)
            self.assertEqual(orders.violations, [])
            self.assertEqual(orders.guests["guest-1"].possible, {ACTIVE})
            self.assertIn("iotcloud deploy guest-1: done", told[0])


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

#!/usr/bin/python3
"""The judgement over the books: whatever is wrong with them is found, and what a channel permits is not."""
import tempfile
import unittest
from pathlib import Path

import ledger
from ledger import BLOCKED, SPOOLED, Account, Copy, Run, check

ID = "0123456789abcdef0123456789abcdef"


def run(name="1.1", begin=0.0, count=5, end=None):
    """Accepts a message each second."""
    sent = [begin + number for number in range(1, count + 1)]
    return Run(name, begin, end, sent, end if end is not None else begin + count)


def copies(*numbers, name="1.1", begin=0.0, marked=False):
    """Each half a second after it was accepted."""
    return [Copy(name, number, begin + number + 0.5, marked) for number in numbers]


def account(kind, runs, came, read=None, heard=None):
    return Account(ID, kind, runs, came, read, heard)


class LedgerTest(unittest.TestCase):
    def assert_wrong(self, found, *texts):
        self.assertEqual(len(found), len(texts), found)
        for one, text in zip(found, texts):
            self.assertIn(text, one)

    def test_all_that_was_accepted_came(self):
        for kind in (SPOOLED, BLOCKED):
            self.assertEqual(check([account(kind, [run()], copies(1, 2, 3, 4, 5), copies(1, 2, 3, 4, 5))]), [])

    def test_a_lost_message_is_found_wherever_it_is(self):
        for kind in (SPOOLED, BLOCKED):
            for lost in range(1, 6):
                came = copies(*(number for number in range(1, 6) if number != lost))
                self.assert_wrong(check([account(kind, [run()], came)]),
                                  f"1 of 5 accepted messages of run 1.1 never came: {lost};")
                self.assert_wrong(check([account(kind, [run()], copies(1, 2, 3, 4, 5), came)]), "the second reader: 1 of 5")

    def test_a_reader_is_silent_until_a_message_comes_that_was_accepted_later(self):
        one = account(SPOOLED, [run()], copies(1, 2, 3, 4, 5), copies(1, 2, 3))
        self.assertEqual(ledger.silent([one], 2.5), [])
        self.assert_wrong(ledger.silent([one], 3.0), "the second reader: no new message came")
        self.assertEqual(len(ledger.silent([one], 5.0)), 2)

    def test_who_sends_is_listed_as_active_and_nobody_else(self):
        since, before, now = {"a": 1, "gone": 9}, {"a": 5, "gone": 9, "new": 0}, {"a": 5, "gone": 9, "new": 2}
        self.assertEqual(ledger.otherwise_than_listed(["a", "new"], since, before, now), [])
        self.assertEqual(ledger.otherwise_than_listed(["a"], since, before, now),
                         ["new is not listed as active, and sends: 2 messages"])
        self.assertEqual(ledger.otherwise_than_listed(["a", "new", "gone", "other"], since, before, now),
                         ["gone is listed as active, and sends nothing", "other is listed as active, and sends nothing"])

    def test_what_was_accepted_is_counted_without_the_begins_and_ends_of_runs(self):
        with tempfile.TemporaryDirectory() as folder:
            Path(folder, "a.sent").write_text("run 7.1 1.0\nsent 7.1 1 1.5\nsent 7.1 2 2.5\nend 7.1 3.0\nrun 8.1 4.0\n")
            Path(folder, "b.sent").write_text("run 7.1 1.0\n")
            Path(folder, "b.came").write_text("7.1 1 99 0 1.6\n")
            self.assertEqual(ledger.accepted(folder), {"a": 2, "b": 0})

    def test_a_ledger_without_any_message_that_came_is_wrong(self):
        self.assert_wrong(check([account(SPOOLED, [run()], [])]), "5 of 5 accepted messages")

    def test_the_end_of_a_killed_run_may_be_lost_on_a_blocked_channel_only(self):
        runs = [run(), run("2.1", 10)]
        came = copies(1, 2, 3) + copies(1, 2, 3, 4, 5, name="2.1", begin=10)
        self.assertEqual(check([account(BLOCKED, runs, came)]), [])
        self.assert_wrong(check([account(SPOOLED, runs, came)]), "2 of 5 accepted messages of run 1.1 never came: 4-5")

    def test_what_a_run_of_a_blocked_channel_had_sent_may_come_among_messages_of_the_next(self):
        runs = [run(), run("2.1", 10)]
        among = copies(1, 2, 3) + copies(1, name="2.1", begin=10) + copies(4, 5) + copies(2, 3, 4, 5, name="2.1", begin=10)
        self.assertEqual(check([account(BLOCKED, runs, among)]), [])
        self.assert_wrong(check([account(SPOOLED, runs, among)]), "2 messages were overtaken: number 4 of run 1.1")
        runs[0].end = 6
        self.assertEqual(check([account(BLOCKED, runs, among)]), [])
        swapped = copies(1, 2, 3) + copies(1, name="2.1", begin=10) + copies(5, 4) + copies(2, 3, 4, 5, name="2.1", begin=10)
        self.assert_wrong(check([account(BLOCKED, [run(), run("2.1", 10)], swapped)]), "1 messages were overtaken: number 4")

    def test_the_middle_of_a_killed_run_may_not_be_lost(self):
        runs = [run(), run("2.1", 10)]
        came = copies(1, 2, 4) + copies(1, 2, 3, 4, 5, name="2.1", begin=10)
        self.assert_wrong(check([account(BLOCKED, runs, came)]), "1 of 5 accepted messages of run 1.1 never came: 3;")

    def test_the_run_that_still_lives_may_lose_nothing_and_one_that_was_closed_its_end(self):
        self.assert_wrong(check([account(BLOCKED, [run()], copies(1, 2, 3, 4))]), "never came: 5")
        self.assertEqual(check([account(BLOCKED, [run(end=6.0)], copies(1, 2, 3, 4))]), [])
        self.assert_wrong(check([account(SPOOLED, [run(end=6.0)], copies(1, 2, 3, 4))]), "never came: 5")

    def test_the_end_of_the_last_run_may_be_lost_if_its_process_was_killed_and_nobody_started_it_again(self):
        for kind, numbers, living, lost in ((BLOCKED, (1, 2, 3), {"2"}, 0), (BLOCKED, (), {"2"}, 0),
                                            (BLOCKED, (1, 2, 3), {"1", "2"}, 1), (BLOCKED, (1, 3, 4, 5), {"2"}, 1),
                                            (SPOOLED, (1, 2, 3), {"2"}, 1)):
            one = account(kind, [run()], copies(*numbers))
            ledger.mark_killed([one], living)
            self.assertEqual(len(ledger.missing(one, one.came, ())), lost, (kind, numbers, living))

    def test_a_broker_that_lost_its_data_excuses_what_nobody_had_read(self):
        one = account(SPOOLED, [run()], copies(1, 2, 5))
        self.assert_wrong(check([one]), "never came: 3-4")
        self.assertEqual(check([one], emptied=[4.4]), [])
        self.assert_wrong(check([account(SPOOLED, [run()], copies(1, 3, 4, 5))], emptied=[3.8]),
                          "never came: 2")  # 3 had come by then, so 2 was lost before

    def test_a_broker_that_lost_its_data_has_the_queue_of_a_reader_only_when_that_is_back(self):
        for which in range(2):
            def reader(*numbers):
                books = [copies(1, 2, 3, 4, 5), copies(1, 2, 3, 4, 5)]
                books[which] = copies(*numbers)
                return account(SPOOLED, [run()], *books)

            self.assertEqual(check([reader(1, 5)], emptied=[2.2]), [])
            self.assert_wrong(check([reader(1, 3, 5)], emptied=[2.2]), "1 of 5")  # it was back for 3
            self.assert_wrong(check([reader(1, 2)], emptied=[2.2]), "3 of 5")  # it never came back

    def test_a_broker_that_lost_its_data_between_runs(self):
        runs = [run(), run("2.1", 10)]
        later = copies(2, 3, 4, 5, name="2.1", begin=10)
        self.assertEqual(check([account(SPOOLED, runs, copies(1, 2, 3) + later)], emptied=[11.2]), [])
        self.assertEqual(check([account(SPOOLED, runs, copies(1, 2, 3) + later)], emptied=[9.0]), [])
        back = copies(1, name="2.1", begin=10) + copies(3, 4, 5, name="2.1", begin=10)
        self.assert_wrong(check([account(SPOOLED, runs, copies(1, 2, 3) + back)], emptied=[9.0]), "of run 2.1 never came: 2;")

    def test_messages_that_overtake_are_found(self):
        self.assert_wrong(check([account(SPOOLED, [run()], copies(1, 3, 2, 4, 5))]), "1 messages were overtaken: number 2")
        runs = [run(), run("2.1", 10)]
        late = copies(1, 2, 3, 4) + copies(1, name="2.1", begin=10) + copies(5) + copies(2, 3, 4, 5, name="2.1", begin=10)
        self.assert_wrong(check([account(SPOOLED, runs, late)]), "number 5 of run 1.1")

    def test_copies_may_come_again_in_any_order_when_they_are_marked(self):
        again = copies(1, 2, 3) + copies(2, 3, marked=True) + copies(4, 5) + copies(1, marked=True)
        self.assertEqual(check([account(SPOOLED, [run()], again, again)]), [])
        self.assertEqual(ledger.duplicates(again), 3)
        # The marked copy may be the first: the other one stood in the way of a reader that was frozen.
        first = copies(1, marked=True) + copies(1, 2, 3, 4, 5)
        self.assertEqual(check([account(SPOOLED, [run()], copies(1, 2, 3, 4, 5), first)]), [])

    def test_a_copy_without_the_mark_is_found(self):
        again, once = copies(1, 2, 3, 2, 4, 5), copies(1, 2, 3, 4, 5)
        for came, read, reader in ((once, again, "the second reader"), (again, once, "the topology")):
            self.assert_wrong(check([account(SPOOLED, [run()], came, read)]),
                              f"{reader}: 1 messages came twice without the mark `redelivered`: number 2")

    def test_two_of_one_instance_at_the_same_time_are_found(self):
        runs = [run(), run("2.1", 4.5)]
        came = copies(1, 2, 3, 4, 5) + copies(1, 2, 3, 4, 5, name="2.1", begin=4.5)
        self.assert_wrong(check([account(SPOOLED, runs, came)]), "run 1.1 went on for 0.50 s after run 2.1 had begun")

    def test_messages_that_nobody_sent_are_found(self):
        self.assertEqual(check([account(SPOOLED, [run()], copies(1, 2, 3, 4, 5, 6))]), [])  # killed before it was written
        self.assert_wrong(check([account(SPOOLED, [run()], copies(1, 2, 3, 4, 5, 7))]), "1 messages came that were never sent")
        self.assert_wrong(check([account(SPOOLED, [run()], copies(1, 2, 3, 4, 5) + copies(1, name="9.9"))]),
                          "never sent, such as number 1 of run 9.9", "1 messages were overtaken")

    def test_the_books_are_read(self):
        with tempfile.TemporaryDirectory() as folder:
            Path(folder, f"{ID}.sent").write_text("run 7.1 1.0\nsent 7.1 1 1.5\nsent 7.1 2 2.5\nend 7.1 3.0\nrun 8.1 4.0\n"
                                                  "sent 8.1 1 4.5\nsent 8.1 2 5")  # the last line is not whole
            Path(folder, f"{ID}.came").write_text("7.1 1 99 0 1.6\n7.1 2 99 0 2.6\n7.1 2 98 1 2.7\n8.1 1 99 0 4.6\n")
            Path(folder, f"{ID}.heard").write_text("7.1 1 7.1 1.7\n7.1 2 8.1 2.7\n8.1 1 8.1 4.7\n")
            Path(folder, f"{ID}.read").write_text("7.1 1 0 1.6\n7.1 1 1 1.7\n7.1 2 0 2.6\n8.1 1 0 4.6\n")
            one = ledger.account(folder, ID, SPOOLED, True)
            self.assertEqual([(each.name, each.sent, each.end) for each in one.runs],
                             [("7.1", [1.5, 2.5], 3.0), ("8.1", [4.5], None)])
            self.assertEqual([copy.marked for copy in one.read], [False, True, False, False])
            self.assertEqual([(copy.marked, copy.worker) for copy in one.came],
                             [(False, "99"), (False, "99"), (True, "98"), (False, "99")])
            self.assertEqual(check([one]), [])
            Path(folder, f"{ID}.came").write_text("7.1 1 99 0 1.6\n8.1 1 99 0 4.6\n")
            self.assert_wrong(check([ledger.account(folder, ID, SPOOLED, False)]), "1 of 2 accepted messages of run 7.1")
            Path(folder, f"{ID}.sent").write_text("run 7.1 1.0\nsent 7.1 1 1.5\nsent 7.1 3 2.5\n")
            with self.assertRaisesRegex(ValueError, "sent 7.1 3"):
                ledger.account(folder, ID, SPOOLED, False)

    def test_commands_that_were_lost_overtaken_or_never_sent_are_found(self):
        def heard(*numbers):
            return account(BLOCKED, [run(end=9.0)], copies(1, 2, 3) + copies(2, marked=True),
                           heard=copies(*numbers, begin=0.2))

        self.assertEqual(check([heard(1, 2, 3)]), [])
        self.assertEqual(check([heard(1, 2, 1, 3, 2)]), [])  # they may come twice
        self.assert_wrong(check([heard(1, 2)]), "commands: 1 of 3 commands never came: 3;")
        self.assert_wrong(check([heard()]), "commands: 3 of 3 commands")
        self.assert_wrong(check([heard(1, 3, 2)]), "commands: 1 messages were overtaken")
        self.assert_wrong(check([heard(1, 2, 3, 4)]), "commands: 1 messages came that were never sent")

    def test_commands_of_two_workers_may_come_among_each_other(self):
        came = [Copy("1.1", number, number + 0.5, worker=worker) for number, worker in
                ((1, "a"), (2, "a"), (3, "a"), (4, "b"), (5, "b"))]
        among = account(SPOOLED, [run()], came, heard=copies(1, 4, 2, 5, 3, begin=0.2))
        self.assertEqual(check([among]), [])
        swapped = account(SPOOLED, [run()], came, heard=copies(1, 4, 3, 5, 2, begin=0.2))
        self.assert_wrong(check([swapped]), "commands: 1 messages were overtaken")

    def test_a_broker_that_lost_its_data_excuses_commands_that_no_driver_had(self):
        one = account(SPOOLED, [run()], copies(1, 2, 3, 4, 5), heard=copies(1, 2, 5, begin=0.2))
        self.assert_wrong(check([one]), "2 of 5 commands never came: 3-4")
        self.assertEqual(check([one], emptied=[4.4]), [])

    def killed_with_the_broker(self, kind=BLOCKED, came=(), heard=(), outages=((5.6, 9.0),), lives=False):
        """The judgement over an instance whose run accepted 5 messages, of which the topology had all before the broker was
        killed; after that it had `came`. The broker had stored the first 4. The driver heard the commands 1 to 4, and
        `heard`. Unless it lives, the run was killed before it reached the broker again, and the next one sent a message."""
        runs = [run(count=5)] + ([] if lives else [run("2.1", 20, 1)])
        later = [] if lives else copies(1, name="2.1", begin=20)
        one = account(kind, runs, copies(1, 2, 3, 4, 5) + copies(4, *came, begin=10, marked=True) + later,
                      heard=copies(1, 2, 3, 4, begin=0.2) + copies(4, *heard, begin=10.2) + later)
        return ledger.check([one], outages=outages)

    def test_a_command_may_be_lost_with_its_message_that_a_killed_broker_had_not_stored_and_whose_sender_was_killed_too(self):
        self.assertEqual(self.killed_with_the_broker(), [])
        self.assertEqual(self.killed_with_the_broker(outages=[(5.4, 9.0)]), [])  # it was on its way when the broker was killed

    def test_a_command_may_not_be_lost_whose_message_comes_again_or_was_stored(self):
        lost = "commands: 1 of 6 commands never came: 5;"
        self.assert_wrong(self.killed_with_the_broker(outages=()), lost)
        self.assert_wrong(self.killed_with_the_broker(came=[5]), lost)
        self.assert_wrong(self.killed_with_the_broker(kind=SPOOLED), lost)
        self.assert_wrong(self.killed_with_the_broker(outages=[(5.6 + ledger.UNSTORED_S, 20.0)]), lost)
        self.assert_wrong(self.killed_with_the_broker(outages=[(5.2, 5.4)]), lost)  # it came after that
        self.assert_wrong(self.killed_with_the_broker(lives=True), "commands: 1 of 5 commands never came: 5;")

    def test_a_command_may_not_be_lost_behind_which_another_one_of_its_run_came(self):
        one = account(BLOCKED, [run(), run("2.1", 20, 0)], copies(1, 2, 3, 4, 5), heard=copies(1, 2, 3, 5, begin=0.2))
        self.assert_wrong(ledger.check([one], outages=[(5.6, 9.0)]), "commands: 1 of 5 commands never came: 4;")

    def test_numbers_are_told_shortly(self):
        self.assertEqual(ledger.ranges([1, 2, 3, 7, 9, 10]), "1-3, 7, 9-10")
        self.assertEqual(ledger.ranges(range(1, 20, 2)), "1, 3, 5, 7, 9 and 5 more")


if __name__ == "__main__":
    unittest.main()

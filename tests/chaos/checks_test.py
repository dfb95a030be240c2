#!/usr/bin/python3
"""Drops that the metrics count and the books do not have, or the other way round."""
import sys
import tempfile
import unittest
from pathlib import Path
from types import SimpleNamespace

sys.path.insert(0, str(Path(__file__).resolve().parent))

import checks  # noqa: E402
import ledger  # noqa: E402
import schedule  # noqa: E402

OUTCOMES = "iotcloud_driver_messages_total"


def outcome(channel, what, count, reason=""):
    why = f',reason="{reason}"' if reason else ""
    return (f'{OUTCOMES}{{channel="{channel}",driver="ledger",host="ledger",outcome="{what}"{why}}}', float(count))


def account(instance, kind, sent, came, stays=True, process="7"):
    """One run of a living process that accepted so many messages, of which those with these numbers came."""
    run = ledger.Run(f"{process}.1", 0.0, sent=[float(number) for number in range(1, sent + 1)])
    copies = [ledger.Copy(run.name, number, 100.0 + number) for number in came]
    return ledger.Account(instance, kind, [run], copies, None, [] if stays else None)


class OneGateway(unittest.TestCase):
    def wrong(self, page, accounts, there=("a", "b"), emptied=()):
        return checks.miscounted("gateway-1", checks.counters(page), {"7"}, accounts, set(there), emptied)

    def test_agrees_with_the_books(self):
        accounts = [account("a", ledger.BLOCKED, 10, range(1, 11)), account("b", ledger.SPOOLED, 5, range(1, 6)),
                    account("c", ledger.BLOCKED, 99, [], process="8")]  # of a process that is gone
        page = [outcome("blocked", "confirmed", 10), outcome("blocked", "would_block", 3), outcome("spooled", "confirmed", 5),
                outcome("spooled", "unknown", 2, "spooled"), ('process_cpu_seconds_total', 1.0)]
        self.assertEqual(self.wrong(page, accounts), [])

    def test_counts_each_message_once(self):
        accounts = [account("a", ledger.BLOCKED, 10, range(1, 11))]
        self.assertIn("accepted 10", self.wrong([outcome("blocked", "confirmed", 9)], accounts)[0])

    def test_counts_what_never_came(self):
        accounts = [account("a", ledger.BLOCKED, 10, range(1, 9))]
        told = [outcome("blocked", "confirmed", 8), outcome("blocked", "unknown", 2, "closed")]
        self.assertEqual(self.wrong(told, accounts), [])
        untold = [outcome("blocked", "confirmed", 9), outcome("blocked", "unknown", 1, "closed")]
        self.assertEqual(self.wrong(untold, accounts),
                         ["2 messages of gateway-1's blocked channels never came, and its hosts count {'unknown closed': 1} as "
                          "not confirmed"])
        self.assertEqual(self.wrong(untold, accounts, there=()), [], "nobody reads an instance that is gone")
        self.assertEqual(self.wrong(untold, accounts, emptied=[50.0]), [], "the broker lost its data")

    def test_what_is_counted_as_dropped_never_came(self):
        accounts = [account("a", ledger.BLOCKED, 10, range(1, 11))]
        page = [outcome("blocked", "confirmed", 9), outcome("blocked", "refused", 1, "403")]
        self.assertEqual(self.wrong(page, accounts),
                         ["gateway-1's hosts count 1 messages of blocked channels as refused or dropped ({'refused 403': 1}), "
                          "and 0 never came"])

    def test_nothing_is_dropped_of_a_spool(self):
        accounts = [account("b", ledger.SPOOLED, 5, range(1, 6))]
        self.assertEqual(self.wrong([outcome("spooled", "dropped", 2, "spool_full")], accounts),
                         ["gateway-1's hosts count 2 messages of spooled channels as dropped: spool_full"])


class Commands(unittest.TestCase):
    def setUp(self):
        holder = tempfile.TemporaryDirectory()
        self.addCleanup(holder.cleanup)
        self.books = Path(holder.name)
        self.guest = account("g", ledger.BLOCKED, 4, range(1, 5), stays=False)
        (self.books / "g.heard").write_text("7.1 1 7.1 5.0\n7.1 1 7.1 5.5\n7.1 2 7.1 6.0\n")

    def wrong(self, *metrics):
        return checks.dropped_commands({"worker-1": list(metrics)}, [self.guest], self.books)

    def test_are_dropped_for_guests_only(self):
        unknown = 'iotcloud_bolt_unknown_driver_total{component="command",topology="chaos"}'
        self.assertEqual(self.wrong((unknown, 2.0)), [])
        self.assertEqual(self.wrong((unknown, 3.0)),
                         ["workers dropped 3 commands for drivers that are not there; guests lack 2"])
        lost = 'iotcloud_driver_lost_total{channel="command",driver="ledger",reason="no_instance"}'
        self.assertEqual(self.wrong((lost, 4.0)), [])
        self.assertIn("driver hosts dropped 5", self.wrong((lost, 5.0))[0])

    def test_are_dropped_for_no_other_reason(self):
        lost = 'iotcloud_bolt_lost_total{component="command",reason="%s",topology="chaos"}'
        self.assertEqual(self.wrong((lost % "fenced", 3.0), (lost % "deadline", 0.0)), [])
        self.assertEqual(self.wrong((lost % "deadline", 3.0)),
                         ['worker-1 dropped 3 messages of command for the reason "deadline", which nothing here has'])


class Drops(unittest.TestCase):
    def test_are_told_by_reason_and_those_of_all_daemons_together(self):
        pages = {"gateway-1": [outcome("blocked", "confirmed", 9), outcome("blocked", "unknown", 2, "closed")],
                 "gateway-2": [outcome("blocked", "unknown", 1, "closed"), outcome("blocked", "refused", 0, "403")],
                 "worker-1": [('iotcloud_bolt_unknown_driver_total{component="command"}', 4.0)]}
        self.assertEqual(checks.drops(pages), {"blocked unknown closed": 3, "command unknown driver": 4})

    def test_are_looked_at_until_they_agree(self):
        pages = iter([[outcome("blocked", "confirmed", 9)], [outcome("blocked", "confirmed", 10)]])
        first = schedule.GATEWAYS[0]
        cluster = SimpleNamespace(page=lambda name: next(pages) if name == first else [],
                                  hosts=lambda gateway: [7] if gateway == first else [], pause=lambda seconds: None,
                                  emptied=[], books=Path("/nowhere"))
        accounts = [account("a", ledger.BLOCKED, 10, range(1, 11))]
        self.assertEqual(checks.uncounted(cluster, accounts, {"a"}, 60), ({}, []))


if __name__ == "__main__":
    unittest.main()

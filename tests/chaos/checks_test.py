#!/usr/bin/python3
"""Each check finds what is wrong in a world that is made up for it, and nothing in one where all is well."""
import contextlib
import signal
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

sys.path.insert(0, str(Path(__file__).resolve().parent))

import checks  # noqa: E402
import ledger  # noqa: E402
import schedule  # noqa: E402
from private_cluster import StartError  # noqa: E402

OUTCOMES = "iotcloud_driver_messages_total"


def outcome(channel, what, count, reason=""):
    why = f',reason="{reason}"' if reason else ""
    return (f'{OUTCOMES}{{channel="{channel}",driver="ledger",host="ledger",outcome="{what}"{why}}}', float(count))


def account(instance, kind, sent, came, stays=True, process="7"):
    """One run of a living process that accepted so many messages, of which those with these numbers came."""
    run = ledger.Run(f"{process}.1", 0.0, sent=[float(number) for number in range(1, sent + 1)])
    copies = [ledger.Copy(run.name, number, 100.0 + number) for number in came]
    return ledger.Account(instance, kind, [run], copies, None, [] if stays else None)


class Converged(unittest.TestCase):
    """A cluster in which all is well, until a test changes it."""

    def setUp(self):
        self.gateways = [{"gateway": name, "state": "ready", "frozen": False} for name in schedule.GATEWAYS]
        self.topologies = [{"workers": list(schedule.WORKERS)}]
        self.drivers = [{"instance": "stays-1", "name": "ledger", "state": "active"},
                        {"instance": "guest-a", "name": "guest-1", "state": "inactive"}]
        self.untrue = []

    def why(self):
        answers = {"gateways": self.gateways, "topologies": self.topologies, "drivers": self.drivers}
        orders = SimpleNamespace(untrue=lambda drivers: self.untrue, guests={"guest-1": None})
        return checks.not_converged(SimpleNamespace(json=answers.__getitem__), ["stays-1"], orders)

    def test_is_a_cluster_in_which_all_is_well(self):
        self.assertEqual(self.why(), [])

    def test_is_none_whose_gateway_is_lost_frozen_or_not_listed(self):
        first = schedule.GATEWAYS[0]
        for changed in ({"state": "lost"}, {"frozen": True}, {"gateway": "another"}):
            self.setUp()
            self.gateways[0].update(changed)
            self.assertEqual(self.why(), [f"not ready, or frozen: {first}"], changed)

    def test_is_none_whose_topology_lacks_a_worker(self):
        self.topologies[0]["workers"].pop()
        self.assertEqual(self.why(), [f"the topology has {len(schedule.WORKERS) - 1} workers"])
        self.topologies.clear()
        self.assertEqual(self.why(), ["the topology has 0 workers"])

    def test_is_none_whose_instance_is_not_active_or_gone(self):
        self.drivers[0]["state"] = "failed"
        self.assertEqual(self.why(), ["stays-1 is failed"])
        del self.drivers[0]
        self.assertEqual(self.why(), ["stays-1 is not there"])

    def test_is_none_with_an_instance_that_is_listed_twice(self):
        for driver in list(self.drivers):
            self.setUp()
            self.drivers.append(dict(driver))
            self.assertEqual(self.why(), [f"{driver['instance'][:8]} is listed 2 times"])

    def test_is_none_that_is_not_as_the_command_line_answered(self):
        self.untrue = ["guest-1 is active; after what the command line answered it is inactive"]
        self.assertEqual(self.why(), self.untrue)

    def test_is_none_with_an_instance_that_nobody_deployed(self):
        self.drivers.append({"instance": "stranger", "name": "guest-9", "state": "active"})
        self.assertEqual(self.why(), ["there is an instance that nobody deployed: stranger"])

    def test_is_none_that_does_not_answer(self):
        def silent(_what):
            raise StartError("no master answers")
        orders = SimpleNamespace(untrue=lambda drivers: [], guests={})
        self.assertEqual(checks.not_converged(SimpleNamespace(json=silent), [], orders), ["no master answers"])


class Grown(unittest.TestCase):
    BEFORE = {"master-1": {"descriptors": 30, "threads": 9, checks.CLIENTS: 0, "memory MB": 20.0},
              "worker-1": {"descriptors": 30, "threads": 9, checks.CLIENTS: 2, "memory MB": 100.0}}

    def grown(self, daemon, **figures):
        after = {name: dict(values) for name, values in self.BEFORE.items()}
        after[daemon].update({name.replace("_", " "): value for name, value in figures.items()})
        return checks.grown(self.BEFORE, after)

    def test_is_not_what_has_as_much_as_before_or_a_little_more(self):
        self.assertEqual(self.grown("master-1"), [])
        self.assertEqual(self.grown("master-1", descriptors=30 + checks.MORE["descriptors"],
                                    threads=9 + checks.MORE["threads"], memory_MB=20 + checks.GROWTH_MB), [])
        self.assertEqual(self.grown("worker-1", memory_MB=200.0), [], "a large one may become twice as large")

    def test_is_what_has_more_descriptors_threads_or_memory(self):
        self.assertEqual(self.grown("master-1", descriptors=31 + checks.MORE["descriptors"]),
                         ["master-1 has 47 descriptors, before the faults it had 30"])
        self.assertEqual(self.grown("worker-1", threads=10 + checks.MORE["threads"]),
                         ["worker-1 has 18 threads, before the faults it had 9"])
        self.assertEqual(self.grown("master-1", memory_MB=21.0 + checks.GROWTH_MB),
                         ["master-1 has 61 memory MB, before the faults it had 20"])
        self.assertEqual(self.grown("worker-1", memory_MB=201.0), ["worker-1 has 201 memory MB, before the faults it had 100"])

    def test_is_not_what_the_clients_of_partitions_that_moved_here_need(self):
        allowed = 9 + checks.MORE["threads"] + 3 * checks.OF_A_CLIENT["threads"]
        self.assertEqual(self.grown("worker-1", librdkafka_clients=5, threads=allowed), [])
        self.assertEqual(self.grown("worker-1", librdkafka_clients=5, threads=allowed + 1),
                         ["worker-1 has 30 threads, before the faults it had 9"])
        self.assertEqual(self.grown("worker-1", librdkafka_clients=6),
                         ["worker-1 has 6 librdkafka clients, before the faults it had 2"])

    def test_is_not_what_is_known_of_one_side_only(self):
        self.assertEqual(checks.grown({"master-1": None}, self.BEFORE), [])
        self.assertEqual(checks.grown(self.BEFORE, {"master-1": None}), [])

    def in_the_end(self, *threads):
        """`threads`: of worker-1, at each look; the last one from then on. A look is made each half second."""
        now, looks = [0.0], list(threads)

        def figures(_cluster):
            return {"worker-1": {**self.BEFORE["worker-1"], "threads": looks.pop(0) if len(looks) > 1 else looks[0]}}

        def pause(seconds):
            now[0] += seconds

        with mock.patch.object(checks, "all_figures", figures), mock.patch.object(checks.time, "monotonic", lambda: now[0]):
            return checks.stays_grown(SimpleNamespace(pause=pause), self.BEFORE, 60)

    def test_is_not_what_ends_in_time(self):
        self.assertEqual(self.in_the_end(40, 40, 30, 9), [])

    def test_is_what_stays(self):
        self.assertEqual(self.in_the_end(40, 30, 21), ["worker-1 has 21 threads, before the faults it had 9"])

    def test_is_judged_by_what_the_kernel_says(self):
        with tempfile.TemporaryDirectory() as folder, mock.patch.object(checks, "PROC", Path(folder)):
            for part in ("7/fd/0", "7/fd/1", "7/fd/2", "7/task/7"):
                Path(folder, part).mkdir(parents=True)
            Path(folder, "7/task/7/comm").write_text("rdk:main\n")
            Path(folder, "7/status").write_text("Name:\tx\nVmRSS:\t 9999 kB\nRssAnon:\t 2048 kB\n")
            self.assertEqual(checks.figures(7), {"descriptors": 3, "threads": 1, checks.CLIENTS: 1, "memory MB": 2.0})
            self.assertIsNone(checks.figures(8), "there is no such process")


class Spinning(unittest.TestCase):
    """Processes whose use of the processor, and the clock, a test sets."""

    def setUp(self):
        holder = tempfile.TemporaryDirectory()
        self.addCleanup(holder.cleanup)
        self.proc, self.now, self.looks = Path(holder.name), 0.0, 0
        self.commands, self.share, self.ticks = {}, {}, {}
        self.cluster = SimpleNamespace(out="/run", pause=self.pause)

    def process(self, pid, command, share):
        """`share`: of a processor, in each look; the last one from then on."""
        self.commands[pid], self.share[pid], self.ticks[pid] = command, share, 5000.0

    def pause(self, seconds):
        self.now += seconds
        for pid, share in self.share.items():
            self.ticks[pid] += 100 * seconds * share[min(self.looks, len(share) - 1)]
        self.looks += 1

    def processes(self, _folder):
        for pid, ticks in self.ticks.items():
            (self.proc / str(pid)).mkdir(exist_ok=True)
            used = int(ticks)
            fields = ["S", *["1"] * 10, str(used // 2), str(used - used // 2), *["1"] * 30]
            (self.proc / str(pid) / "stat").write_text(f"{pid} (a (name) of two) {' '.join(fields)}\n")
        return list(self.commands.items())

    def found(self, limit=60):
        with contextlib.ExitStack() as stack:
            stack.enter_context(mock.patch.object(checks, "PROC", self.proc))
            stack.enter_context(mock.patch.object(checks, "processes", self.processes))
            stack.enter_context(mock.patch.object(checks.time, "monotonic", lambda: self.now))
            return checks.spinning(self.cluster, limit)

    def test_is_who_computes_all_the_time(self):
        self.process(7, "/bin/iotcloud-gateway --config /run/g.yaml", [1.0])
        self.process(8, "/bin/iotcloud-master --config /run/m.yaml", [0.1])
        self.assertEqual(self.found(), ["a process uses 100% of a processor without any load: "
                                        "/bin/iotcloud-gateway --config /run/g.yaml"])
        self.assertGreater(self.now, 60)

    def test_is_nobody_who_computes_for_a_moment_or_little(self):
        self.process(7, "/bin/iotcloud-gateway --config /run/g.yaml", [1.0, 1.0, 0.4])
        self.assertEqual(self.found(), [])

    def test_is_no_server(self):
        self.process(7, "/usr/bin/java -cp /run/iotcloud-x.jar kafka", [1.0])
        self.assertEqual(self.found(), [])


class LeftOver(unittest.TestCase):
    def setUp(self):
        holder = tempfile.TemporaryDirectory()
        self.addCleanup(holder.cleanup)
        self.cluster = SimpleNamespace(out=Path(holder.name))

    def child(self, folder):
        child = subprocess.Popen([sys.executable, "-c", "print(1, flush=True); input()", f"{folder}/a.yaml"],
                                 stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        self.addCleanup(child.communicate)
        self.assertEqual(child.stdout.read(1), b"1")  # so it runs, and the kernel has its arguments
        return child

    def test_is_a_process_that_does_not_end_and_is_ended_then(self):
        child = self.child(self.cluster.out)
        left = checks.left_over(self.cluster, 0)
        self.assertEqual(len(left), 1)
        self.assertTrue(left[0].startswith(f"process {child.pid} was left: {sys.executable}"), left)
        self.assertEqual(child.wait(), -signal.SIGKILL)

    def test_is_none_of_another_cluster(self):
        child = self.child(f"{self.cluster.out}-2")
        self.assertEqual(checks.left_over(self.cluster, 0), [])
        self.assertIsNone(child.poll())

    def test_is_none_that_ends_in_time(self):
        lists = iter([[(10**9, "one that ends")], []])
        with mock.patch.object(checks, "processes", lambda folder: next(lists)):
            self.assertEqual(checks.left_over(self.cluster, 60), [])


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
        away = lost.replace("no_instance", "gateway_away")
        self.assertIn("driver hosts dropped 5", self.wrong((lost, 2.0), (away, 3.0))[0])

    def test_of_a_guest_that_is_stopped_or_does_not_start_are_among_them(self):
        unknown = 'iotcloud_bolt_unknown_driver_total{component="command",topology="chaos"}'
        lost = 'iotcloud_bolt_lost_total{component="command",reason="%s",topology="chaos"}'
        self.assertEqual(self.wrong((unknown, 1.0), (lost % "not_started", 1.0)), [])
        self.assertEqual(self.wrong((unknown, 1.0), (lost % "not_started", 1.0), (lost % "inactive", 1.0)),
                         ["workers dropped 3 commands for drivers that are not there; guests lack 2"])

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

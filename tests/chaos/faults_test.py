#!/usr/bin/python3
"""Each kind of fault does to the cluster what the schedule's README says, on each of its targets, and undoes it."""
import errno
import resource
import tempfile
import unittest
from pathlib import Path
from unittest import mock

import faults
import schedule

SCRIPTS = (schedule.BROKER, schedule.ZOOKEEPER)


def setUpModule():
    """No mistake in fill() fills the disk of who runs this test: a file that becomes larger than a megabyte is an error."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, 1 << 20))


class Script:
    """Of a server, or the proxy's: writes down what it is told, and does at once what is to be done between two commands."""

    def __init__(self, name, done):
        self.name, self.done = name, done

    def say(self, *commands):
        for command in commands:
            if callable(command):
                command()
            else:
                self.done.append((self.name, command))


class Emptied(list):
    def __init__(self, done):
        super().__init__()
        self.done = done

    def append(self, moment):
        super().append(moment)
        self.done.append(("emptied",))


class Recorder:
    """A cluster that writes down what is done to it."""

    def __init__(self, folder):
        self.done = []
        self.scripts = {name: Script(name, self.done) for name in SCRIPTS}
        self.proxy = Script("proxy", self.done)
        self.emptied = Emptied(self.done)
        self.disks = {name: folder / name for name in schedule.GATEWAYS}
        for disk in self.disks.values():
            disk.mkdir()

    def __getattr__(self, name):
        if name not in ("kill", "kill_hosts", "bring_back", "freeze", "thaw", "deceive", "clear_data",
                        "broker_was_killed", "broker_is_started"):
            raise AttributeError(name)
        return lambda *words: self.done.append((name, *words))


def expected(kind, target):
    """What is done at the begin and at the end of a fault. A disk is emptied without the cluster: a test of its own."""
    server = target in SCRIPTS
    gateway = target.removeprefix("host:")
    killed = {"kill": [], "empty": [("emptied",), ("clear_data", target)], "wipe": [("clear_data", target), ("on_wiped",)]}
    if kind in killed and server:
        is_broker = target == schedule.BROKER
        return ([(target, "kill"), *([("broker_was_killed",)] if is_broker else []), *killed[kind]],
                [*([("broker_is_started",)] if is_broker else []), (target, "start"),
                 *([("on_empty",)] if kind == "wipe" else [])])
    if kind == "kill":
        return ([("kill_hosts", gateway)], []) if gateway != target else ([("kill", target)], [("bring_back", target)])
    if kind == "freeze":
        return ([(target, "pause")], [(target, "resume")]) if server else ([("freeze", target)], [("thaw", target)])
    if kind == "forbid":
        return [(target, "forbid")], [(target, "permit")]
    if kind == "full":
        return [("fill", target)], []
    deceived = {"clock_ahead": (3600, False), "clock_back": (-3600, False), "broken": (0, True)}
    if kind in deceived:
        return [("deceive", target, *deceived[kind])], [("deceive", target)]
    links = {"cut", "reset", "refuse", "half_open", "slow", "one_way_up", "one_way_down"}
    if kind in links:
        return [("proxy", f"{kind} {target}")], [] if kind == "reset" else [("proxy", f"pass {target}")]
    raise AssertionError(f"this test does not know what {kind} does")


class FaultsTest(unittest.TestCase):
    def setUp(self):
        holder = tempfile.TemporaryDirectory()
        self.addCleanup(holder.cleanup)
        self.cluster = Recorder(Path(holder.name))
        self.told = []

    def faults(self, *actions):
        done = self.cluster.done
        return faults.Faults(self.cluster, actions, self.told.append, lambda: done.append(("on_wiped",)),
                             lambda: done.append(("on_empty",)))

    def test_of_each_kind_are_done_to_each_of_its_targets_and_undone(self):
        for kind, what in schedule.FAULTS.items():
            for target in what.targets:
                with self.subTest(kind=kind, target=target):
                    action = schedule.Action(0.0, kind, target, 1.0)
                    both, done = self.faults(), self.cluster.done
                    done.clear()
                    with mock.patch.object(both, "fill", lambda gateway: done.append(("fill", gateway))):
                        both.begin(action)
                    at_first = list(done)
                    done.clear()
                    both.end(action)
                    self.assertEqual((at_first, done), expected(kind, target))

    def test_fill_the_gateways_own_disk_until_it_takes_nothing_and_empty_it(self):
        taken, real_open = [], open

        class Disk:
            """Takes so many blocks, a part of another one, and no more."""
            def __init__(self, file, _mode, buffering):
                self.file, self.left = real_open(file, "wb", buffering=buffering), 3.5

            def __enter__(self):
                return self

            def __exit__(self, *_):
                self.file.close()

            def write(self, block):
                part = block[:int(min(1, self.left) * len(block))]
                self.left -= len(part) / len(block)
                if not part:
                    raise OSError(errno.ENOSPC, "full")
                taken.append(len(part))
                return len(part)

        for gateway in schedule.GATEWAYS:
            file = self.cluster.disks[gateway] / faults.FILL
            action = schedule.Action(0.0, "full", gateway, 1.0)
            taken.clear()
            with mock.patch.object(faults, "open", Disk, create=True):
                self.faults().begin(action)
            self.assertTrue(file.exists())
            self.assertEqual(sum(taken), 3.5 * max(taken))
            self.faults().end(action)
            self.assertFalse(file.exists())

    def test_that_need_a_disk_are_left_out_without_one_and_said_to_be(self):
        self.cluster.disks.clear()
        self.faults().begin(schedule.Action(0.0, "full", "gateway-1", 1.0))
        self.faults().end(schedule.Action(0.0, "full", "gateway-1", 1.0))
        self.assertIn("gateway-1 has no disk of its own", self.told[0])

    def test_begin_and_end_in_the_order_of_their_moments(self):
        both = self.faults(schedule.Action(2.0, "kill", "master-1", 3.0), schedule.Action(1.0, "freeze", "worker-1", 2.0),
                           schedule.Action(4.0, "reset", "gateway-1>broker"))
        passed = 0.0
        both.passed = lambda: passed
        seen = []
        for passed in (0.5, 1.0, 2.5, 3.0, 4.0, 5.0):
            before = len(self.cluster.done)
            both.step()
            seen.append((passed, self.cluster.done[before:]))
        self.assertEqual(seen, [(0.5, []), (1.0, [("freeze", "worker-1")]), (2.5, [("kill", "master-1")]),
                                (3.0, [("thaw", "worker-1")]), (4.0, [("proxy", "reset gateway-1>broker")]),
                                (5.0, [("bring_back", "master-1")])])
        self.assertTrue(both.over)


if __name__ == "__main__":
    unittest.main()

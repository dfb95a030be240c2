#!/usr/bin/python3
"""What a run leaves behind, whose processes it sees, and which results count for the sources as they are."""
import contextlib
import io
import shutil
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

sys.path.insert(0, str(Path(__file__).resolve().parent))

import chaos  # noqa: E402
import checks  # noqa: E402
import cluster  # noqa: E402
import schedule  # noqa: E402


class InAFolder(unittest.TestCase):
    def setUp(self):
        holder = tempfile.TemporaryDirectory()
        self.addCleanup(holder.cleanup)
        self.folder = Path(holder.name)

    def cluster(self):
        """A cluster of which nothing runs."""
        plugins = self.folder / "build/chaos/plugins"
        plugins.mkdir(parents=True)
        (plugins / "chaos_ledger_driver.so").touch()
        return cluster.ChaosCluster(self.folder / "build", self.folder / "out")


class AnEndedCluster(InAFolder):
    def test_has_the_files_of_its_small_disks_and_their_crashes_are_found(self):
        ended = self.cluster()
        disk = ended.out / "state/gateway-1"
        (disk / "spool").mkdir(parents=True)
        (disk / "spool/mark").write_text("7")
        (disk / "driver.log").write_text("up\nterminate called after throwing an instance of 'std::bad_alloc'\n")
        ended.disks = {"gateway-1": disk}

        def uncover(folder):  # an empty folder is below the mounted one
            shutil.rmtree(folder)
            folder.mkdir()

        with mock.patch.object(cluster, "unmount", uncover):
            ended.stop()
        self.assertEqual(checks.crashed(ended), ["driver.log: terminate called after throwing an instance of 'std::bad_alloc'"])
        self.assertEqual((disk / "spool/mark").read_text(), "7")
        self.assertEqual([entry.name for entry in disk.parent.iterdir()], ["gateway-1"])


class ABroker(InAFolder):
    def test_was_away_from_when_it_was_killed_until_it_was_started_again_each_time(self):
        one = self.cluster()
        moments = iter([1.0, 2.0, 5.0])
        with mock.patch.object(cluster.time, "monotonic", lambda: next(moments)):
            one.broker_was_killed()
            one.broker_is_started()
            one.broker_was_killed()
        self.assertEqual(one.outages, [(1.0, 2.0), (5.0, float("inf"))])


class Processes(InAFolder):
    def test_of_a_run_are_not_those_of_a_run_whose_name_begins_alike(self):
        with subprocess.Popen([sys.executable, "-c", "input(1)", self.folder / "rabbitmq-70/a.yaml"], stdin=subprocess.PIPE,
                              stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as child:
            self.assertEqual(child.stdout.read(1), b"1")  # so it runs, and the kernel has its arguments
            self.assertEqual(cluster.processes(self.folder / "rabbitmq-7"), [])
            self.assertEqual([pid for pid, _ in cluster.processes(self.folder / "rabbitmq-70")], [child.pid])
            child.stdin.close()


class AViolation(InAFolder):
    """Schedules of eight faults, of which the last one shows a violation."""

    def run_chaos(self, *options):
        """Returns the lengths of the schedules that were run, and what was printed."""
        actions = [schedule.Action(float(number), "kill", target, 1.0) for number, target in
                   enumerate(2 * (*schedule.GATEWAYS, *schedule.WORKERS))]
        file = self.folder / "all.schedule"
        file.write_text(schedule.text(actions))
        lengths, printed = [], io.StringIO()

        def one(_given, _seed, part, _name):
            lengths.append(len(part))
            return SimpleNamespace(violations=["lost"] if actions[-1] in part else [], messages=0, commands=0, duplicates=0,
                                   converged_s=1.0, took_s=1.0, drops={}, left_out="")

        words = ["chaos.py", str(self.folder), "--schedule", str(file), "--results", str(self.folder / "results.tsv"),
                 "--out", str(self.folder), *options]
        with mock.patch.object(chaos, "one", one), mock.patch.object(chaos, "in_own_spaces", lambda: None), \
                mock.patch.object(sys, "argv", words), contextlib.redirect_stdout(printed), \
                self.assertRaises(SystemExit) as ended:
            chaos.main()
        self.assertEqual(ended.exception.code, 1)
        return lengths, printed.getvalue()

    def test_is_followed_by_a_few_runs_that_make_its_schedule_small(self):
        lengths, printed = self.run_chaos()
        self.assertLessEqual(len(lengths), 1 + chaos.SHRINKING)
        self.assertIn("smallest schedule", printed)
        self.assertEqual(printed.split("smallest schedule")[1].count("kill"), 1)

    def test_keeps_its_schedule_when_nobody_wants_a_smaller_one(self):
        lengths, printed = self.run_chaos("--shrink", "0")
        self.assertEqual(lengths, [8])
        self.assertNotIn("smallest", printed)


class Senders(InAFolder):
    """Two instances of which the books say what they accepted; at each pause those of `sending` accept a message more."""

    def found(self, listed, *sending):
        """`listed`: states by instance. `sending`: ids, at each look; the last ones from then on."""
        now, looks, sent = [0.0], list(sending), dict.fromkeys(("a", "b"), 0)

        def pause(seconds):
            now[0] += seconds
            if seconds != chaos.QUIET_S:
                return
            for instance in looks.pop(0) if len(looks) > 1 else looks[0]:
                sent[instance] += 1
                with open(self.folder / f"{instance}.sent", "a", encoding="ascii") as book:
                    book.write(f"sent 7.1 {sent[instance]} {now[0]}\n")

        world = SimpleNamespace(books=self.folder, pause=pause, json=lambda _what: [
            {"instance": instance, "state": state} for instance, state in listed.items()])
        with mock.patch.object(chaos.time, "monotonic", lambda: now[0]):
            return chaos.Run.senders(world, 60)

    def test_are_those_that_are_listed_as_active(self):
        self.assertEqual(self.found({"a": "active", "b": "inactive"}, "a"), [])
        self.assertEqual(self.found({"a": "active"}, "", "b", "", "ab", "a"), [], "they need a while")

    def test_are_nobody_who_is_stopped_or_gone(self):
        for listed in ({"a": "active", "b": "inactive"}, {"a": "active", "b": "failed"}, {"a": "active"}):
            self.assertEqual(self.found(listed, "ab"),
                             ["not within 60 s: b is not listed as active, and sends: 1 messages"])

    def test_are_all_that_are_active(self):
        self.assertEqual(self.found({"a": "active", "b": "active"}, "a"),
                         ["not within 60 s: b is listed as active, and sends nothing"])


class ASeries(InAFolder):
    """Of seeds 1 and 2, whose runs are all well; a part of each schedule cannot be done here."""

    def seeds_run(self, *options, commit="c0ffee"):
        """Calls the program; returns the seeds that were run."""
        seeds = []

        def one(_given, seed, _actions, _name):
            seeds.append(seed)
            return SimpleNamespace(violations=[], messages=7, commands=0, duplicates=0, converged_s=1.0, took_s=1.0, drops={},
                                   left_out="no full disks")

        words = ["chaos.py", str(self.folder), "--seed", "1", "--runs", "2", "--results", str(self.folder / "results.tsv"),
                 *options]
        with mock.patch.object(chaos, "one", one), mock.patch.object(chaos, "in_own_spaces", lambda: None), \
                mock.patch.object(chaos, "commit", lambda: commit), mock.patch.object(sys, "argv", words), \
                contextlib.redirect_stdout(io.StringIO()), self.assertRaises(SystemExit) as ended:
            chaos.main()
        self.assertEqual(ended.exception.code, 0)
        return seeds

    def test_goes_on_where_it_was_interrupted(self):
        self.assertEqual(self.seeds_run("--runs", "1"), [1])
        self.assertEqual(self.seeds_run(), [2])
        self.assertEqual(self.seeds_run(), [])
        self.assertEqual(self.seeds_run("--again"), [1, 2])
        self.assertEqual([line["left out"] for line in chaos.Results(self.folder / "results.tsv").known()],
                         4 * ["no full disks"])

    def test_passes_over_no_seed_that_was_run_otherwise(self):
        file = self.folder / "a.schedule"
        file.write_text("1 kill worker-1 1\n")
        self.assertEqual(self.seeds_run(), [1, 2])
        for options in (("--faults", "kill"), ("--targets", "worker-1"), ("--patience", "61"), ("--minutes", "2"),
                        ("--broker", "kafka"), ("--schedule", str(file))):
            self.assertEqual(self.seeds_run(*options), [1, 2], options)
            self.assertEqual(self.seeds_run(*options), [], options)
        file.write_text("2 kill worker-1 1\n")
        self.assertEqual(self.seeds_run("--schedule", str(file)), [1, 2], "the schedule was edited")
        self.assertEqual(self.seeds_run(commit="f00d"), [1, 2])

    def test_reads_the_lines_of_an_earlier_version(self):
        columns = chaos.COLUMNS[:chaos.COLUMNS.index("targets")]
        file = self.folder / "results.tsv"
        file.write_text("\t".join(columns) + "\n" + "\t".join(f"a {name}" for name in columns) + "\n")
        self.assertEqual(self.seeds_run(), [1, 2])
        old, new, _ = chaos.Results(file).known()
        self.assertEqual(old, {name: f"a {name}" for name in columns})
        self.assertEqual((new["seed"], new["messages"], new["patience"]), ("1", "7", "60"))


class Commit(InAFolder):
    def git(self, *words):
        subprocess.run(["git", "-C", self.folder, "-c", "user.name=t", "-c", "user.email=t@t", *words], check=True,
                       capture_output=True)

    def test_is_another_with_changes_that_are_not_committed_and_no_result_counts_for_them(self):
        source = self.folder / "source"
        source.write_text("1")
        self.git("init")
        self.git("add", "source")
        self.git("commit", "-m", "first")
        clean = chaos.commit(self.folder)
        self.assertNotIn("dirty", clean)
        source.write_text("2")
        self.assertEqual(chaos.commit(self.folder), clean + "-dirty")
        results = chaos.Results(self.folder / "results.tsv")
        for commit in (clean, clean + "-dirty"):
            results.add(seed=1, commit=commit)
        self.assertTrue(results.has(seed=1, commit=clean))
        self.assertFalse(results.has(seed=1, commit=clean + "-dirty"))


if __name__ == "__main__":
    unittest.main()

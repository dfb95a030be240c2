#!/usr/bin/python3
"""What a run leaves behind, whose processes it sees, and which results count for the sources as they are."""
import shutil
import subprocess
import sys
import tempfile
import unittest
from pathlib import Path
from unittest import mock

sys.path.insert(0, str(Path(__file__).resolve().parent))

import chaos  # noqa: E402
import checks  # noqa: E402
import cluster  # noqa: E402


class InAFolder(unittest.TestCase):
    def setUp(self):
        holder = tempfile.TemporaryDirectory()
        self.addCleanup(holder.cleanup)
        self.folder = Path(holder.name)


class AnEndedCluster(InAFolder):
    def test_has_the_files_of_its_small_disks_and_their_crashes_are_found(self):
        plugins = self.folder / "build/chaos/plugins"
        plugins.mkdir(parents=True)
        (plugins / "chaos_ledger_driver.so").touch()
        ended = cluster.ChaosCluster(self.folder / "build", self.folder / "out")
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


class Processes(InAFolder):
    def test_of_a_run_are_not_those_of_a_run_whose_name_begins_alike(self):
        with subprocess.Popen([sys.executable, "-c", "input(1)", self.folder / "rabbitmq-70/a.yaml"], stdin=subprocess.PIPE,
                              stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as child:
            self.assertEqual(child.stdout.read(1), b"1")  # so it runs, and the kernel has its arguments
            self.assertEqual(cluster.processes(self.folder / "rabbitmq-7"), [])
            self.assertEqual([pid for pid, _ in cluster.processes(self.folder / "rabbitmq-70")], [child.pid])
            child.stdin.close()


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

#!/usr/bin/python3
"""Private servers start, obey their commands, and leave nothing behind.

usage: servers_test.py [--every-kind]

What all kinds share is tested with the two that start fastest. `--every-kind` tests each kind alone; the suites that
use a server would fail too, but would not name the server as the cause.
"""
import os
import subprocess
import sys
import tempfile
import unittest
import unittest.mock
from pathlib import Path

import maven_jars
import private_server
from leftovers import left_behind

HERE = Path(__file__).resolve().parent
SKIPPED = 77  # what ctest reports as skipped


class Script:
    def __init__(self, name, folder, *options, **environment):
        self.folder = folder
        self.process = subprocess.Popen(["/usr/bin/python3", HERE / name, "--dir", folder, *options], text=True,
                                        stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                                        env={**os.environ, **environment})
        self.greeting = self.answer()

    def answer(self):
        return self.process.stdout.readline().strip()

    def ask(self, command):
        self.process.stdin.write(command + "\n")
        self.process.stdin.flush()
        return self.answer()

    def end(self):
        self.process.stdin.close()
        last = self.process.stdout.read().strip()
        self.process.stdout.close()
        return last, self.process.wait()


def command_line(process):
    """Empty when the process has ended."""
    try:
        return Path(f"/proc/{process}/cmdline").read_bytes()
    except OSError:
        return b""


class ServersTest(unittest.TestCase):
    def obeys(self, script, *options):
        with tempfile.TemporaryDirectory(prefix="iotcloud-servers-") as folder:
            server = Script(script, folder, *options)
            if server.greeting.startswith("SKIP"):
                server.end()
                self.skipTest(server.greeting)
            self.assertRegex(server.greeting, "^READY [a-z]+://")
            self.assertEqual(server.ask("kill"), "KILLED")
            self.assertRegex(server.ask("pause"), "^ERROR .* does not run")
            self.assertEqual(server.ask("start"), server.greeting)
            self.assertEqual(server.ask("pause"), "PAUSED")
            self.assertEqual(server.ask("resume"), "RESUMED")
            self.assertRegex(server.ask("dance"), "^ERROR no such command")
            self.assertEqual(server.end(), ("STOPPED", 0))
            self.all_end(server)

    def all_end(self, server):
        self.assertEqual(left_behind(server.folder), {})

    def test_rabbitmq(self):
        self.obeys("rabbitmq.py")

    def test_zookeeper(self):
        self.obeys("zookeeper.py")

    def test_a_server_dies_with_who_started_it(self):
        with tempfile.TemporaryDirectory(prefix="iotcloud-servers-") as folder:
            server = Script("zookeeper.py", folder)
            server.process.kill()
            server.end()
            self.all_end(server)

    def test_so_does_a_program_of_a_private_cluster(self):
        with tempfile.TemporaryDirectory(prefix="iotcloud-servers-") as folder:
            code = (f"import sys; sys.path.insert(0, {str(HERE)!r}); from private_cluster import Children\n"
                    f"print(Children({folder!r}).spawn('it', ['sleep', 1000]).pid, flush=True); sys.stdin.read()")
            with subprocess.Popen(["/usr/bin/python3", "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                                  text=True) as script:
                program = script.stdout.readline().strip()
                while not command_line(program):
                    os.sched_yield()  # a parent runs on before the kernel has written its child's new arguments
                self.assertEqual(command_line(program), b"sleep\x001000\x00")
                script.kill()
            while command_line(program):
                os.sched_yield()


class EveryKindTest(ServersTest):
    def test_mosquitto(self):
        self.obeys("mosquitto.py")

    def test_rtsp_camera(self):
        self.obeys("rtsp_camera.py")

    def test_mosquitto_with_tls(self):
        self.obeys("mosquitto.py", "--tls")

    def test_redis(self):
        self.obeys("redis.py")

    def test_redis_with_tls(self):
        self.obeys("redis.py", "--tls")

    def test_rabbitmq_with_tls(self):
        self.obeys("rabbitmq.py", "--tls")

    def test_a_rabbitmq_cluster(self):
        self.obeys("rabbitmq_cluster.py")

    def test_zookeeper_for_benchmarks(self):
        self.obeys("zookeeper.py", "--steady")

    def test_a_zookeeper_ensemble(self):
        self.obeys("zookeeper_cluster.py")

    def test_a_zookeeper_ensemble_that_loses_its_leader_has_another(self):
        with tempfile.TemporaryDirectory(prefix="iotcloud-servers-") as folder:
            cluster = Script("zookeeper_cluster.py", folder)
            self.assertRegex(cluster.greeting, "^READY zookeeper://.*,.*,.*$")
            first = cluster.ask("leader")
            self.assertRegex(first, "^LEADER [123]$")
            self.assertEqual(cluster.ask("kill leader"), "KILLED")
            self.assertRegex(cluster.ask("leader"), "^LEADER [123]$")
            self.assertNotEqual(cluster.ask("leader"), first)
            self.assertEqual(cluster.end(), ("STOPPED", 0))

    def test_kafka(self):
        self.obeys("kafka.py")

    def test_a_kafka_cluster_that_loses_a_leader_has_another(self):
        self.obeys("kafka_cluster.py")
        with tempfile.TemporaryDirectory(prefix="iotcloud-servers-") as folder:
            cluster = Script("kafka_cluster.py", folder)
            first = cluster.ask("leader some.topic")
            self.assertRegex(first, "^LEADER [123]$")
            self.assertEqual(cluster.ask("kill-leader some.topic"), "KILLED")
            self.assertRegex(cluster.ask("leader some.topic"), "^LEADER [123]$")
            self.assertNotEqual(cluster.ask("leader some.topic"), first)
            self.assertEqual(cluster.end(), ("STOPPED", 0))

    def test_kafka_with_tls(self):
        self.obeys("kafka.py", "--tls")

    def test_activemq(self):
        self.obeys("activemq.py")

    def test_activemq_with_tls(self):
        self.obeys("activemq.py", "--tls")


class FetchTest(unittest.TestCase):
    """Tests how maven_jars.py reads Maven's errors, with a program in Maven's place."""

    def fetch(self, said, ci):
        with tempfile.TemporaryDirectory(prefix="iotcloud-servers-") as folder:
            maven = Path(folder) / "mvn"
            maven.write_text(f"#!/bin/sh\necho '[ERROR] {said}'\nexit 1\n")
            maven.chmod(0o755)
            code = (f"import sys; sys.path.insert(0, {str(HERE)!r}); import maven_jars, private_server\n"
                    f"maven_jars.FETCHED = {folder!r}\nprivate_server.run(lambda: maven_jars.fetch('kafka'))")
            done = subprocess.run(["/usr/bin/python3", "-c", code], stdin=subprocess.DEVNULL, capture_output=True,
                                  text=True, env={**os.environ, "PATH": f"{folder}:{os.environ['PATH']}", "CI": ci,
                                       "IOTCLOUD_TEST_LABELS": ""})  # no server starts, and nothing is fetched
            return done.stdout.strip(), done.returncode

    def test_a_registry_that_cannot_be_reached_skips(self):
        answer, status = self.fetch("Could not transfer artifact: Connection refused", "")
        self.assertRegex(answer, "^SKIP .*kafka.*Connection refused")
        self.assertEqual(status, 0)

    def test_with_ci_it_is_an_error(self):
        answer, status = self.fetch("Could not transfer artifact: Connection refused", "true")
        self.assertRegex(answer, "^ERROR ")
        self.assertEqual(status, 1)

    def test_a_broken_pom_is_an_error_everywhere(self):
        answer, status = self.fetch("Non-parseable POM", "")
        self.assertRegex(answer, "^ERROR ")
        self.assertEqual(status, 1)

    def test_only_a_server_for_tests_reads_its_classes_from_the_archive_and_only_if_there_is_one(self):
        with tempfile.TemporaryDirectory(prefix="iotcloud-servers-") as folder, \
                unittest.mock.patch.object(maven_jars, "FETCHED", folder):
            self.assertEqual(maven_jars.shared_classes("kafka", private_server.QUICK_START), [])
            archive = Path(maven_jars.archive_of("kafka"))
            archive.parent.mkdir()
            archive.touch()
            self.assertEqual(maven_jars.shared_classes("kafka", private_server.QUICK_START),
                             [f"-XX:SharedArchiveFile={archive.resolve()}"])
            self.assertEqual(maven_jars.shared_classes("kafka", private_server.THROUGHPUT), [])


if __name__ == "__main__":
    every_kind = "--every-kind" in sys.argv[1:]
    chosen = [EveryKindTest] if every_kind else [ServersTest, FetchTest]
    load = unittest.defaultTestLoader.loadTestsFromTestCase
    result = unittest.TextTestRunner(verbosity=2).run(unittest.TestSuite(map(load, chosen)))
    sys.exit(1 if not result.wasSuccessful() else SKIPPED if result.skipped else 0)

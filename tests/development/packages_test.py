#!/usr/bin/python3
"""Tests which Debian packages commands of ./dev install on a machine that has none, and what it shows meanwhile; nothing
is installed."""
import os
import pty
import re
import select
import shutil
import subprocess
import tempfile
import time
import unittest
from pathlib import Path

DEV = Path(__file__).resolve().parents[2] / "dev"
# A user who is not root, no package, and a sudo that refuses: ./dev ends when it has said what it would install.
STAND_INS = {"id": "echo 1000", "dpkg-query": "exit 1", "sudo": "exit 1"}
SERVERS = {"rabbitmq-server", "zookeeper"}
REDIS = {"redis-server"}
JAVA = {"maven", "openjdk-17-jdk-headless", "openjdk-17-jre-headless"}
STORES = {"librocksdb-dev", "libhiredis-dev"}
DRIVERS = {"libmosquitto-dev", "libprotobuf-dev", "protobuf-compiler", "libmodbus-dev", "libudev-dev", "libpugixml-dev", "libgstreamer1.0-dev",
           "libgstreamer-plugins-base1.0-dev"}
DEVICES = {"mosquitto", "gstreamer1.0-plugins-good", "gstreamer1.0-plugins-bad", "gir1.2-gst-rtsp-server-1.0"}
RECORDING = {"liblz4-dev", "libzstd-dev"}
TESTS = {"libgtest-dev", "stunnel4", "clang", "libroscpp-dev"}
PICTURES = {"gnuplot-nox"}
# apt-get, which tells its progress in the descriptor that it is given, step by step as the test lets it, and then fails;
# and a sudo that closes all but three descriptors, as the real one does.
APT = """#!/bin/bash
[ "$1" = install ] || exit 0
[[ " $* " =~ \\ APT::Status-Fd=([0-9]+)\\  ]] || exit 1
echo "its own words"
echo "dlstatus:1:40.0:Retrieving file 1 of 3" >&"${BASH_REMATCH[1]}"
until [ -e downloaded ]; do sleep 0.1; done
echo "pmstatus:ninja-build:50.0:Unpacking ninja-build" >&"${BASH_REMATCH[1]}"
until [ -e unpacked ]; do sleep 0.1; done
echo "E: no space left"
exit 100
"""
SUDO = """#!/bin/bash
for descriptor in /proc/self/fd/*; do
  [ "${descriptor##*/}" -lt 3 ] || [ "${descriptor##*/}" -ge 200 ] || eval "exec ${descriptor##*/}>&-"
done
case "$1" in tee | chmod | rm) exit 0 ;; esac
exec "$@"
"""
ALL = SERVERS | REDIS | JAVA | STORES | DRIVERS | TESTS | PICTURES


def read_until(terminal, pattern):
    """Reads what is shown on a terminal until it matches. Raises AssertionError when it does not within a minute."""
    text, deadline = "", time.monotonic() + 60
    while not re.search(pattern, text):
        left = deadline - time.monotonic()
        if left < 0 or not select.select([terminal], [], [], left)[0]:
            raise AssertionError(f"{pattern} is not shown: {text}")
        text += os.read(terminal, 4096).decode()


class PackagesTest(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory(prefix="iotcloud-packages-")
        self.addCleanup(folder.cleanup)
        self.folder = Path(folder.name)
        shutil.copy(DEV, self.folder)  # alone: it does not get further than to the packages
        for name, text in STAND_INS.items():
            (self.folder / name).write_text(f"#!/bin/sh\n{text}\n")
            (self.folder / name).chmod(0o755)

    def installed_by(self, *words, of=frozenset(ALL)):
        """Those of ALL (or `of`) that a command installs, which installs the compiler in any case."""
        environment = {name: value for name, value in os.environ.items() if name != "IOTCLOUD_STEPS"}
        done = subprocess.run([self.folder / "dev", *words], capture_output=True, text=True, stdin=subprocess.DEVNULL,
                              env={**environment, "PATH": f"{self.folder}:{environment['PATH']}"})
        told = re.search(r"installing \d+ Debian packages: (.*)", done.stdout)
        self.assertTrue(told, f"{done.stdout}{done.stderr}")
        self.assertNotEqual(done.returncode, 0)
        packages = set(told[1].split())
        self.assertIn("g++", packages)
        return packages & of

    def test_the_demo_in_one_process_installs_no_server_and_no_store(self):
        self.assertEqual(self.installed_by("demo"), PICTURES)
        self.assertEqual(self.installed_by("demo", "--cluster"), SERVERS | PICTURES | {"openjdk-17-jre-headless"})

    def test_a_benchmark_installs_the_servers_that_it_measures(self):
        self.assertEqual(self.installed_by("bench", "runtime"), set())
        self.assertEqual(self.installed_by("bench", "brokers", "--quick", "--only", "rabbitmq"), {"rabbitmq-server"})
        self.assertEqual(self.installed_by("bench", "brokers", "--only=kafka"), {"maven", "openjdk-17-jdk-headless"})
        self.assertEqual(self.installed_by("bench", "brokers"), {"rabbitmq-server", "maven", "openjdk-17-jdk-headless"})
        self.assertEqual(self.installed_by("bench", "state", "--broker", "kafka", of=JAVA), JAVA)
        self.assertEqual(self.installed_by("bench", "state", of=JAVA), {"openjdk-17-jre-headless"})

    def test_redis_is_installed_for_tests_with_servers_and_for_the_benchmark_of_state(self):
        for words, expected in ((("test",), REDIS), (("test", "--repeat", "1"), REDIS), (("bench", "state"), REDIS), (("deps",), REDIS),
                                (("bench", "fleet"), set()), (("demo", "--engine=storm"), set()), (("demo", "rabbitmq"), set())):
            self.assertEqual(self.installed_by(*words, of=REDIS), expected, words)

    def test_the_bare_amqp_client_is_installed_where_it_is_compiled(self):
        client = {"libqpid-proton-cpp12-dev"}
        for words, expected in ((("demo",), set()), (("bench", "brokers"), client), (("build",), client), (("test", "--unit"), client)):
            self.assertEqual(self.installed_by(*words, of=client), expected, words)

    def test_what_builds_all_drivers_installs_their_libraries_and_the_demo_none(self):
        for words, expected in ((("build",), DRIVERS), (("install", "there"), DRIVERS), (("demo",), set()), (("demo", "--cluster"), set()),
                                (("bench", "runtime"), set())):
            self.assertEqual(self.installed_by(*words, of=DRIVERS | DEVICES), expected, words)

    def test_what_makes_debian_packages_is_installed_for_that_alone(self):
        makers = {"debhelper", "help2man", "lintian", "debootstrap"}
        self.assertEqual(self.installed_by("package", of=makers | {"libroscpp-dev", "python3-rosmaster"}),
                         makers - {"debootstrap"} | {"libroscpp-dev"})
        for words in (("demo",), ("build",), ("install", "there"), ("test", "--unit")):
            self.assertEqual(self.installed_by(*words, of=makers), set(), words)

    def test_what_builds_or_documents_all_of_the_sdks_installs_the_stores(self):
        for words in (("build",), ("docs",), ("install", "there"), ("bench", "state")):
            self.assertEqual(self.installed_by(*words, of=STORES | RECORDING), STORES | RECORDING, words)

    def test_apts_progress_is_told_on_a_terminal_also_with_sudo(self):
        for name, text in (("apt-get", APT), ("sudo", SUDO)):
            (self.folder / name).write_text(text)
            (self.folder / name).chmod(0o755)
        terminal, end = pty.openpty()
        with subprocess.Popen([self.folder / "dev", "build"], stdin=subprocess.DEVNULL, stdout=end, stderr=subprocess.PIPE, text=True,
                              env={**os.environ, "PATH": f"{self.folder}:{os.environ['PATH']}"}) as dev:
            os.close(end)
            try:
                read_until(terminal, r"packages: 40 %  downloading, \d+ s, about \d+ s left of this")
                (self.folder / "downloaded").touch()
                read_until(terminal, r"packages: 50 %  Unpacking ninja-build, \d+ s, about \d+ s left of this")
            finally:
                (self.folder / "downloaded").touch()
                (self.folder / "unpacked").touch()
            error = dev.stderr.read()
        os.close(terminal)
        self.assertNotEqual(dev.returncode, 0)
        self.assertIn("E: no space left", error)
        self.assertIn("build/deps.log", error)
        self.assertEqual((self.folder / "build/deps.log").read_text(), "its own words\nE: no space left\n")


if __name__ == "__main__":
    unittest.main()

#!/usr/bin/python3
"""Tests the daemons' frame from outside: usage: daemon_test.py TINY_DAEMON"""

import json
import os
import signal
import socket
import subprocess
import sys
import tempfile
import unittest
import urllib.error
import urllib.request
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "servers"))

from private_server import free_ports  # noqa: E402

PROGRAM = sys.argv.pop(1)


class Daemon(unittest.TestCase):
    def setUp(self):
        self.directory = tempfile.TemporaryDirectory()
        self.addCleanup(self.directory.cleanup)

    def config(self, text):
        path = os.path.join(self.directory.name, "tiny.yaml")
        with open(path, "w") as file:
            file.write(text)
        return path

    def run_to_end(self, *words):
        return subprocess.run([PROGRAM, *words], capture_output=True, text=True, timeout=120)

    def start(self, text, ready="ready", options=(), user=None, **environment):
        daemon = subprocess.Popen([PROGRAM, "--config", self.config(text), *options], stderr=subprocess.PIPE, text=True,
                                  env={**os.environ, **environment}, user=user)
        self.addCleanup(daemon.stderr.close)
        self.addCleanup(daemon.wait)
        self.addCleanup(daemon.kill)
        self.await_line(daemon, ready)
        return daemon

    def await_line(self, daemon, word):
        for line in daemon.stderr:
            if word in line:
                return line
        self.fail(f'"{word}" was never logged; status {daemon.wait()}')

    def test_help_and_version_are_printed(self):
        self.assertIn("--check-config", self.run_to_end("--help").stdout)
        self.assertIn("tiny-daemon 0.", self.run_to_end("--version").stdout)

    def test_a_good_configuration_is_said_to_be_good(self):
        done = self.run_to_end("--config", self.config("stop: hang"), "--check-config")
        self.assertEqual(done.returncode, 0, done.stderr)

    def test_a_bad_configuration_is_one_message_with_its_place(self):
        done = self.run_to_end("--config", self.config("a: 1\nstop: hang"))
        self.assertEqual(done.returncode, 2)
        self.assertRegex(done.stderr, r"tiny\.yaml:1:1: a: unknown key")
        self.assertEqual(done.stderr.count("\n"), 1)

    def test_bad_usage_ends_with_2(self):
        self.assertEqual(self.run_to_end("--nonsense").returncode, 2)
        self.assertEqual(self.run_to_end().returncode, 2)

    def test_others_of_its_user_do_not_read_its_memory(self):
        user = "nobody" if os.geteuid() == 0 else None  # root may read everything
        os.chmod(self.directory.name, 0o755)

        def may_open(daemon, name):
            return subprocess.run(["dd", f"if=/proc/{daemon.pid}/{name}", "of=/dev/null", "count=0"], user=user,
                                  capture_output=True).returncode == 0

        attacked = self.start("stop: at once", options=("--debuggable",), user=user)
        self.assertTrue(may_open(attacked, "environ"), "the attack")
        daemon = self.start("stop: at once", user=user)
        for name in "environ", "mem", "maps":
            self.assertFalse(may_open(daemon, name), name)

    def test_sigterm_stops_in_order(self):
        daemon = self.start("stop: at once")
        daemon.send_signal(signal.SIGTERM)
        self.assertEqual(daemon.wait(120), 0)

    def test_how_long_a_stop_may_take_is_an_option(self):
        for options, limit_ms in ((), 2700), (("--stop-limit", "100"), 90000):
            daemon = self.start("stop: at once", options=options)
            daemon.send_signal(signal.SIGTERM)
            self.await_line(daemon, f"has {limit_ms} ms to stop")
            self.assertEqual(daemon.wait(120), 0)
        daemon = self.start("stop: hang", options=("--stop-limit", "0.5"))
        daemon.send_signal(signal.SIGTERM)
        self.await_line(daemon, "did not stop within its limit")
        self.assertEqual(daemon.wait(120), 1)
        self.assertEqual(self.run_to_end("--config", self.config("stop: hang"), "--stop-limit", "-1").returncode, 2)

    def test_sigterm_ends_the_waits_of_a_start(self):
        for ending in "at once", "hang":
            daemon = self.start(f"start: wait\nstop: {ending}", ready="waits")
            daemon.send_signal(signal.SIGTERM)
            said = self.await_line(daemon, "SIGTERM received, stopping")
            self.assertNotIn("ready", said)
            if ending == "hang":
                daemon.send_signal(signal.SIGTERM)
            self.assertEqual(daemon.wait(120), 1 if ending == "hang" else 0)

    def test_sigpipe_is_ignored(self):
        daemon = self.start("stop: at once")
        daemon.send_signal(signal.SIGPIPE)
        daemon.send_signal(signal.SIGINT)
        self.assertEqual(daemon.wait(120), 0)

    def test_a_service_that_hangs_while_stopping_is_ended(self):
        daemon = self.start("stop: hang")
        daemon.send_signal(signal.SIGTERM)
        self.assertEqual(daemon.wait(120), 1)

    def test_a_second_signal_ends_at_once_what_takes_long_to_stop(self):
        daemon = self.start("stop: hang", options=("--stop-limit", "600"))
        daemon.send_signal(signal.SIGTERM)
        self.await_line(daemon, "stopping")
        daemon.send_signal(signal.SIGTERM)
        self.assertEqual(daemon.wait(120), 1)
        self.assertNotIn("did not stop within its limit", daemon.stderr.read())

    def test_sighup_reads_how_to_log_again(self):
        daemon = self.start("log: {level: info}")
        self.config("log: {format: json}")
        daemon.send_signal(signal.SIGHUP)
        line = json.loads(self.await_line(daemon, "SIGHUP received"))
        self.assertEqual((line["level"], line["part"]), ("info", "tiny-daemon"))
        daemon.send_signal(signal.SIGTERM)
        self.assertEqual(daemon.wait(120), 0)

    def test_sighup_with_a_file_that_is_wrong_changes_nothing(self):
        daemon = self.start("log: {level: info}")
        self.config("log: {level: loud}")
        daemon.send_signal(signal.SIGHUP)
        self.assertRegex(self.await_line(daemon, "nothing changes"), r"tiny\.yaml:1:\d+: log\.level")
        daemon.send_signal(signal.SIGTERM)
        self.await_line(daemon, "stopping")  # still on level info

    def test_sighup_makes_the_service_read_again_what_can_change(self):
        daemon = self.start("stop: at once")
        daemon.send_signal(signal.SIGHUP)
        self.await_line(daemon, "read again what it has")
        daemon.send_signal(signal.SIGTERM)
        self.assertEqual(daemon.wait(120), 0)
        daemon = self.start("unreadable: the tokens are gone")
        daemon.send_signal(signal.SIGHUP)
        self.await_line(daemon, "stays as it was: the tokens are gone")
        daemon.send_signal(signal.SIGTERM)
        self.assertEqual(daemon.wait(120), 0)

    def test_options_go_before_the_file(self):
        done = self.run_to_end("--config", self.config("log: {format: text}\na: 1"), "--log-format", "xml")
        self.assertEqual(done.returncode, 2)
        self.assertIn("use text or json", done.stderr)
        path = self.config(f'metrics: "127.0.0.1:{free_ports(1)[0]}"\nlog: {{format: text}}')
        daemon = subprocess.Popen([PROGRAM, "--config", path, "--log-format", "json"], stderr=subprocess.PIPE, text=True)
        self.addCleanup(daemon.stderr.close)
        self.addCleanup(daemon.wait)
        self.addCleanup(daemon.kill)
        self.assertEqual(json.loads(daemon.stderr.readline())["text"], "ready")

    def test_systemd_is_told_how_it_goes(self):
        manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.addCleanup(manager.close)
        manager.bind(os.path.join(self.directory.name, "notify"))
        manager.settimeout(30)
        daemon = self.start("trouble: a wheel is loose", NOTIFY_SOCKET=manager.getsockname(), WATCHDOG_USEC="200000")
        self.assertIn("READY=1", manager.recv(1000).decode())
        for _ in range(3):  # one would do for READY, not for a watchdog
            self.assertEqual(manager.recv(1000).decode(), "WATCHDOG=1\nSTATUS=running; a wheel is loose")
        daemon.send_signal(signal.SIGTERM)
        while "STOPPING=1" not in (said := manager.recv(1000).decode()):
            self.assertIn("WATCHDOG=1", said)

    def test_health_is_a_page_of_its_own(self):
        port = free_ports(1)[0]
        self.start(f'metrics: "127.0.0.1:{port}"')
        self.assertEqual(urllib.request.urlopen(f"http://127.0.0.1:{port}/healthz", timeout=60).read(), b"ok\n")
        port = free_ports(1)[0]
        self.start(f'metrics: "127.0.0.1:{port}"\ntrouble: a wheel is loose')
        with self.assertRaises(urllib.error.HTTPError) as answer:
            urllib.request.urlopen(f"http://127.0.0.1:{port}/healthz", timeout=60)
        self.assertEqual(answer.exception.code, 503)
        self.assertEqual(answer.exception.read(), b"a wheel is loose\n")

    def test_metrics_are_served_in_the_text_format(self):
        port = free_ports(1)[0]
        self.start(f'metrics: "127.0.0.1:{port}"')
        text = urllib.request.urlopen(f"http://127.0.0.1:{port}/metrics", timeout=60).read().decode()
        self.assertIn('tiny_total{kind="a"} 3', text)
        self.assertIn("tiny_seconds_max 0.002", text)
        self.assertRegex(text, r'tiny_seconds\{quantile="0.5"\} 0\.00(19|20)')

    def test_an_address_in_use_is_named(self):
        with socket.socket() as taken:
            taken.bind(("127.0.0.1", 0))
            taken.listen()
            address = f"127.0.0.1:{taken.getsockname()[1]}"
            done = self.run_to_end("--config", self.config(f'metrics: "{address}"'))
        self.assertEqual(done.returncode, 1)
        self.assertIn(address, done.stderr)


if __name__ == "__main__":
    unittest.main()

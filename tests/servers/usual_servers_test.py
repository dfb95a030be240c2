#!/usr/bin/python3
"""./dev servers up, status, down: the servers answer in the background, and nothing is left of them."""
import socket
import subprocess
import tempfile
import unittest
from pathlib import Path

import private_server
from leftovers import left_behind

SCRIPT = Path(__file__).resolve().parent / "usual_servers.py"


class UsualServers(unittest.TestCase):
    def setUp(self):
        self.place = tempfile.TemporaryDirectory(prefix="iotcloud-usual-")
        self.folder = self.place.name
        self.ports = private_server.free_ports(2)

    def tearDown(self):
        self.run_script("down")
        self.place.cleanup()

    def run_script(self, what):
        return subprocess.run(["/usr/bin/python3", SCRIPT, "--dir", self.folder, "--rabbitmq", str(self.ports[0]),
                               "--zookeeper", str(self.ports[1]), what], text=True, capture_output=True, check=False)

    def test_they_run_in_the_background_until_they_are_ended(self):
        self.assertEqual(self.run_script("status").returncode, 1)
        up = self.run_script("up")
        self.assertEqual(up.returncode, 0, up.stderr)
        self.assertEqual(up.stdout.split(), ["amqp://guest:guest@127.0.0.1:%d/" % self.ports[0],
                                             "zookeeper://127.0.0.1:%d" % self.ports[1]])
        for port in self.ports:
            socket.create_connection(("127.0.0.1", port), timeout=60).close()
        self.assertEqual(self.run_script("status").returncode, 0)
        again = self.run_script("up")
        self.assertEqual((again.returncode, "run already" in again.stdout), (0, True), again.stderr)
        self.assertEqual(self.run_script("down").returncode, 0)
        self.assertEqual(left_behind(self.folder), {})
        self.assertEqual(self.run_script("down").returncode, 0)

    def test_a_port_that_is_in_use_is_named(self):
        with socket.create_server(("127.0.0.1", self.ports[1])):
            up = self.run_script("up")
        self.assertEqual(up.returncode, 1)
        self.assertIn("port %d, which is ZooKeeper's, is in use" % self.ports[1], up.stderr)
        self.assertEqual(self.run_script("status").returncode, 1)


if __name__ == "__main__":
    unittest.main()

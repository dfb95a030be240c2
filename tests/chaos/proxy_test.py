#!/usr/bin/python3
"""The proxy makes links bad, and good again."""
import socket
import subprocess
import sys
import threading
import time
import unittest
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

import proxy  # noqa: E402
LIMIT_S = 60


class Echo:
    """A server that sends back what it gets."""

    def __init__(self):
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        self.ended = threading.Semaphore(0)  # one for each connection that its client has ended
        self.got, self.more = b"", threading.Condition()
        threading.Thread(target=self.accept, daemon=True).start()

    def accept(self):
        while True:
            try:
                connection, _ = self.listener.accept()
            except OSError:
                return
            threading.Thread(target=self.serve, args=(connection,), daemon=True).start()

    def serve(self, connection):
        try:
            with connection:
                while data := connection.recv(65536):
                    with self.more:
                        self.got += data
                        self.more.notify_all()
                    connection.sendall(data)
        except OSError:
            pass
        self.ended.release()

    def gets(self, text, limit):
        """Whether this comes within so many seconds."""
        with self.more:
            return self.more.wait_for(lambda: text in self.got, limit)


class ProxyTest(unittest.TestCase):
    def setUp(self):
        self.echo = Echo()
        self.addCleanup(self.echo.listener.close)
        self.proxy = subprocess.Popen([sys.executable, HERE / "proxy.py"], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                                      text=True)
        self.addCleanup(self.end)
        self.port = int(self.say(f"link way 127.0.0.1:{self.echo.port}"))

    def end(self):
        self.proxy.stdin.close()
        self.proxy.wait(LIMIT_S)
        self.proxy.stdout.close()

    def say(self, command):
        self.proxy.stdin.write(command + "\n")
        self.proxy.stdin.flush()
        return self.proxy.stdout.readline().strip()

    def connect(self):
        client = socket.create_connection(("127.0.0.1", self.port), timeout=LIMIT_S)
        self.addCleanup(client.close)
        return client

    def ask(self, client, text):
        client.sendall(text)
        return self.read(client, len(text))

    @staticmethod
    def read(client, size):
        data = b""
        while len(data) < size and (chunk := client.recv(size - len(data))):
            data += chunk
        return data

    def assert_silent(self, client):
        client.settimeout(0.2)
        with self.assertRaises(TimeoutError):
            client.recv(1)
        client.settimeout(LIMIT_S)

    def test_a_good_link_passes_everything_and_the_end(self):
        client = self.connect()
        text = bytes(range(256)) * 4000
        threading.Thread(target=client.sendall, args=(text,), daemon=True).start()
        self.assertEqual(self.read(client, len(text)), text)
        client.shutdown(socket.SHUT_WR)
        self.assertEqual(client.recv(1), b"")

    def test_a_cut_link_passes_everything_later(self):
        client = self.connect()
        self.assertEqual(self.ask(client, b"one"), b"one")
        self.assertEqual(self.say("cut way"), "CUT")
        client.sendall(b"two")
        self.assert_silent(client)
        other = self.connect()
        other.sendall(b"new")
        self.assert_silent(other)
        self.assertEqual(self.say("pass way"), "PASSES")
        self.assertEqual(self.read(client, 3), b"two")
        self.assertEqual(self.read(other, 3), b"new")

    def test_a_reset_ends_what_is_there_and_nothing_more(self):
        client = self.connect()
        self.assertEqual(self.ask(client, b"one"), b"one")
        self.assertEqual(self.say("reset way"), "RESET")
        with self.assertRaises(ConnectionResetError):
            client.recv(1)
        self.assertTrue(self.echo.ended.acquire(timeout=LIMIT_S))
        self.assertEqual(self.ask(self.connect(), b"two"), b"two")

    def test_a_link_that_refuses(self):
        client = self.connect()
        self.assertEqual(self.ask(client, b"one"), b"one")
        self.assertEqual(self.say("refuse way"), "REFUSES")
        with self.assertRaises(ConnectionResetError):
            client.recv(1)
        with self.assertRaises(ConnectionRefusedError):
            self.connect()
        self.assertEqual(self.say("pass way"), "PASSES")
        self.assertEqual(self.ask(self.connect(), b"two"), b"two")

    def test_a_half_open_link_ends_the_servers_side_only_and_for_ever(self):
        client = self.connect()
        self.assertEqual(self.ask(client, b"one"), b"one")
        self.assertEqual(self.say("half_open way"), "HALF_OPEN")
        self.assertTrue(self.echo.ended.acquire(timeout=LIMIT_S))
        client.sendall(b"two")
        self.assert_silent(client)
        self.assertEqual(self.say("pass way"), "PASSES")
        client.sendall(b"three")
        self.assert_silent(client)
        self.assertEqual(self.ask(self.connect(), b"four"), b"four")

    def test_a_link_of_one_way(self):
        for mode, text in (("one_way_up", b"one"), ("one_way_down", b"two")):
            client = self.connect()
            self.assertEqual(self.ask(client, b"made"), b"made")
            self.assertEqual(self.say(f"{mode} way"), mode.upper())
            client.sendall(text)
            up = mode == "one_way_up"
            self.assertEqual(self.echo.gets(text, LIMIT_S if up else 0.2), up, mode)
            self.assert_silent(client)
            self.assertEqual(self.say("pass way"), "PASSES")
            self.assertEqual(self.read(client, 3), text)

    def test_a_link_of_one_way_down_passes_what_the_server_sends(self):
        listener = socket.create_server(("127.0.0.1", 0))
        self.addCleanup(listener.close)
        self.port = int(self.say(f"link down 127.0.0.1:{listener.getsockname()[1]}"))
        client = self.connect()
        server, _ = listener.accept()
        self.addCleanup(server.close)
        server.settimeout(LIMIT_S)
        for mode in ("one_way_down", "one_way_up"):
            self.assertEqual(self.say(f"{mode} down"), mode.upper())
            server.sendall(b"one")
            if mode == "one_way_up":
                self.assert_silent(client)
                self.assertEqual(self.say("pass down"), "PASSES")
            self.assertEqual(self.read(client, 3), b"one")

    def test_a_slow_link_passes_everything_and_takes_its_time(self):
        client = self.connect()
        self.assertEqual(self.ask(client, b"one"), b"one")
        self.assertEqual(self.say("slow way"), "SLOW")
        text, began = bytes(6000), time.monotonic()
        self.assertEqual(self.ask(client, text), text)
        # Each of the two ways needs this for the bytes. What was asked of the link before it was slow is not slowed.
        self.assertGreater(time.monotonic() - began, len(text) / proxy.SLOW_BYTES_S)

    def test_a_wrong_command_is_answered(self):
        for command in ("cut other", "link way", "tickle way", ""):
            self.assertTrue(self.say(command).startswith("ERROR"), command)


if __name__ == "__main__":
    unittest.main()

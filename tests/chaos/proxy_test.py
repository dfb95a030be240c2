#!/usr/bin/python3
"""The proxy makes links bad, and good again."""
import socket
import subprocess
import sys
import threading
import unittest
from pathlib import Path

HERE = Path(__file__).resolve().parent
LIMIT_S = 60


class Echo:
    """A server that sends back what it gets."""

    def __init__(self):
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        self.ended = threading.Semaphore(0)  # one for each connection that its client has ended
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
                    connection.sendall(data)
        except OSError:
            pass
        self.ended.release()


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
        for mode in ("one_way_up", "one_way_down"):
            client = self.connect()
            self.assertEqual(self.say(f"{mode} way"), mode.upper())
            client.sendall(b"one")
            self.assert_silent(client)
            self.assertEqual(self.say("pass way"), "PASSES")
            self.assertEqual(self.read(client, 3), b"one")

    def test_a_slow_link_passes_everything(self):
        client = self.connect()
        self.assertEqual(self.say("slow way"), "SLOW")
        text = bytes(3000)
        self.assertEqual(self.ask(client, text), text)

    def test_a_wrong_command_is_answered(self):
        for command in ("cut other", "link way", "tickle way", ""):
            self.assertTrue(self.say(command).startswith("ERROR"), command)


if __name__ == "__main__":
    unittest.main()

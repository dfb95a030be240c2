#!/usr/bin/python3
"""The shipped configurations of the tunnel to the registry, that of the units and those of docker-compose.yml: what goes in
comes out at a server of the same authority that has the name which was asked for, and nowhere else; a certificate that is
revoked opens nothing; and who opens many connections takes them from nobody.

usage: registry_tunnel_test.py DEPLOY_FOLDER IOTCLOUD
"""

import contextlib
import pathlib
import re
import signal
import socket
import ssl
import struct
import subprocess
import sys
import tempfile
import threading
import time
import unittest

import yaml

SERVERS = pathlib.Path(__file__).resolve().parent.parent / "servers"
sys.path.insert(0, str(SERVERS))

from private_server import free_ports  # noqa: E402

DEPLOY, IOTCLOUD = pathlib.Path(sys.argv[1]), sys.argv[2]
CONFIGURATION = DEPLOY / "systemd/registry-tunnel.conf"
LIMIT_S = 120
USUAL = 60  # connections that ZooKeeper allows one address, if its configuration says nothing
MANY = 150
# What a client of ZooKeeper says first: the length, the protocol's version, no transaction seen, a time-out of 10 s, no session.
HELLO_REGISTRY = struct.pack(">iiqiqi16x", 44, 0, 0, 10_000, 0, 16)


class PlainServer:
    """Answers what it hears in capitals."""

    def __init__(self):
        self.heard = b""
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.port = self.listener.getsockname()[1]
        threading.Thread(target=self.serve, daemon=True).start()

    def serve(self):
        while True:
            try:
                client = self.accept()
            except ssl.SSLError:
                continue  # it does not talk to this one
            except OSError:
                return
            threading.Thread(target=self.answer, args=(client,), daemon=True).start()

    def answer(self, client):
        with contextlib.suppress(OSError), client:
            self.heard += (data := client.recv(100))
            client.sendall(data.upper())

    def accept(self):
        return self.listener.accept()[0]


class Server(PlainServer):
    """The same, to clients with a certificate of the authority."""

    def __init__(self, folder, name):
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(folder / f"{name}.pem", folder / f"{name}.key")
        context.load_verify_locations(folder / "ca.pem")
        context.verify_mode = ssl.CERT_REQUIRED
        self.context = context
        super().__init__()

    def accept(self):
        return self.context.wrap_socket(super().accept(), server_side=True)


class Tunnel(unittest.TestCase):
    def setUp(self):
        folder = tempfile.TemporaryDirectory()
        self.addCleanup(folder.cleanup)
        self.folder = pathlib.Path(folder.name) / "certs"
        self.certs("init", "localhost", "lab1", "zk1", "lab1-tunnel")

    def certs(self, verb, *hosts):
        subprocess.run([IOTCLOUD, "certs", verb, self.folder, "--host", ",".join(hosts)], check=True, capture_output=True,
                       timeout=60)

    def revoke(self, host):
        subprocess.run([IOTCLOUD, "certs", "revoke", self.folder, host], check=True, capture_output=True, timeout=60)

    def start(self, port, name="localhost"):
        """Starts stunnel with the shipped file, on ports of this test, to a server that must have this name."""
        accept = free_ports(1)[0]
        text = CONFIGURATION.read_text().replace("/etc/iotcloud", str(self.folder))
        for there, here in (("127.0.0.1:2181", f"127.0.0.1:{accept}"), ("connect = zk1:2281", f"connect = 127.0.0.1:{port}"),
                            ("checkHost = zk1", f"checkHost = {name}")):
            self.assertIn(there, text)
            text = text.replace(there, here)
        self.stunnel("tunnel.conf", text)
        return accept

    def stunnel(self, name, text, descriptors=None):
        """descriptors: as many as it may have."""
        file = self.folder / name
        file.write_text(text)
        limit = ["prlimit", f"--nofile={descriptors}"] if descriptors else []
        tunnel = subprocess.Popen([*limit, "/usr/bin/stunnel4", file], stderr=subprocess.DEVNULL)
        self.addCleanup(tunnel.wait)
        self.addCleanup(tunnel.terminate)
        return tunnel

    def of_cluster(self, name, host, places, descriptors=None):
        """Starts stunnel with a configuration of docker-compose.yml, as a container that has this certificate."""
        text = (DEPLOY / "cluster" / name).read_text()
        for there, here in {"/run/secrets/host": f"{self.folder}/{host}", "/run/secrets": str(self.folder), **places}.items():
            self.assertIn(there, text)
            text = text.replace(there, here)
        return self.stunnel(name, text, descriptors)

    def ask(self, port, limit_s=LIMIT_S):
        """What comes back through the tunnel in this time; empty: nothing, or the connection ended."""
        deadline = time.monotonic() + LIMIT_S
        while True:
            try:
                client = socket.create_connection(("127.0.0.1", port), timeout=limit_s)
                break
            except ConnectionRefusedError:  # it is starting
                self.assertLess(time.monotonic(), deadline)
                time.sleep(0.05)
            except ConnectionResetError:  # the tunnel took it and closed it before connect() had returned
                return b""
        with client:
            try:
                client.sendall(b"ruok")
                return client.recv(100)
            except (ConnectionError, TimeoutError):
                return b""

    def test_it_leads_to_the_server_that_was_meant(self):
        server = Server(self.folder, "localhost")
        self.assertEqual(self.ask(self.start(server.port)), b"RUOK")

    def test_it_does_not_lead_to_a_server_of_another_name_or_authority(self):
        named = Server(self.folder, "lab1")
        self.assertEqual(self.ask(self.start(named.port, "zk1")), b"")
        trusted, self.folder = self.folder, self.folder.with_name("strangers")
        self.certs("init", "localhost")
        foreign = Server(self.folder, "localhost")
        self.folder = trusted
        self.assertEqual(self.ask(self.start(foreign.port)), b"")
        self.assertEqual(named.heard + foreign.heard, b"")

    def test_it_does_not_lead_to_a_server_whose_certificate_is_revoked(self):
        server = Server(self.folder, "localhost")
        self.revoke("localhost")
        self.assertEqual(self.ask(self.start(server.port)), b"")
        self.assertEqual(server.heard, b"")

    def test_the_clusters_two_ends_fit_and_take_no_strangers(self):
        behind = PlainServer()
        ends, inner = free_ports(2)
        server = {"accept = 2281": f"accept = 127.0.0.1:{inner}", "zookeeper:2181": f"127.0.0.1:{behind.port}"}
        client = {"127.0.0.1:2181": f"127.0.0.1:{ends}", "connect = registry-tls:2281": f"connect = 127.0.0.1:{inner}"}
        self.certs("add", "registry-tls", "master-1")
        self.of_cluster("registry-tls.conf", "registry-tls", server)
        self.of_cluster("registry-tunnel.conf", "master-1", client)
        self.assertEqual(self.ask_until_answered(ends), b"RUOK")
        self.folder = self.folder.with_name("strangers")
        self.certs("init", "master-1")
        client["127.0.0.1:2181"] = f"127.0.0.1:{(stranger := free_ports(1)[0])}"
        self.of_cluster("registry-tunnel.conf", "master-1", client)
        self.assertEqual(self.ask(stranger), b"")
        self.assertEqual(behind.heard, b"ruok")

    def test_the_clusters_end_takes_no_revoked_certificate_once_it_was_told_to_read_the_list(self):
        behind = PlainServer()
        inner = free_ports(1)[0]
        server = {"accept = 2281": f"accept = 127.0.0.1:{inner}", "zookeeper:2181": f"127.0.0.1:{behind.port}"}
        self.certs("add", "registry-tls", "gateway-1", "gateway-2")
        tunnel = self.of_cluster("registry-tls.conf", "registry-tls", server)
        ends = {}
        for gateway in ("gateway-1", "gateway-2"):
            ends[gateway] = free_ports(1)[0]
            self.of_cluster("registry-tunnel.conf", gateway, {"127.0.0.1:2181": f"127.0.0.1:{ends[gateway]}",
                                                              "connect = registry-tls:2281": f"connect = 127.0.0.1:{inner}"})
            self.assertEqual(self.ask_until_answered(ends[gateway]), b"RUOK")
        self.revoke("gateway-1")
        shown = self.certificate_at(inner)
        subprocess.run([IOTCLOUD, "certs", "renew", self.folder, "registry-tls"], check=True, capture_output=True, timeout=60)
        self.assertEqual(self.certificate_at(inner), shown, "it reads nothing before it is told")
        tunnel.send_signal(signal.SIGHUP)
        deadline = time.monotonic() + LIMIT_S
        while self.certificate_at(inner) == shown:
            self.assertLess(time.monotonic(), deadline, "it still shows the certificate of before")
            time.sleep(0.05)
        self.assertIsNone(tunnel.poll(), "the same process goes on")
        self.assertEqual(self.ask(ends["gateway-1"]), b"")
        self.assertEqual(self.ask_until_answered(ends["gateway-2"]), b"RUOK")

    def test_who_takes_all_that_an_end_has_locks_others_out_there_until_he_goes(self):
        """SECURITY.md, "Floods": where no firewall limits what one machine may have, and at the own end of a machine."""
        behind = PlainServer()
        own, inner = free_ports(2)
        self.certs("add", "registry-tls", "gateway-1")
        few, more = 64, 128
        self.of_cluster("registry-tls.conf", "registry-tls",
                        {"accept = 2281": f"accept = 127.0.0.1:{inner}", "zookeeper:2181": f"127.0.0.1:{behind.port}"}, more)
        self.of_cluster("registry-tunnel.conf", "gateway-1", {"127.0.0.1:2181": f"127.0.0.1:{own}",
                                                              "connect = registry-tls:2281": f"connect = 127.0.0.1:{inner}"}, few)
        for end, descriptors in ((inner, more), (own, few)):
            self.assertEqual(self.ask_until_answered(own), b"RUOK")
            held = [socket.create_connection(("127.0.0.1", end)) for _ in range(descriptors)]
            self.assertEqual(self.ask(own, limit_s=2), b"")
            for one in held:
                one.close()
        self.assertEqual(self.ask_until_answered(own), b"RUOK")

    def zookeeper(self, of_an_address):
        """A ZooKeeper of its own. Returns its address."""
        server = subprocess.Popen(["/usr/bin/python3", SERVERS / "zookeeper.py", "--dir", self.folder / "zookeeper",
                                   "--setting", f"maxClientCnxns={of_an_address}"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        self.addCleanup(server.wait)
        self.addCleanup(server.communicate)
        answer = server.stdout.readline().strip()
        self.assertTrue(answer.startswith("READY zookeeper://"), answer)
        return answer.removeprefix("READY zookeeper://")

    def session(self, port, host):
        """A connection to the registry by the certificate of a host, if ZooKeeper greets it."""
        context = ssl.create_default_context(cafile=self.folder / "ca.pem")
        context.check_hostname = False
        context.load_cert_chain(self.folder / f"{host}.pem", self.folder / f"{host}.key")
        client = context.wrap_socket(socket.create_connection(("127.0.0.1", port), timeout=LIMIT_S))
        self.addCleanup(client.close)
        try:
            client.sendall(HELLO_REGISTRY)
            return client if client.recv(100) else None
        except ConnectionError:
            return None

    def others_get_in_beside_a_thief(self, port):
        """A thief holds many sessions; others, who have the same address for ZooKeeper, get one all the same."""
        self.assertTrue(self.certificate_at(port))
        held = [self.session(port, "gateway-1") for _ in range(MANY)]
        self.assertTrue(self.session(port, "gateway-2"), "others are locked out")
        self.assertTrue(all(held), f"{held.count(None)} of {MANY} sessions of a large fleet are refused")

    def test_the_clusters_registry_has_a_place_for_others_beside_one_who_takes_many(self):
        said = yaml.safe_load((DEPLOY.parent / "docker-compose.yml").read_text())["services"]["zookeeper"]["environment"]
        server, inner = self.zookeeper(str(said.get("ZOO_MAX_CLIENT_CNXNS", USUAL))), free_ports(1)[0]
        self.certs("add", "registry-tls", "gateway-1", "gateway-2")
        self.of_cluster("registry-tls.conf", "registry-tls", {"accept = 2281": f"accept = 127.0.0.1:{inner}", "zookeeper:2181": server})
        self.others_get_in_beside_a_thief(inner)

    def test_the_fleets_registry_has_a_place_for_others_beside_one_who_takes_many(self):
        said = re.findall(r"maxClientCnxns=(\d+)", (DEPLOY / "fleet" / "README.md").read_text())
        server, inner = self.zookeeper(said[0] if said else str(USUAL)), free_ports(1)[0]
        self.certs("add", "gateway-1", "gateway-2")
        text = (DEPLOY / "fleet/registry-tls.conf").read_text()
        for there, here in (("accept = 2281", f"accept = 127.0.0.1:{inner}"), ("connect = 127.0.0.1:2181", f"connect = {server}"),
                            ("/etc/iotcloud", str(self.folder))):
            self.assertIn(there, text)
            text = text.replace(there, here)
        self.stunnel("fleet.conf", text)
        self.others_get_in_beside_a_thief(inner)

    def certificate_at(self, port):
        """The certificate that a server shows, as soon as it shows one: it resets connections while it reads its files."""
        deadline = time.monotonic() + LIMIT_S
        while True:
            try:
                return ssl.get_server_certificate(("127.0.0.1", port))
            except OSError:
                self.assertLess(time.monotonic(), deadline)
                time.sleep(0.05)

    def ask_until_answered(self, port):
        """As ask(), while the tunnel's other end may still be starting."""
        deadline = time.monotonic() + LIMIT_S
        while not (answer := self.ask(port)):
            self.assertLess(time.monotonic(), deadline)
            time.sleep(0.05)
        return answer


if __name__ == "__main__":
    unittest.main(argv=sys.argv[:1])

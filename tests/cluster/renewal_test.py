#!/usr/bin/python3
"""Messages flow through RabbitMQ by TLS while every certificate is renewed, the server's too, and then one is revoked.
Nothing may be lost, every connection has a renewed certificate in the end, and the worker with the revoked one loses its
connections and gets in no more, while the others go on; then it is killed. Each
gateway and the workers have the users of docker-compose.yml, which may do no more than they must.

usage: renewal_test.py BUILD_DIR [--rounds N]
"""

import argparse
import shutil
import socket
import ssl
import subprocess
import sys
import time
from pathlib import Path

from fault_cluster import FaultCluster, finish, wait_for

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "deploy/cluster"))

import cluster as containers  # noqa: E402  (its folder is known now)

HOLDERS = ["gateway-1", "gateway-2", "worker-1", "worker-2"]
SERVER = "localhost"
DRIVERS, RATE = 4, 50
PASSWORD = "sesame"
ROUND_S = 4  # so long messages flow with the certificates of a round


class TlsCluster(FaultCluster):
    """Gateways and workers that speak with RabbitMQ by TLS, with a certificate each."""

    def start(self, **options):
        self.certs = self.work / "certs"
        self.certificates("init", "--host", ",".join([SERVER, *HOLDERS]))
        users = self.work / "users.json"
        users.write_text(containers.rabbitmq_users(dict.fromkeys(containers.RABBITMQ_USERS, PASSWORD)))
        (self.work / "password").write_text(PASSWORD + "\n")
        (self.work / "password").chmod(0o600)
        self.give_server_its_certificate()
        self.url = self.server("rabbitmq", "--tls", "--users", users, "--revocation")
        super().start(brokers=[f"rabbitmq: {{type: rabbitmq, {self.access('{self}', '{self}')}}}"], **options)

    def access(self, name, user):
        reader = (f'properties: {{exchange: {containers.GATEWAYS_EXCHANGE}, reader: "{user}-reads", '
                  f'reader_password_file: "{self.work}/password"}}, ') if user != "workers" else ""
        return (f'urls: ["{self.url}"], user: "{user}", password_file: "{self.work}/password", {reader}'
                f'tls: {{ca: "{self.certs}/ca.pem", certificate: "{self.certs}/{name}.pem", key: "{self.certs}/{name}.key"}}')

    def daemon(self, program, name, configuration, enter=(), options=()):
        of_worker = configuration.replace("{heartbeat: 1s", "{heartbeat: 1s, " + self.access(name, "workers"))
        return super().daemon(program, name, of_worker.replace("{self}", name), enter, options)

    def certificates(self, verb, *words):
        subprocess.run([self.bin / "iotcloud", "certs", verb, self.certs, *words], check=True, capture_output=True, timeout=60)

    def give_server_its_certificate(self):
        """Puts the authority's files where the server's script expects its own (tests/servers/certificates.py)."""
        folder = self.work / "rabbitmq"
        (folder / "revoked").mkdir(parents=True, exist_ok=True)
        for source, target in {"ca.pem": "ca.pem", f"{SERVER}.pem": "server.pem", f"{SERVER}.key": "server.key",
                               "gateway-1.pem": "client.pem", "gateway-1.key": "client.key", "revoked.pem": "revoked/list.pem"}.items():
            shutil.copy(self.certs / source, folder / target)
        subprocess.run(["openssl", "rehash", folder / "revoked"], check=True, capture_output=True, timeout=60)
        (folder / "complete").touch()

    def days(self, name):
        """From when until when a certificate is valid, as RabbitMQ says it."""
        told = subprocess.run(["openssl", "x509", "-in", self.certs / f"{name}.pem", "-noout", "-enddate"], check=True,
                              capture_output=True, text=True).stdout.strip().removeprefix("notAfter=")
        end = time.strptime(told, "%b %d %H:%M:%S %Y %Z")
        return time.strftime("%Y-%m-%dT%H:%M:%SZ", end)

    def connections(self):
        """Users of the server's connections, with holder and end of their certificates."""
        listed = [line.split() for line in self.tell("rabbitmq", "clients").removeprefix("CLIENTS").split(";")]
        # Others have not said who they are.
        return [(words[0], words[1].removeprefix("CN="), words[-1]) for words in listed if len(words) == 5]

    def holders(self):
        """Whose certificates the server's connections have."""
        return {holder for _, holder, _ in self.connections()}

    def renew(self, days):
        """Renews all certificates and makes everybody connect again. Returns when all connections have a renewed one."""
        for name in [SERVER, *HOLDERS]:
            self.certificates("renew", name, "--days", str(days))
        self.give_server_its_certificate()
        self.tell("rabbitmq", "reread")
        known = {self.days(name) for name in HOLDERS}
        users = {"gateway-1", "gateway-1-reads", "gateway-2", "gateway-2-reads", "workers"}

        def all_are_renewed():
            now = self.connections()
            return {user for user, _, _ in now} >= users and {end for _, _, end in now} <= known
        wait_for("all connections have renewed certificates", all_are_renewed)

    def lets_in(self, name):
        """Whether the server speaks with whoever has this certificate."""
        context = ssl.create_default_context(cafile=self.certs / "ca.pem")
        context.load_cert_chain(self.certs / f"{name}.pem", self.certs / f"{name}.key")
        port = int(self.url.rstrip("/").rsplit(":", 1)[1])
        try:
            with socket.create_connection((SERVER, port), timeout=120) as plain, \
                    context.wrap_socket(plain, server_hostname=SERVER) as client:
                client.sendall(b"AMQP\0\0\x09\x01")
                return client.recv(1) == b"\x01"
        except (ssl.SSLError, ConnectionError):
            return False


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("build")
    parser.add_argument("--rounds", type=int, default=1)
    given = parser.parse_args()
    with TlsCluster(given.build, "renewal") as cluster:
        cluster.start(gateways=2)
        workers = [cluster.worker() for _ in range(2)]
        cluster.wait_until_ready()
        cluster.wait_for_workers(2)
        cluster.drivers(DRIVERS, (given.rounds * 2 + 2) * ROUND_S * RATE, RATE)
        cluster.wait_until_all_read()
        for number in range(given.rounds):
            cluster.renew(20 + number)
            time.sleep(ROUND_S)  # under load
        if not cluster.lets_in("worker-2"):
            sys.exit("worker-2 does not get in with its renewed certificate")
        wait_for("everybody has a connection", lambda: cluster.holders() == set(HOLDERS))
        said = len(cluster.log("worker-2").read_text())
        cluster.certificates("revoke", "worker-2")
        cluster.give_server_its_certificate()
        cluster.tell("rabbitmq", "reread")
        wait_for("worker-2 has lost its connection and gets no other one", lambda: "the server does not take this client's certificate" in
                 cluster.log("worker-2").read_text()[said:])
        wait_for("all others have connections again", lambda: cluster.holders() >= set(HOLDERS) - {"worker-2"})
        cluster.require_alive()  # worker-2 was cut off by nothing but the revocation
        if "worker-2" in cluster.holders() or cluster.lets_in("worker-2"):
            sys.exit("who has the revoked certificate gets in")
        if not cluster.lets_in("worker-1"):
            sys.exit("worker-1, whose certificate is good, does not get in")
        cluster.kill(workers[1])  # what it read is read elsewhere
        totals = cluster.totals(120 + given.rounds * 2 * ROUND_S)
        print(f"{given.rounds} renewals of {len(HOLDERS) + 1} certificates, and one revoked", flush=True)
    finish("renewal", totals)


if __name__ == "__main__":
    main()

#!/usr/bin/python3
"""A private Redis for tests, on loopback only, that leaves nothing behind.

    redis.py --dir DIR [--port N] [--tls] [--appendonly no] [--cluster]

Runs one server with its data and log below DIR. It writes each command to its log on the disk before it answers
(appendfsync always); with `--appendonly no` it keeps no log. With --cluster it is a node of a Redis Cluster. When it takes commands it prints one line on stdout:

    READY redis://127.0.0.1:PORT

Then it obeys one command for each line of stdin and answers with one line on stdout:

    kill           SIGKILL                                     KILLED
    start          starts it again, same port and data         READY redis://...
    pause          SIGSTOP: it hangs                           PAUSED
    resume         SIGCONT                                     RESUMED
    follow PORT    becomes a replica of that server, and has   FOLLOWING
                   all that it has
    lead           becomes a master, with what it has          LEADS
    policy NAME    maxmemory-policy                            POLICY
    stop           ends everything                             STOPPED

The end of stdin means `stop`. A command that fails answers `ERROR text`.

With --tls the URL is rediss://USER@localhost:PORT: the server wants a client certificate, and the ACL user of
certificates.py, who has the rights that topology/state/README.md lists.
"""
import hashlib
import time

import certificates
import private_server

RIGHTS = "~iotcloud:state:* +eval +hset +hget +hmget +hdel +pexpire +persist +info"
FOLLOW_LIMIT_S = 120


class Redis(private_server.Server):
    name = "Redis"

    def __init__(self, folder, port=0, tls=False, appendonly="yes", cluster=False):
        super().__init__(folder)
        self.port = port or private_server.free_ports(1)[0]
        if tls:
            self.certificates = certificates.Certificates(self.folder)
        self.config = self.write("redis.conf", [
            "bind 127.0.0.1", "dir " + self.folder, "daemonize no", 'save ""', "appendonly " + appendonly,
            "appendfsync always", "repl-diskless-sync-delay 0", *(self.security() if tls else ["port %d" % self.port]),
            *(["cluster-enabled yes", "cluster-port %d" % private_server.free_ports(1)[0]] if cluster else [])])

    def security(self):
        path = self.certificates.path
        secret = hashlib.sha256(certificates.PASSWORD.encode()).hexdigest()
        return ["port 0", "tls-port %d" % self.port, "tls-ca-cert-file " + path("ca.pem"),
                "tls-cert-file " + path("server.pem"), "tls-key-file " + path("server.key"), "tls-auth-clients yes",
                "user default off", "user %s on #%s %s" % (certificates.USER, secret, RIGHTS)]

    def command(self):
        return ["redis-server", self.config]

    def url(self):
        if self.certificates:
            return "rediss://%s@localhost:%d" % (certificates.USER, self.port)
        return "redis://127.0.0.1:%d" % self.port

    def ask(self, line):
        """The first line of the answer to an inline command, or all of INFO's."""
        with self.connect(self.port) as connection:
            connection.settimeout(60)
            connection.sendall(line.encode() + b"\r\n")
            with connection.makefile("rb") as answers:
                first = answers.readline().decode().strip()
                return answers.read(int(first[1:])).decode() if first.startswith("$") else first

    def answers(self):
        return self.ask("PING").startswith(("+PONG", "-NOAUTH"))

    def expect_ok(self, line):
        answer = self.ask(line)
        if answer != "+OK":
            raise RuntimeError("%s: %s" % (line, answer))

    def follow(self, port):
        self.expect_ok("REPLICAOF 127.0.0.1 " + port)
        limit = time.monotonic() + FOLLOW_LIMIT_S
        while "master_link_status:up" not in self.ask("INFO replication"):
            if time.monotonic() > limit:
                raise RuntimeError("it did not get the data of port %s" % port)
            time.sleep(0.02)
        return "FOLLOWING"

    def lead(self):
        self.expect_ok("REPLICAOF NO ONE")
        return "LEADS"

    def policy(self, name):
        self.expect_ok("CONFIG SET maxmemory-policy " + name)
        return "POLICY"

    def commands(self):
        return {**super().commands(), "follow": self.follow, "lead": self.lead, "policy": self.policy}


def main():
    parser = private_server.options("A private Redis")
    private_server.add_client_options(parser)
    parser.add_argument("--appendonly", choices=("yes", "no"), default="yes", help="no: a restart forgets everything")
    parser.add_argument("--cluster", action="store_true", help="a node of a Redis Cluster")
    given = parser.parse_args()
    private_server.run(lambda: Redis(given.dir, given.port, given.tls, given.appendonly, given.cluster))


if __name__ == "__main__":
    main()

#!/usr/bin/python3
"""A private Mosquitto (MQTT 3.1.1 and 5) for tests, on loopback only, that leaves nothing behind.

    mosquitto.py --dir DIR [--port N] [--tls] [--throughput]

When it takes connections it prints one line on stdout:

    READY mqtt://127.0.0.1:PORT

Then it obeys one command for each line of stdin and answers with one line on stdout:

    kill           SIGKILL                                     KILLED
    start          starts it again, same port                  READY mqtt://...
    pause          SIGSTOP: it hangs                           PAUSED
    resume         SIGCONT                                     RESUMED
    stop           ends everything                             STOPPED

The end of stdin means `stop`. A command that fails answers `ERROR text`. It keeps sessions on disk, so that a restart knows them, and
writes all of it whenever something changed, such as by a message that is acknowledged. With --throughput it keeps nothing on disk.

With --tls the URL is mqtts://localhost:PORT: the server wants a client certificate, and the user of certificates.py.
"""
import os

import certificates
import private_server

CONNECT = b"\x10\x10\x00\x04MQTT\x04\x02\x00\x3c\x00\x04test"


class Mosquitto(private_server.Server):
    name = "Mosquitto"

    def __init__(self, folder, port=0, tls=False, on_disk=True):
        super().__init__(folder)
        self.port = port or private_server.free_ports(1)[0]
        if tls:
            self.certificates = certificates.Certificates(self.folder)
            self.certificates.run("mosquitto_passwd", "-b", "-c", "users", certificates.USER, certificates.PASSWORD)
        self.config = self.write("mosquitto.conf", [
            "listener %d 127.0.0.1" % self.port, *(self.security() if tls else ["allow_anonymous true"]),
            *(self.persistence() if on_disk else []), "max_queued_messages 0", "log_dest stdout", *(["user root"] if os.getuid() == 0 else [])])

    def persistence(self):
        return ["persistence true", "persistence_location %s/" % self.folder, "autosave_on_changes true", "autosave_interval 1"]

    def security(self):
        path = self.certificates.path
        return ["allow_anonymous false", "password_file " + path("users"), "cafile " + path("ca.pem"),
                "certfile " + path("server.pem"), "keyfile " + path("server.key"), "require_certificate true"]

    def command(self):
        return ["/usr/sbin/mosquitto", "-c", self.config]

    def url(self):
        return "mqtts://localhost:%d" % self.port if self.certificates else "mqtt://127.0.0.1:%d" % self.port

    def answers(self):
        with self.connect(self.port) as connection:
            connection.settimeout(60)
            connection.sendall(CONNECT)
            return connection.recv(1) == b"\x20"


def main():
    parser = private_server.options("A private Mosquitto")
    private_server.add_client_options(parser)
    parser.add_argument("--throughput", action="store_true", help="for benchmarks: nothing is kept on disk")
    given = parser.parse_args()
    private_server.run(lambda: Mosquitto(given.dir, given.port, given.tls, on_disk=not given.throughput))


if __name__ == "__main__":
    main()

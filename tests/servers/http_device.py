#!/usr/bin/python3
"""A private HTTP server that plays a device in tests, on loopback only: Python's own http.server.

    http_device.py --dir DIR [--port N] [--tls]

When it takes connections it prints one line on stdout:

    READY http://127.0.0.1:PORT

Then it obeys one command for each line of stdin and answers with one line on stdout:

    kill           SIGKILL                                     KILLED
    start          starts it again, same port                  READY http://...
    pause          SIGSTOP: it hangs                           PAUSED
    resume         SIGCONT                                     RESUMED
    stop           ends everything                             STOPPED

The end of stdin means `stop`. A command that fails answers `ERROR text`. Each request adds a line to the file `requests` in
DIR: method, path, content type, authorization and body. The answer to /status/404 has that status; /large answers a million
bytes. With --tls the URL is https://localhost:PORT, and clients need no certificate.
"""
import http.server
import ssl
import sys

import certificates
import private_server


class Device(http.server.BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def do_POST(self):
        body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
        words = [self.command, self.path, self.headers.get("Content-Type", "-"), self.headers.get("Authorization", "-"),
                 body.decode("latin-1")]
        if self.path != "/ready":
            with open("requests", "a", encoding="latin-1") as log:
                log.write(" ".join(words) + "\n")
        answer = b"x" * 1000000 if self.path == "/large" else b"took " + body
        self.send_response(int(self.path.rpartition("/")[2]) if "/status/" in self.path else 200)
        self.send_header("Content-Length", str(len(answer)))
        self.send_header("Content-Type", "text/plain")
        self.end_headers()
        self.wfile.write(answer)

    do_GET = do_PUT = do_DELETE = do_POST

    def log_message(self, *_):
        pass


class HttpDevice(private_server.Server):
    name = "the HTTP device"

    def __init__(self, folder, port=0, tls=False):
        super().__init__(folder)
        self.port = port or private_server.free_ports(1)[0]
        if tls:
            self.certificates = certificates.Certificates(self.folder)

    def command(self):
        return [sys.executable, __file__, "--serve", str(self.port), "tls" if self.certificates else "plain"]

    def url(self):
        return ("https://localhost:%d" if self.certificates else "http://127.0.0.1:%d") % self.port

    def answers(self):
        with self.connect(self.port) as connection:
            connection.settimeout(60)
            connection.sendall(b"GET /ready HTTP/1.1\r\nHost: x\r\nConnection: close\r\n\r\n")
            return connection.recv(4) == b"HTTP"


def serve(port, tls):
    server = http.server.ThreadingHTTPServer(("127.0.0.1", port), Device)
    if tls:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain("server.pem", "server.key")
        server.socket = context.wrap_socket(server.socket, server_side=True)
    server.serve_forever()


def main():
    if sys.argv[1] == "--serve":
        return serve(int(sys.argv[2]), sys.argv[3] == "tls")
    parser = private_server.options("An HTTP device")
    private_server.add_client_options(parser)
    given = parser.parse_args()
    return private_server.run(lambda: HttpDevice(given.dir, given.port, given.tls))


if __name__ == "__main__":
    main()

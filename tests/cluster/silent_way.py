"""A way between a client and a server, on loopback, that can go silent as a cut network does: nothing passes, and nobody
is told. What was sent meanwhile arrives when it is open again, as TCP would have it.
"""

import socket
import threading


class SilentWay:
    def __init__(self, server):
        """server: host:port"""
        host, port = server.rsplit(":", 1)
        self.server = (host, int(port))
        self.open = threading.Event()
        self.open.set()
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.address = "127.0.0.1:%d" % self.listener.getsockname()[1]
        threading.Thread(target=self.accept, daemon=True).start()

    def cut(self):
        self.open.clear()

    def mend(self):
        self.open.set()

    def accept(self):
        while True:
            client, _ = self.listener.accept()
            threading.Thread(target=self.connect, args=(client,), daemon=True).start()

    def connect(self, client):
        self.open.wait()
        try:
            server = socket.create_connection(self.server, timeout=5)
        except OSError:
            client.close()
            return
        server.settimeout(None)
        for source, target in ((client, server), (server, client)):
            threading.Thread(target=self.carry, args=(source, target), daemon=True).start()

    def carry(self, source, target):
        """Bytes one way, until either side ends; the end, too, is not told while the way is cut."""
        try:
            while data := source.recv(65536):
                self.open.wait()
                target.sendall(data)
        except OSError:
            pass  # one side is gone: so is the other
        self.open.wait()
        for end in (source, target):
            try:
                end.shutdown(socket.SHUT_RDWR)
            except OSError:
                pass  # it is shut down already

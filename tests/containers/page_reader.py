#!/usr/bin/python3
"""Reads a daemon's page over one connection, again and again, until the connection is cut.

usage: page_reader.py SECRETS SERVICE ADDRESS PORT

SECRETS is a folder with ca.pem, host.pem, host.key and a token (prometheus.token), SERVICE the name in the daemon's certificate.
Prints `reading` after the first answer, then `cut` when the daemon ends the connection, `answered STATUS` when the status is another
than 200, and `failed: WHY` when the daemon is not reached or is not the one that was meant.
"""

import http.client
import ssl
import sys
import time
from pathlib import Path

PAUSE_S = 0.2
# How a connection ends that the other side closes, with TLS' alert or without.
CUTS = (ssl.SSLError, ConnectionResetError, BrokenPipeError)


class PageConnection(http.client.HTTPSConnection):
    """To a service's address, with a certificate for its name."""

    def __init__(self, address, port, service, context):
        super().__init__(address, port, timeout=30, context=context)
        self.service, self.context = service, context

    def connect(self):
        http.client.HTTPConnection.connect(self)
        self.sock = self.context.wrap_socket(self.sock, server_hostname=self.service)


def main():
    secrets, service, address, port = Path(sys.argv[1]), sys.argv[2], sys.argv[3], int(sys.argv[4])
    context = ssl.create_default_context(cafile=secrets / "ca.pem")
    context.load_cert_chain(secrets / "host.pem", secrets / "host.key")
    token = (secrets / "prometheus.token").read_text(encoding="utf-8").strip()
    connection = PageConnection(address, port, service, context)
    connection.auto_open = 0  # one connection
    told = False
    try:
        connection.connect()
        while True:
            connection.request("GET", "/metrics", headers={"Authorization": f"Bearer {token}"})
            answer = connection.getresponse()
            answer.read()
            if answer.status != 200:
                print(f"answered {answer.status}", flush=True)
                return
            if not told:
                print("reading", flush=True)
            told = True
            time.sleep(PAUSE_S)
    except (OSError, http.client.HTTPException) as error:
        cut = isinstance(error, CUTS) and not isinstance(error, ssl.SSLCertVerificationError)
        print("cut" if cut else f"failed: {error!r}", flush=True)


if __name__ == "__main__":
    main()

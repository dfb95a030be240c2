"""A throw-away certificate authority for one private server, and the user that the server lets in.

The server's certificate is for `localhost` (and 127.0.0.1): clients must connect to the name, because host name checks
of some libraries know no addresses.
"""
import os
import ssl
import subprocess

import private_server

USER = "iotcloud"
PASSWORD = "secret with %: chars"  # with characters that a URL or a configuration file must quote
STORE_PASSWORD = "iotcloud"        # of the Java key stores


class Certificates:
    """ca.pem, server.pem, server.key, client.pem and client.key in `folder`; made when they are not there yet."""

    def __init__(self, folder):
        self.folder = folder
        if not os.path.exists(self.path("complete")):
            self.make_authority()
            self.make("server", "DNS:localhost,IP:127.0.0.1", "serverAuth,clientAuth")
            self.make("client", "DNS:client", "clientAuth")
            with open(self.path("complete"), "w", encoding="ascii"):
                pass

    def path(self, name):
        return os.path.join(self.folder, name)

    def run(self, *command):
        done = subprocess.run(command, cwd=self.folder, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                              stderr=subprocess.STDOUT, text=True, timeout=60,
                              preexec_fn=private_server.become_child)
        if done.returncode:
            raise RuntimeError("%s failed: %s" % (command[0], done.stdout))

    def request(self, name, *options, subject=""):
        self.run("openssl", "req", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-nodes",
                 "-keyout", name + ".key", "-subj", "/CN=" + (subject or name), *options)

    def make_authority(self):
        # In one file of revocations each authority needs a name of its own.
        self.request("ca", "-x509", "-days", "2", "-out", "ca.pem", "-addext", "keyUsage=critical,keyCertSign,cRLSign",
                     subject="ca of " + os.path.basename(self.folder))

    def make(self, name, names, usage):
        self.request(name, "-out", name + ".csr")
        with open(self.path(name + ".ext"), "w", encoding="ascii") as file:
            file.write("subjectAltName=%s\nextendedKeyUsage=%s\nkeyUsage=digitalSignature\n" % (names, usage))
        self.run("openssl", "x509", "-req", "-in", name + ".csr", "-CA", "ca.pem", "-CAkey", "ca.key",
                 "-CAcreateserial", "-days", "2", "-extfile", name + ".ext", "-out", name + ".pem")

    def revoke(self, *names):
        """revoked.pem: the authority's list, with the certificates of these and no others on it."""
        self.write("index.txt", "")
        self.write("list.cnf", "[ca]\ndefault_ca=list\n[list]\ndatabase=index.txt\ndefault_md=sha256\n"
                   "default_crl_days=2\n")
        authority = ["openssl", "ca", "-config", "list.cnf", "-cert", "ca.pem", "-keyfile", "ca.key"]
        for name in names:
            self.run(*authority, "-revoke", name + ".pem")
        self.run(*authority, "-gencrl", "-out", "revoked.new")
        os.replace(self.path("revoked.new"), self.path("revoked.pem"))

    def write(self, name, text):
        with open(self.path(name), "w", encoding="ascii") as file:
            file.write(text)

    def key_store(self):
        """PKCS #12 with the server's key; its password is STORE_PASSWORD."""
        self.run("openssl", "pkcs12", "-export", "-in", "server.pem", "-inkey", "server.key", "-certfile", "ca.pem",
                 "-name", "server", "-out", "server.p12", "-passout", "pass:" + STORE_PASSWORD)
        return self.path("server.p12")

    def trust_store(self):
        """PKCS #12 with the authority, marked as trusted as only keytool can."""
        if not os.path.exists(self.path("trust.p12")):
            self.run("keytool", "-importcert", "-noprompt", "-alias", "ca", "-file", "ca.pem", "-storetype", "PKCS12",
                     "-keystore", "trust.p12", "-storepass", STORE_PASSWORD)
        return self.path("trust.p12")

    def server_chain(self):
        """Key and certificates in one file, as Kafka reads them."""
        with open(self.path("server.all.pem"), "w", encoding="ascii") as all_of_it:
            for name in ("server.key", "server.pem", "ca.pem"):
                with open(self.path(name), encoding="ascii") as file:
                    all_of_it.write(file.read())
        return self.path("server.all.pem")

    def client_context(self):
        """The credentials of a client that the server accepts, for Python's ssl."""
        context = ssl.create_default_context(cafile=self.path("ca.pem"))
        context.load_cert_chain(self.path("client.pem"), self.path("client.key"))
        return context

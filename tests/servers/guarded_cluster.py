"""Private clusters whose master is reached by TLS and a token only."""
import socket
import subprocess

from private_cluster import PrivateCluster, require

HOST = socket.gethostname()


class GuardedCluster(PrivateCluster):
    """The master asks for certificates of the authority in out/certs and for tokens: anna is an admin, vera a viewer.
    Other daemons have the certificate of this machine's name."""

    of_api = ""  # more of the master's section `api`; {out} is the folder

    def iotcloud(self, *words):
        done = subprocess.run([self.bin / "iotcloud", *map(str, words)], capture_output=True, text=True, timeout=60)
        require(done.returncode == 0, done)
        return done.stdout

    def token(self, who, kind, *words):
        """Makes a token in out/WHO.token, which counts where out/KIND is the token file."""
        (self.out / f"{who}.token").write_text(self.iotcloud("token", "add", who, *words, "--file", self.out / kind))

    def make_secrets(self):
        self.certs = self.out / "certs"
        self.iotcloud("certs", "init", self.certs, "--host", f"lab1,{HOST}")
        for who, role in (("anna", "admin"), ("vera", "viewer")):
            self.token(who, "people", "--role", role)

    def guarded(self, host, tokens):
        files = f'ca: "{self.certs}/ca.pem", certificate: "{self.certs}/{host}.pem", key: "{self.certs}/{host}.key"'
        return f'tls: {{{files}}}, tokens: "{self.out}/{tokens}"'

    def daemon(self, program, name, configuration, **more):
        if name == "master":
            of_api = self.of_api.replace("{out}", str(self.out))
            configuration = configuration.replace("api: {", f"api: {{{self.guarded('lab1', 'people')}, {of_api}, ")
        return super().daemon(program, name, configuration, **more)

    def run_as(self, who, *words, limit=120):
        operator = self.certs / "operator"
        return super().run_cli("--ca", self.certs / "ca.pem", "--certificate", f"{operator}.pem", "--key", f"{operator}.key",
                               "--token-file", self.out / f"{who}.token", *words, limit=limit)

    def run_cli(self, *words, limit=120):
        return self.run_as("anna", *words, limit=limit)

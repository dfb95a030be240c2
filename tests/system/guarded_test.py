#!/usr/bin/python3
"""A plugin is sent to gateways that ask for TLS, tokens and signatures, with the commands of the pages: it comes up where
it is signed by a trusted key and sent by an admin. Everything else is attempted and refused, and printed.

usage: guarded_test.py BUILD_DIR
"""

import hashlib
import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent.parent
sys.path[:0] = [str(HERE.parent / folder) for folder in ("servers", "cluster")]

from master_api import compile_idl  # noqa: E402
from private_cluster import PrivateCluster, StartError, answer_of, require, wait_for  # noqa: E402

BOTH = ["gateway-1", "gateway-2"]
PIECE = 512 * 1024
HOSTS = {"master": "lab1", "gateway-1": "gateway-1", "gateway-2": "gateway-2"}  # whose certificate each daemon has


def page_lines(file, *beginnings):
    """The commands of a page that begin so, as they are printed there."""
    lines = [line.strip() for line in (ROOT / file).read_text().splitlines()]
    found = [next((line for line in lines if line.startswith(beginning)), None) for beginning in beginnings]
    require(None not in found, f"{file} has no lines {beginnings}: {found}")
    return found


class GuardedCluster(PrivateCluster):
    """Master and gateways ask for certificates of the authority in out/certs and for tokens: the master for those of
    out/tokens, a gateway for those of out/NAME.tokens."""

    def guarded(self, name):
        host = self.out / "certs" / HOSTS[name]
        return (f'tls: {{ca: "{self.out}/certs/ca.pem", certificate: "{host}.pem", key: "{host}.key"}}, '
                f'tokens: "{self.out}/{"" if name == "master" else name + "."}tokens", ')

    def daemon(self, program, name, configuration, **more):
        if name == "master":
            token = f'gateway_token_file: "{self.out}/{{gateway}}.token", '
            configuration = configuration.replace("api: {", "api: {" + self.guarded(name) + token)
        else:
            configuration = configuration.replace("thrift: {", "thrift: {" + self.guarded(name))
        return super().daemon(program, name, configuration, **more)

    def shell(self, line, folder=None):
        """Runs a printed command in the folder. Raises StartError when it fails."""
        path = {**os.environ, "PATH": f"{self.bin}:{os.environ['PATH']}"}
        done = subprocess.run(["/bin/bash", "-c", line], cwd=folder or self.out, env=path, capture_output=True, text=True,
                              timeout=60)
        if done.returncode:
            raise StartError(f"{line}: {done.stderr or done.stdout}")
        return done.stdout

    def access(self, who):
        certs = self.out / "certs"
        return ["--ca", certs / "ca.pem", "--certificate", certs / "operator.pem", "--key", certs / "operator.key",
                "--token-file", self.out / f"{who}.token"]

    def run_as(self, who, *words):
        return super().run_cli(*self.access(who), *words)

    def run_cli(self, *words, limit=120):
        return super().run_cli(*self.access("anna"), *words, limit=limit)

    def token(self, who):
        return (self.out / f"{who}.token").read_text().strip()

    def plugin(self, name):
        """Another file of the same driver: nobody reads what stands behind the end of a library."""
        file = self.out / name
        file.write_bytes((self.plugins / "loadgen.so").read_bytes() + name.encode())
        return file


def refused(what, text, *expected):
    """What somebody attempted came to nothing, and the answer says these words."""
    for words in expected:
        require(words in text, f"{what}: \"{words}\" is not in: {text}")
    print(f"refused: {what}: {next(line for line in text.splitlines() if expected[0] in line).strip()}")


def check_first_steps(cluster):
    """From nothing to a key, certificates and tokens, as the pages say."""
    certificates, first_token, masters_token = page_lines(
        "master/README.md", "iotcloud certs init", "iotcloud token add anna", "iotcloud token add master")
    cluster.shell(certificates)
    cluster.shell("iotcloud certs add certs --host gateway-1,gateway-2")
    cluster.shell(first_token)
    for who, role in (("otto", "operator"), ("vera", "viewer")):
        cluster.shell(f"iotcloud token add {who} --role {role} --file tokens > {who}.token")
    for gateway in BOTH:  # the same people may call them
        shutil.copy(cluster.out / "tokens", cluster.out / f"{gateway}.tokens")
        cluster.shell(masters_token.replace("gateway-1", gateway))
    cluster.plugin("thermometer.so")
    cluster.shell(*page_lines("docs/running.md", "iotcloud keys new"))


def check_first_call(cluster):
    """The printed call, in a folder with what an operator is given. Only the port is another one."""
    line, = page_lines("master/README.md", "iotcloud --master lab1:12904")
    folder = cluster.out / "anna"
    folder.mkdir()
    for file in ("certs/ca.pem", "certs/operator.pem", "certs/operator.key", "anna.token"):
        shutil.copy(cluster.out / file, folder)
    answer = cluster.shell(line.replace("lab1:12904", f"localhost:{cluster.api_port}"), folder)
    require("2 ready" in answer, answer)


def check_deployment(cluster):
    line, = page_lines("docs/running.md", "iotcloud deploy --plugin ./thermometer.so --all")
    line = line.split("#")[0].replace("iotcloud ", "")
    os.chdir(cluster.out)  # it names the file with ./
    done = cluster.run_cli(*line.split(), "--property", "rate=20")
    require(done.returncode == 0, done)
    drivers = cluster.json("drivers")
    sha256 = hashlib.sha256((cluster.out / "thermometer.so").read_bytes()).hexdigest()
    require(sorted(driver["gateway"] for driver in drivers) == BOTH, drivers)
    for driver in drivers:
        require(driver["state"] == "active" and driver["plugin"]["sha256"] == sha256, driver)
        described = answer_of("the instance is described", lambda one=driver["instance"]: cluster.cli("describe", one))
        require("signed by lab" in described, described)
    print(f"iotcloud {line.strip()}: active on {' and '.join(BOTH)}, signed by lab")
    return [driver["instance"] for driver in drivers]


def check_signatures(cluster):
    unsigned = cluster.plugin("unsigned.so")
    done = cluster.run_cli("deploy", "--plugin", unsigned, "--all")
    require(done.returncode == 1, done)
    refused("an admin deploys what is not signed", done.stdout, "unsigned.so is not signed", *BOTH)

    foreign = cluster.plugin("foreign.so")
    cluster.shell("iotcloud keys new stranger && iotcloud sign foreign.so --key stranger.key")
    done = cluster.run_cli("deploy", "--plugin", foreign, "--all")
    require(done.returncode == 1, done)
    refused("an admin deploys what a stranger signed", done.stdout,
            "foreign.so: its signature is not one of these bytes by a key that is trusted here", *BOTH)

    done = cluster.run_cli("deploy", "loadgen.so", "--all")  # of the gateways' own folders
    require(done.returncode == 1, done)
    refused("an admin deploys a file of the gateways' folders that is not signed", done.stdout,
            "loadgen.so is not signed", *BOTH)
    cluster.cli("undeploy", "--state", "failed")


def check_roles(cluster, instances):
    file = cluster.out / "thermometer.so"
    for who, role in (("otto", "operator"), ("vera", "viewer")):
        for words in (["deploy", "--plugin", file, "--all"], ["update", "--plugin", file, *instances],
                      ["deploy", "thermometer.so", "--all"], ["undeploy", *instances]):
            done = cluster.run_as(who, *words)
            require(done.returncode == 1, done)
            refused(f"{who} says {words[0]}", done.stderr, f"{who} is {role}, and ", "takes admin")
        require(cluster.run_as(who, "drivers").returncode == 0, f"{who} may not read")
    for verb in ("stop", "start"):
        require(cluster.run_as("otto", verb, instances[0]).returncode == 0, f"an operator may not {verb}")
        done = cluster.run_as("vera", verb, instances[0])
        require(done.returncode == 1, done)
        refused(f"vera says {verb}", done.stderr, f"vera is viewer, and {verb} takes operator")
    by_hand = ["channel", "publish", instances[0], "echo", "by hand"]
    wait_for("an operator publishes", lambda: "its driver has handled" in cluster.run_as("otto", *by_hand).stdout)
    done = cluster.run_as("vera", *by_hand)
    require(done.returncode == 1, done)
    refused("vera says channel publish", done.stderr, "vera is viewer, and handMessage takes operator")
    (cluster.out / "nobody.token").write_text("nobody.0123456789\n")
    done = cluster.run_as("nobody", "drivers")
    require(done.returncode != 0, done)
    refused("nobody's token", done.stderr, "nobody's token")


class Pieces:
    """Somebody who sends a plugin's pieces to gateway-1 without a master; with the certificate, or without one."""

    def __init__(self, cluster, certificate="operator"):
        from gateway import TSensorSiteService
        from thrift.protocol import TBinaryProtocol
        from thrift.transport import TSSLSocket, TTransport

        certs = cluster.out / "certs"
        shown = {"certfile": str(certs / f"{certificate}.pem"), "keyfile": str(certs / f"{certificate}.key")}
        socket = TSSLSocket.TSSLSocket("localhost", cluster.thrift_ports["gateway-1"], ca_certs=str(certs / "ca.pem"),
                                       **(shown if certificate else {}))
        socket.setTimeout(60_000)
        self.transport = TTransport.TFramedTransport(socket)
        self.client = TSensorSiteService.Client(TBinaryProtocol.TBinaryProtocol(self.transport))

    def __enter__(self):
        self.transport.open()
        return self.client

    def __exit__(self, *_):
        self.transport.close()


def offer_of(file):
    from gateway.ttypes import TPluginOffer

    content = file.read_bytes()
    return TPluginOffer(plugin=file.name, sha256=hashlib.sha256(content).hexdigest(), size=len(content),
                        signature=Path(f"{file}.sig").read_bytes())


def error_of(call, *words):
    """Why a gateway did not do it. It has a text, or the connection ends."""
    from gateway.ttypes import TSiteError
    from thrift.transport.TTransport import TTransportException

    try:
        call(*words)
    except TSiteError as error:
        return error.reason
    except (TTransportException, OSError) as error:
        return f"the connection ends: {error}"
    sys.exit(f"wrong: a gateway answered {call.__name__}{words[1:]}")


def check_pieces(cluster):
    """A plugin that is signed by a trusted key, and everybody who may not send it."""
    file = cluster.plugin("pieces.so")
    cluster.shell("iotcloud sign pieces.so --key lab.key")
    with Pieces(cluster) as client:
        for call, words in ((client.offerPlugin, [offer_of(file)]), (client.sendPlugin, ["0a1b", 0, b"bytes"]),
                            (client.finishPlugin, ["0a1b"])):
            refused(f"{call.__name__} at a gateway without a token", error_of(call, *words), "this service asks for a token")
    for who, role in (("otto", "operator"), ("vera", "viewer")):
        with Pieces(cluster) as client:
            require(client.authenticate(cluster.token(who)).state == 0, who)
            refused(f"offerPlugin at a gateway by {who}", error_of(client.offerPlugin, offer_of(file)),
                    f"{who} is {role}, and offerPlugin takes admin")
    with Pieces(cluster) as client:  # the pieces of another's upload take the role too
        require(client.authenticate(cluster.token("anna")).state == 0, "anna")
        upload, content = client.offerPlugin(offer_of(file)), file.read_bytes()
        with Pieces(cluster) as stranger:
            refused("sendPlugin into anna's upload without a token", error_of(stranger.sendPlugin, upload, 0, content[:99]),
                    "this service asks for a token")
            refused("finishPlugin of anna's upload without a token", error_of(stranger.finishPlugin, upload),
                    "this service asks for a token")
        for offset in range(0, len(content), PIECE):
            client.sendPlugin(upload, offset, content[offset:offset + PIECE])
        client.finishPlugin(upload)  # it noticed nothing of them

    def without_certificate():
        with Pieces(cluster, certificate=None) as client:
            client.authenticate(cluster.token("anna"))

    refused("a connection to a gateway without a certificate", error_of(without_certificate), "the connection ends")
    log = cluster.log("gateway-1").read_text()
    for text in ("offerPlugin of 127.0.0.1:", "otto is operator, and offerPlugin takes admin"):
        require(text in log, f"gateway-1's log does not say: {text}")


def check_stolen_gateway(cluster):
    """Whoever has gateway-2, and has heard what a master showed to gateway-1, gets in nowhere with it."""
    done = cluster.run_as("gateway-1", "drivers")
    require(done.returncode != 0, done)
    refused("a master's token for a gateway, at the master", done.stderr, "nobody's token")
    for gateway in BOTH:
        with Pieces(cluster, certificate="gateway-2") as client:
            answer = client.authenticate(cluster.token(gateway))
            require(answer.state == 1, f"{gateway}'s thief got in")
            refused(f"what the master shows to {gateway}, with another certificate", answer.statusMessage,
                    "only with another certificate")


def check_audit(cluster):
    """Who did what, and who was not let, with what became of it."""
    lines = [json.loads(line) for line in (cluster.out / "audit.log").read_text().splitlines()]

    def told(**wanted):
        return [line for line in lines if all(line[key] == value for key, value in wanted.items())]

    done = told(who="anna", role="admin", order="deploy", refused=False)
    require(any("thermometer.so" in line["what"] and "done" in line["outcome"] for line in done), done)
    sent = told(who="anna", order="offerPlugin", refused=False)
    for file in ("thermometer.so", "unsigned.so", "foreign.so"):
        require(any(file in line["what"] for line in sent), f"the audit log does not say that anna offered {file}: {sent}")
    for who, role in (("otto", "operator"), ("vera", "viewer")):
        for order in ("offerPlugin", "deploy", "undeploy"):
            require(told(who=who, role=role, order=order, refused=True), f"the audit log does not say {who}'s {order}")
            require(not told(who=who, order=order, refused=False), f"{who} may {order}")
    require(told(who="otto", order="stop", refused=False) and told(who="vera", order="stop", refused=True),
            "the audit log does not say who stopped")
    by_hand = told(who="otto", role="operator", order="handMessage", event="ended", refused=False)
    require(by_hand and by_hand[-1]["outcome"] == "done" and "7 bytes for channel echo of" in by_hand[-1]["what"],
            f"the audit log does not say what otto published: {by_hand}")
    require(told(who="vera", order="handMessage", refused=True) and not told(who="vera", order="handMessage", refused=False),
            "the audit log does not say that vera may not publish")
    require(told(who="", order="authenticate", refused=True), "the audit log does not say nobody's token")
    require(all(line["certificate"] for line in lines), "the audit log does not name the certificates")
    print("the audit log:")
    for line in lines:
        print(f"  {line['who'] or 'somebody'} ({line['role']}): {line['order']} {line['what']}: "
              f"{'refused: ' if line['refused'] else ''}{line['outcome']}")


def main():
    build = Path(sys.argv[1]).resolve()
    work = build / "guarded-test"
    shutil.rmtree(work, ignore_errors=True)
    shared = work / "plugins"  # the gateways' folder
    shared.mkdir(parents=True)
    shutil.copy(build / "plugins" / "loadgen.so", shared)
    compile_idl(build, "gateway")
    with GuardedCluster(work, build / "bin", shared) as cluster:
        check_first_steps(cluster)
        cluster.start(gateways=2, of_masters=f'audit: {{file: "{work}/audit.log"}}',
                      more=f'plugins.require_signature: true\nplugins.trusted_keys: ["{work}/lab.pub"]')
        cluster.wait_until_ready()
        check_first_call(cluster)
        instances = check_deployment(cluster)
        check_signatures(cluster)
        check_roles(cluster, instances)
        check_pieces(cluster)
        check_stolen_gateway(cluster)
        states = {driver["instance"]: driver["state"] for driver in cluster.json("drivers")}
        require(states == {instance: "active" for instance in instances}, f"something else runs now: {states}")
        check_audit(cluster)
        cluster.undeploy_all()
        cluster.require_alive()
    print("a plugin was sent over TLS by one who may, and by nobody else")


if __name__ == "__main__":
    try:
        main()
    except StartError as error:
        sys.exit(str(error))

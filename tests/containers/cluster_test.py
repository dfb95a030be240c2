#!/usr/bin/python3
"""The cluster in containers, for real: on a Docker daemon of its own, with ./dev cluster up, certs, bench and down. A master, a
gateway, a worker, ZooKeeper and the brokers are killed one by one; each heals by itself, all certificates are renewed and some
are revoked, and no message is lost.

usage: cluster_test.py BUILD_DIR [--small] [--storm] [--full]        (./dev cluster test builds what this needs; as root)
"""

import argparse
import json
import os
import re
import select
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(HERE), str(HERE.parent / "servers")]

import images  # noqa: E402
import storm_jar  # noqa: E402
from private_docker import Failed, PrivateDocker, end_on_signals, install_programs  # noqa: E402
from private_cluster import require, wait_for  # noqa: E402

PROJECT = "iotcloud-test"
GATEWAYS = ["gateway-1", "gateway-2"]
SECRETS = ROOT / "build/cluster/secrets"
BOOKS = "/var/lib/iotcloud-reports/books"  # which driver hosts may write; all gateways share it
NEWER = 50  # messages that must have come back since the repair
HEAL_LIMIT_S = 120
# Where each holder of a certificate shows it to whoever connects.
SHOWN_AT = {"master-1": [12904, 9112], "master-2": [12904, 9112], "gateway-1": [12905, 9405], "gateway-2": [12905, 9405],
            "topology-1": [9406], "topology-2": [9406], "pool-1": [12906, 9407], "pool-2": [12906, 9407], "registry-tls": [2281], "rabbitmq": [5671]}
READER = HERE / "page_reader.py"


class Cluster:
    """The test's actions from outside, as a person does them: ./dev cluster, and docker to check."""

    def __init__(self, docker, told, work, kafka):
        self.docker, self.work = docker, work
        self.ledgers = ["rabbitmq", *(["kafka"] if kafka else [])]  # one on each gateway, by its broker
        docker.environment.update(told, COMPOSE_PROJECT_NAME=PROJECT)

    def dev(self, *words, quiet=False):
        """Runs ./dev cluster WORDS and returns what it printed; unless it is to be quiet a person sees that line by line."""
        with (tempfile.TemporaryFile("w+") as errors,
              subprocess.Popen([*self.docker.enter, ROOT / "dev", "cluster", *words], env=self.docker.environment, text=True,
                               stdout=subprocess.PIPE, stderr=errors) as process):
            lines = []
            for line in process.stdout:
                lines.append(line)
                if not quiet:
                    print(line, end="", flush=True)
            if process.wait():
                errors.seek(0)
                raise Failed(f"./dev cluster {shlex.join(words)}: status {process.returncode}\n{''.join(lines)}{errors.read()}")
        return "".join(lines)

    def cli(self, *words):
        return self.dev("cli", *words, quiet=True)

    def json(self, *words):
        return json.loads(self.cli(*words, "-o", "json"))

    def inspect(self, service):
        return json.loads(self.docker.docker("inspect", self.container(service)))[0]

    def container(self, service):
        found = self.docker.docker("ps", "-aq", "--filter", f"label=com.docker.compose.project={PROJECT}",
                                   "--filter", f"label=com.docker.compose.service={service}",
                                   "--filter", "label=com.docker.compose.oneoff=False").split()
        require(len(found) == 1, f"{service} has {len(found)} containers")
        return found[0]

    def address(self, service):
        """In the network that the daemons share."""
        return self.inspect(service)["NetworkSettings"]["Networks"][f"{PROJECT}_default"]["IPAddress"]

    def healthy(self, service):
        return self.inspect(service)["State"].get("Health", {}).get("Status") == "healthy"

    def kill(self, service):
        """Its first process, so that all others of the container die too. (`docker kill` would be an order to stay dead.)"""
        state = self.inspect(service)
        os.kill(state["State"]["Pid"], signal.SIGKILL)
        return state["RestartCount"]

    def book(self, gateway, ledger, name):
        """The numbers in one of a ledger's files."""
        text = self.docker.docker("exec", self.container(gateway), "cat", f"{BOOKS}/{ledger}/{gateway}/{name}")
        return [int(line) for line in text.split()]

    def pause(self, gateway, ledger):
        """A ledger sends nothing from now on, and still takes what comes back."""
        self.docker.docker("exec", self.container(gateway), "touch", f"{BOOKS}/{ledger}/{gateway}/pause")


def settled(cluster, gateway, ledger, upto):
    """Whether all earlier messages came back, and newer ones, too."""
    try:
        received = set(cluster.book(gateway, ledger, "received"))
    except Failed:  # the container does not exist at this moment
        return False
    return received.issuperset(range(1, upto + 1)) and max(received, default=0) >= upto + NEWER


def report(cluster, name):
    """A load generator's report; None until it is written, when everything is back."""
    try:
        text = cluster.docker.docker("exec", cluster.container("gateway-1"), "cat", f"/var/lib/iotcloud-reports/{name}.json")
    except Failed:
        return None
    return json.loads(text) if text.endswith("}") else None


def check_round_trip(cluster, name="first"):
    """A load generator's messages come back, all of them; the commands are those that `up` printed."""
    cluster.cli("deploy", "loadgen.so", "--gateway", "gateway-1", "--property", "rate=100", "--property", "count=500",
                "--property", f"report=/var/lib/iotcloud-reports/{name}.json")

    wait_for("500 messages are back", lambda: report(cluster, name))
    result = report(cluster, name)
    require(result["sent"] == 500 and not result["lost"] and not result["damaged"], result)
    print(f"500 messages made the round trip: p50 {result['latency_us']['p50'] / 1000:.2f} ms, "
          f"p99 {result['latency_us']['p99'] / 1000:.2f} ms", flush=True)
    seen = json.loads(cluster.cli("topology", "show", "echo", "-o", "json"))
    require(len(seen["workers"]) == 2 and sum(one["emitted"] for one in seen["components"] if one["id"] == "receive") >= 500,
            f"the workers are not seen from outside: {seen}")
    metered = json.loads(cluster.cli("topology", "metrics", "echo", "-o", "json"))
    require(metered["workers"] == 2 and any(one["component"] == "receive" and one["sum"]["emitted"] >= 500
                                            for one in metered["components"]), f"the workers are not metered from outside: {metered}")
    # A tap shows what comes while it is there.
    cluster.cli("deploy", "loadgen.so", "--gateway", "gateway-1", "--property", "rate=10")
    tapped = cluster.cli("topology", "tap", "echo", "receive", "--count", "3", "-o", "json").splitlines()
    require(len(tapped) == 3 and all("driverID" in json.loads(sample)["fields"] for sample in tapped),
            f"the workers are not tapped from outside: {tapped}")
    cluster.cli("undeploy", "--gateway", "gateway-1", "--driver", "loadgen")


def check_pools(cluster):
    """The sample topology is submitted to both pools, by the command that `up` printed. One of them is killed with its worker
    while messages flow: the other one goes on, and none is lost."""
    cluster.cli("topology", "submit", "deploy/cluster/submitted/mirror.yaml", "--workers", "2")

    def running():
        places = cluster.json("topology", "show", "mirror")["places"]
        return {place["pool"] for place in places if place["state"] == "running"}

    require(running() == {"pool-1", "pool-2"}, f"the topology runs in {running()}")
    for gateway in GATEWAYS:
        cluster.cli("deploy", "loadgen.so", "--driver", "mirrored", "--gateway", gateway, "--property", "rate=100", "--property",
                    "count=3000", "--property", f"report=/var/lib/iotcloud-reports/{gateway}-mirrored.json")
    begin = time.monotonic()
    wait_for("messages go through it", lambda: any(
        one["emitted"] > 200 for one in cluster.json("topology", "show", "mirror")["components"] if one["id"] == "receive"))
    kill_and_wait(cluster, "pool-1")
    healed = time.monotonic() - begin
    for gateway in GATEWAYS:
        name = f"{gateway}-mirrored"
        wait_for(f"3000 messages of {gateway} are back", lambda name=name: report(cluster, name), HEAL_LIMIT_S)
        result = report(cluster, name)
        require(result["sent"] == 3000 and not result["lost"] and not result["damaged"], result)
    wait_for("both pools run a worker again", lambda: running() == {"pool-1", "pool-2"}, HEAL_LIMIT_S)
    cluster.cli("topology", "kill", "mirror")
    require("mirror" not in cluster.cli("topology", "list"), "the topology is listed after it was killed")
    cluster.cli("undeploy", "--driver", "mirrored")
    print(f"a submitted topology runs in two pools; one was killed and was healthy again after {healed:.1f} s; of 2 x 3000 messages "
          "none is lost", flush=True)


def check_storm(cluster, build):
    """The sample topology for Apache Storm is packed and submitted by the commands that `up` printed, runs in two workers, and sends
    back what comes."""
    storm_jar.build()
    jar = ROOT / "build/storm/mirror.jar"
    try:
        subprocess.run([build / "bin/iotcloud", "topology", "pack", "deploy/cluster/submitted/mirror-on-storm.yaml", jar], cwd=ROOT,
                       check=True)
        begin = time.monotonic()
        cluster.dev("storm", "jar", jar.name, "iotcloud.storm.Submit", quiet=True)
    finally:
        jar.unlink(missing_ok=True)
    for gateway in GATEWAYS:
        cluster.cli("deploy", "loadgen.so", "--driver", "mirrored-on-storm", "--gateway", gateway, "--property", "rate=100", "--property",
                    "count=1000", "--property", f"report=/var/lib/iotcloud-reports/{gateway}-on-storm.json")
    for gateway in GATEWAYS:
        name = f"{gateway}-on-storm"
        wait_for(f"1000 messages of {gateway} are back", lambda name=name: report(cluster, name), HEAL_LIMIT_S)
        result = report(cluster, name)
        require(result["sent"] == 1000 and not result["lost"] and not result["damaged"], result)
    check_that_storm_is_apart(cluster)
    cluster.cli("undeploy", "--driver", "mirrored-on-storm")
    print(f"a topology runs on Apache Storm; of 2 x 1000 messages none is lost, after {time.monotonic() - begin:.1f} s", flush=True)


def check_that_storm_is_apart(cluster):
    """Storm asks nobody who he is. Whoever has a gateway's container reaches none of it, by name or by address; Nimbus does, so that
    there is something to reach."""
    require(connects(cluster, "gateway-2", "rabbitmq", 5671), "gateway-2 reaches nobody at all")
    for service, ports in {"nimbus": [6627], "supervisor": [6628, 6700, 6701], "storm-zookeeper": [2181]}.items():
        networks = cluster.inspect(service)["NetworkSettings"]["Networks"]
        for port in ports:
            require(connects(cluster, "nimbus", service, port), f"nimbus does not reach {service}:{port}")
            for host in [service, *(network["IPAddress"] for network in networks.values())]:
                require(not connects(cluster, "gateway-2", host, port), f"the thief of gateway-2 reaches {service} by {host}:{port}")


def connects(cluster, service, host, port):
    """Whether a program in a service's container gets a connection."""
    return cluster.docker.inside("docker", "exec", cluster.container(service), "timeout", "2", "bash", "-c", f"exec 3<>/dev/tcp/{host}/{port}",
                                 capture_output=True).returncode == 0


def check_confined(cluster):
    """No process of ours is root's, and none can become it; passwords stand in no configuration of a container."""
    secrets = SECRETS / "authority"
    require(secrets.stat().st_mode & 0o777 == 0o700, "the folder of the secrets is open to others")
    hidden = [file.read_text().strip() for file in secrets.iterdir() if file.suffix in (".password", ".token")]
    require(len(hidden) > 10, f"only {len(hidden)} passwords and tokens in {secrets}")
    for file in secrets.iterdir():
        require(file.suffix in (".pem", ".pub") or file.name == "registry.users" or file.stat().st_mode & 0o077 == 0, f"{file} is open to others")
    for service in ["master-1", "master-2", "gateway-1", "gateway-2", "topology-1", "topology-2", "pool-1", "pool-2"]:
        top = cluster.docker.docker("top", cluster.container(service), "-eo", "pid,uid,args").splitlines()[1:]
        require(top and all(line.split()[1] == "10001" for line in top), f"{service} runs as {top}")
    for service in ["rabbitmq", "zookeeper", *GATEWAYS]:
        text = json.dumps(cluster.inspect(service))
        require(not any(word in text for word in hidden), f"a password stands in the configuration of {service}")
    print("no process of the cluster's own is root's; no password stands in a container's configuration", flush=True)


def check_programs(cluster):
    """The image has the robot's programs and the driver for ROS, and they find their libraries."""
    image = json.loads(cluster.docker.docker("inspect", cluster.container("gateway-1")))[0]["Config"]["Image"]
    for program in ("iotcloud-robot", "iotcloud-record"):
        cluster.docker.docker("run", "--rm", image, program, "--help")
    cluster.docker.docker("run", "--rm", image, "test", "-r", "/usr/lib/iotcloud/plugins/turtle_ros.so")


def deploy_ledgers(cluster, build):
    """The ledgers' plugin is sent, which takes the operator's signature."""
    plugin = Path(build / "ledger_driver.so").relative_to(ROOT)
    signature = build / "ledger_driver.so.sig"
    signature.unlink(missing_ok=True)
    try:
        cluster.cli("deploy", "--plugin", f"./{plugin}", "--gateway", GATEWAYS[0], "--property", f"folder={BOOKS}/unsigned")
    except Failed as refused:
        if "is not signed" not in str(refused):
            raise
    else:
        raise Failed("a plugin without a signature was taken")
    subprocess.run([build / "bin/iotcloud", "sign", plugin, "--version", "1", "--key", SECRETS / "authority/plugins.key"], cwd=ROOT, check=True)
    over_kafka = [f"--property=channel.{channel}.{option}" for channel in ("data", "echo")
                  for option in ("broker=kafka", "shared=true")]
    for ledger in cluster.ledgers:
        other = ["--driver", "loadgen-kafka", *over_kafka] if ledger == "kafka" else []
        cluster.cli("deploy", "--plugin", f"./{plugin}", "--all", "--name", f"ledger-{ledger}", *other, "--property",
                    f"folder={BOOKS}/{ledger}")
    wait_until_settled(cluster, {(gateway, ledger): 0 for gateway in GATEWAYS for ledger in cluster.ledgers}, "the start")


def sent_so_far(cluster):
    return {(gateway, ledger): max(cluster.book(gateway, ledger, "sent"))
            for gateway in GATEWAYS for ledger in cluster.ledgers}


def leader(cluster):
    """The leading service; None while none leads."""
    said = cluster.json("status")["master"]
    return (said["address"] if said["leading"] else said["leader"]).split(":")[0]


def kill_and_heal(cluster, service):
    """Kills a container; it is there again, healthy, and both drivers have all back that they had sent until then."""
    sent = sent_so_far(cluster)
    begin = time.monotonic()
    kill_and_wait(cluster, service)
    healthy = time.monotonic() - begin
    wait_until_settled(cluster, sent, f"{service} was killed")
    print(f"killed {service}: healthy again after {healthy:.1f} s, all drivers' messages flow and none is missing after "
          f"{time.monotonic() - begin:.1f} s", flush=True)


def kill_and_wait(cluster, service):
    restarts = cluster.kill(service)
    wait_for(f"{service} is started again", lambda: cluster.inspect(service)["RestartCount"] > restarts, HEAL_LIMIT_S)
    wait_for(f"{service} is healthy", lambda: cluster.healthy(service), HEAL_LIMIT_S)


def wait_until_settled(cluster, sent, what):
    for (gateway, ledger), upto in sent.items():
        wait_for(f"{gateway}'s ledger over {ledger} has everything back after {what}",
                 lambda gateway=gateway, ledger=ledger, upto=upto: settled(cluster, gateway, ledger, upto), HEAL_LIMIT_S)


def kill_the_broker_that_holds_messages(cluster):
    """Both workers stand still, so no message is read: those in the broker must survive its death."""
    workers = [cluster.container(f"topology-{number}") for number in (1, 2)]
    cluster.docker.docker("pause", *workers)
    for gateway in GATEWAYS:
        back = max(cluster.book(gateway, "rabbitmq", "received"))
        wait_for(f"messages of {gateway} wait", lambda gateway=gateway, back=back:
                 max(cluster.book(gateway, "rabbitmq", "sent")) > back + 2 * NEWER)
    sent = sent_so_far(cluster)
    kill_and_wait(cluster, "rabbitmq")
    cluster.docker.docker("unpause", *workers)
    wait_until_settled(cluster, sent, "the broker died with messages that nobody had read")
    print("killed rabbitmq while no worker read: what it held is back", flush=True)


def check_faults(cluster):
    first = leader(cluster)
    kill_and_heal(cluster, first)
    wait_for("the masters have a leader that takes orders", lambda: leader(cluster))
    cluster.cli("metadata", "--name", "ledger-rabbitmq", "checked=yes")
    print(f"the masters' leader was {first} and is {leader(cluster)}; it takes orders", flush=True)
    kill_and_heal(cluster, "topology-1")
    kill_and_heal(cluster, "gateway-1")
    kill_and_heal(cluster, "rabbitmq")
    kill_the_broker_that_holds_messages(cluster)
    kill_and_heal(cluster, "zookeeper")
    wait_for("the masters have a leader again", lambda: leader(cluster))
    cluster.cli("metadata", "--name", "ledger-rabbitmq", "checked=again")
    if "kafka" in cluster.ledgers:
        kill_and_heal(cluster, "kafka")


def certificate_at(cluster, service, port):
    """The certificate that a service shows to whoever connects now; empty: none."""
    told = cluster.docker.inside("openssl", "s_client", "-connect", f"{cluster.address(service)}:{port}", stdin=subprocess.DEVNULL,
                                 capture_output=True, text=True).stdout
    return first_certificate(told)


def first_certificate(text):
    found = re.search("-----BEGIN CERTIFICATE-----.*?-----END CERTIFICATE-----", text, re.DOTALL)
    return found[0] if found else ""


def check_renewal(cluster):
    """All certificates are renewed while the ledgers write, then some are revoked: open connections are cut."""
    authority = SECRETS / "authority"
    before = {service: cluster.inspect(service)["State"]["StartedAt"] for service in SHOWN_AT}
    first = {service: first_certificate((authority / f"{service}.pem").read_text()) for service in SHOWN_AT}
    begin = time.monotonic()
    cluster.dev("certs", "renew", *SHOWN_AT, "prometheus", quiet=True)
    for service, ports in SHOWN_AT.items():
        renewed = first_certificate((authority / f"{service}.pem").read_text())
        require(renewed and renewed != first[service], f"the certificate of {service} was not renewed")
        for port in ports:
            wait_for(f"{service} shows its renewed certificate at port {port}", lambda service=service, port=port, renewed=renewed:
                     certificate_at(cluster, service, port) == renewed, HEAL_LIMIT_S)
    shown = time.monotonic() - begin
    cluster.dev("tokens", "renew", quiet=True)
    wait_until_settled(cluster, sent_so_far(cluster), "certificates and tokens were renewed")
    print(f"{len(SHOWN_AT) + 1} certificates renewed: all daemons show theirs after {shown:.1f} s", flush=True)

    # A reader of pages, whose token all daemons know.
    pages = {service: ports[-1] for service, ports in SHOWN_AT.items() if service not in ("registry-tls", "rabbitmq")}
    readers = {service: PageReader(cluster, service, port) for service, port in pages.items()}
    try:
        for service, reader in readers.items():
            require(reader.says() == "reading", f"the page of {service} is not read")
        cluster.dev("certs", "revoke", "prometheus", quiet=True)
        begin = time.monotonic()
        for service, reader in readers.items():
            said = reader.says()
            require(said == "cut", f"{service} says to whoever has a revoked certificate: {said}")
        cut = time.monotonic() - begin
    finally:
        for reader in readers.values():
            reader.end()
    for service, port in pages.items():
        with PageReader(cluster, service, port) as again:
            require(again.says() == "cut", f"{service} lets in who has a revoked certificate")
    print(f"one revoked: {len(readers)} open connections are cut {cut:.1f} s after the command has ended, and no new one is taken",
          flush=True)

    # A worker, of which masters show the page: they do not speak with it any more, and its messages go on.
    def all_are_read():
        try:
            return len(cluster.json("topology", "show", "echo")["workers"]) == 2
        except Failed:  # it tells whose page cannot be read, and fails
            return False
    wait_for("the masters read both workers' pages", all_are_read, HEAL_LIMIT_S)
    cluster.dev("certs", "revoke", "topology-2", quiet=True)
    wait_for("the masters do not speak with the worker whose certificate is revoked", lambda: not all_are_read(), HEAL_LIMIT_S)
    wait_until_settled(cluster, sent_so_far(cluster), "a worker's certificate was revoked")
    cluster.dev("certs", "renew", "topology-2", "--new-key", quiet=True)
    wait_for("the masters read the page of the one with another certificate", all_are_read, HEAL_LIMIT_S)
    wait_until_settled(cluster, sent_so_far(cluster), "it got another one")
    after = {service: cluster.inspect(service)["State"]["StartedAt"] for service in SHOWN_AT}
    again = {service for service in SHOWN_AT if before[service] != after[service]}
    require(again == {"registry-tls"}, f"started again for a certificate: {again}; a revocation does that to registry-tls only")
    print("the masters do not speak with a worker whose certificate is revoked, until it has another one; no daemon was started "
          "again, and no message is missing", flush=True)


def check_stolen(cluster, kafka):
    """`./dev cluster certs revoke gateway-2` leaves its thief nothing, not even what is open, and all others go on."""
    password = (SECRETS / "authority/gateway-2.rabbitmq.password").read_text().strip()
    secret = {"gateway-2": password, "gateway-2-reads": (SECRETS / "authority/gateway-2-reads.rabbitmq.password").read_text().strip()}

    def gets_in(user):
        return cluster.docker.inside("docker", "exec", cluster.container("rabbitmq"), "rabbitmqctl", "authenticate_user", user, secret[user],
                                     capture_output=True, text=True).returncode == 0

    def connected():
        listed = cluster.docker.docker("exec", cluster.container("rabbitmq"), "rabbitmqctl", "-q", "list_connections", "user")
        return secret.keys() & set(listed.split())

    def state(gateway):
        return next(one["state"] for one in cluster.json("gateways") if one["gateway"] == gateway)

    cluster.cli("deploy", "loadgen.so", "--all", "--property", "rate=10")
    wait_for("the gateway's users are connected", lambda: connected() == secret.keys(), HEAL_LIMIT_S)
    require(all(map(gets_in, secret)) and state("gateway-2") == "ready", "the attack: the thief is let in everywhere")
    begin = time.monotonic()
    cluster.dev("certs", "revoke", "gateway-2")
    require(not any(map(gets_in, secret)), "RabbitMQ lets the thief in")
    require(not connected(), f"RabbitMQ keeps the connections of {connected()}")
    if kafka:
        rules = cluster.docker.docker("exec", cluster.container("kafka"), "env", "KAFKA_OPTS=", "/opt/kafka/bin/kafka-acls.sh", "--bootstrap-server",
                                      "localhost:9092", "--command-config", "/run/secrets/admin.properties", "--list")
        require("User:gateway-1" in rules and "User:gateway-2" not in rules, f"Kafka's rules: {rules}")
    wait_for("the thief has lost its place in the registry", lambda: state("gateway-2") == "lost", HEAL_LIMIT_S)
    users = cluster.docker.docker("exec", cluster.container("master-1"), "cat", "/run/secrets/registry.users")
    require("gateway-1:" in users and "gateway-2:" not in users, f"the registry's users: {users}")
    wait_for("gateway-1 goes on", lambda: state("gateway-1") == "ready", HEAL_LIMIT_S)
    cluster.cli("undeploy", "--gateway", "gateway-1", "--driver", "loadgen")
    check_round_trip(cluster, "second")
    print(f"a stolen gateway is nobody any more, and another one goes on, after {time.monotonic() - begin:.1f} s", flush=True)


def check_stolen_worker(cluster, kafka):
    """After `./dev cluster certs revoke pool-2` and `./dev cluster passwords renew` what the thief of a pool has is worth nothing, and the
    other workers go on, over both brokers."""
    file = SECRETS / "authority/workers.rabbitmq.password"
    stolen = file.read_text().strip()

    def gets_in(password):
        return cluster.docker.inside("docker", "exec", cluster.container("rabbitmq"), "rabbitmqctl", "authenticate_user", "workers", password,
                                     capture_output=True, text=True).returncode == 0

    require(gets_in(stolen), "the attack: the thief is let in")
    begin = time.monotonic()
    cluster.dev("certs", "revoke", "pool-2")
    cluster.dev("passwords", "renew")
    require(not gets_in(stolen) and gets_in(file.read_text().strip()), "RabbitMQ has the workers' old password")
    for service in ["master-1", "master-2", *GATEWAYS, "topology-1", "topology-2", "pool-1", *(["kafka"] if kafka else [])]:
        wait_for(f"{service} is healthy", lambda service=service: cluster.healthy(service), HEAL_LIMIT_S)
    wait_for("the masters have a leader once more", lambda: leader(cluster), HEAL_LIMIT_S)
    wait_for("the workers are in the registry again", lambda: workers_of_echo(cluster) == 2, HEAL_LIMIT_S)
    check_round_trip(cluster, "third")
    if kafka:
        cluster.cli("deploy", "loadgen.so", "--driver", "loadgen-kafka", "--gateway", "gateway-1", "--property", "broker=kafka", "--property",
                    "shared=true", "--property", "rate=100", "--property", "count=500", "--property",
                    "report=/var/lib/iotcloud-reports/kafka-again.json")
        wait_for("500 messages over Kafka are back", lambda: report(cluster, "kafka-again"), HEAL_LIMIT_S)
        result = report(cluster, "kafka-again")
        require(result["sent"] == 500 and not result["lost"] and not result["damaged"], result)
        cluster.cli("undeploy", "--driver", "loadgen-kafka")
    print(f"a stolen pool's passwords are worth nothing any more, and all workers have others, after {time.monotonic() - begin:.1f} s",
          flush=True)


def workers_of_echo(cluster):
    """How many workers the masters see; a page that cannot be read fails."""
    try:
        return len(cluster.json("topology", "show", "echo")["workers"])
    except Failed:
        return 0


class PageReader:
    """page_reader.py, with the secrets that Prometheus has."""

    def __init__(self, cluster, service, port):
        self.process = subprocess.Popen([*cluster.docker.enter, sys.executable, str(READER), str(SECRETS / "prometheus"), service,
                                         cluster.address(service), str(port)], stdout=subprocess.PIPE, text=True)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.end()

    def says(self):
        """Waits for what it says next."""
        ready, _, _ = select.select([self.process.stdout], [], [], HEAL_LIMIT_S)
        return self.process.stdout.readline().strip() if ready else "nothing"

    def end(self):
        self.process.kill()
        self.process.wait()


def check_books(cluster):
    """No message was lost in the whole test: all came back. The drivers pause and are not stopped for that: what is under way while a
    driver is stopped is given up."""
    for ledger in cluster.ledgers:
        for gateway in GATEWAYS:
            cluster.pause(gateway, ledger)
        for gateway in GATEWAYS:
            sent = last_sent(cluster, gateway, ledger)
            require(sent == sorted(sent) and set(sent) == set(range(1, max(sent) + 1)),
                    f"{gateway}'s ledger over {ledger} skipped numbers")
            wait_for(f"all of {gateway}'s {len(sent)} messages over {ledger} are back",
                     lambda gateway=gateway, ledger=ledger, sent=sent:
                     set(cluster.book(gateway, ledger, "received")).issuperset(sent))
            received = cluster.book(gateway, ledger, "received")
            print(f"{gateway}, {ledger}: {max(sent)} messages sent, {max(sent) - len(set(received) & set(sent))} lost, "
                  f"{len(received) - len(set(received))} came twice", flush=True)
        cluster.cli("undeploy", "--name", f"ledger-{ledger}")


def last_sent(cluster, gateway, ledger):
    """All numbers that a ledger which pauses has sent, once they are no longer getting more."""
    books = [[], cluster.book(gateway, ledger, "sent")]

    def same():
        books[:] = [books[1], cluster.book(gateway, ledger, "sent")]
        return books[0] == books[1]

    wait_for(f"{gateway}'s ledger over {ledger} sends nothing more", same)
    return books[1]


def check_bench(cluster, kafka):
    cluster.dev("bench", "--quick")
    in_volume = cluster.docker.docker("run", "--rm", "-v", f"{PROJECT}_reports:/reports:ro", images.BASE, "cat",
                                      "/reports/cluster.json")
    results = json.loads(in_volume)["results"]
    for broker in ["RabbitMQ", *(["Kafka"] if kafka else [])]:
        require(any(result["name"].startswith(broker) for result in results), f"the report has no figures of {broker}")
    require(all(result["value"] > 0 and result["ratio"] > 0 for result in results), results)
    require((ROOT / "build/cluster/cluster.json").read_text() == in_volume + "\n", "the copied report is another one")


def everything(docker):
    """Names of all containers, volumes and networks."""
    return {kind: set(docker.docker(*command, "--format", "{{.Names}}" if kind == "container" else "{{.Name}}").split())
            for kind, command in {"container": ["ps", "-a"], "volume": ["volume", "ls"], "network": ["network", "ls"]}.items()}


def check_up(cluster, kafka, storm):
    printed = cluster.dev("up", *([] if kafka else ["--small"]), *(["--storm"] if storm else []))
    command = next(line.strip() for line in printed.splitlines() if line.startswith("  ./dev cluster cli"))
    require("2 ready" in cluster.cli(*command.split()[3:]), f"`{command}` says: {cluster.cli(*command.split()[3:])}")
    print(f"the printed command works: {command}", flush=True)
    cluster.dev("status")
    ports = [bound for service in ("rabbitmq", "master-1", "master-2")
             for hosts in cluster.inspect(service)["NetworkSettings"]["Ports"].values() for bound in hosts or []]
    require(ports and all(bound["HostIp"] == "127.0.0.1" for bound in ports), f"published beyond loopback: {ports}")


def main():
    options = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    options.add_argument("build", type=Path)
    options.add_argument("--small", action="store_true", help="without Kafka")
    options.add_argument("--storm", action="store_true", help="with Apache Storm")
    options.add_argument("--full", action="store_true",
                         help="that, and compile in the image, as `./dev cluster up` does elsewhere; half an hour on two cores")
    given = options.parse_args()
    if os.geteuid() != 0:
        sys.exit("this test starts a Docker daemon in a network namespace: run it as root")
    end_on_signals()
    install_programs()
    work = ROOT / "build/containers"
    work.mkdir(parents=True, exist_ok=True)
    build, kafka, storm = given.build.resolve(), not given.small, given.storm or given.full
    without = [*([] if kafka else ["kafka"]), *([] if storm else ["storm"])]
    begin = time.monotonic()
    require(not SECRETS.exists(), "a cluster is up from this folder: ./dev cluster down first")
    with PrivateDocker(work / "dockerd.log") as docker:
        print(f"a Docker daemon of its own, after {time.monotonic() - begin:.0f} s", flush=True)
        cluster = Cluster(docker, images.load(docker, build, work, without, given.full), work, kafka)
        print(f"all images it needs, after {time.monotonic() - begin:.0f} s", flush=True)
        docker.docker("volume", "create", "foreign")
        docker.docker("create", "--name", "foreign", images.BASE, "true")
        before = everything(docker)
        try:
            check_up(cluster, kafka, storm)
            print("images: " + ", ".join(f"{tag} {size:.0f} MB" for tag, size in images.sizes(docker).items()), flush=True)
            check_confined(cluster)
            check_programs(cluster)
            check_round_trip(cluster)
            check_pools(cluster)
            if storm:
                check_storm(cluster, build)
            deploy_ledgers(cluster, build)
            check_renewal(cluster)
            check_faults(cluster)
            check_books(cluster)
            check_bench(cluster, kafka)
            check_stolen_worker(cluster, kafka)
            check_stolen(cluster, kafka)
        except BaseException:
            keep_logs(docker, work)
            raise
        finally:
            cluster.dev("down")
        require(everything(docker) == before, f"left after down: {everything(docker)}; before up: {before}")
        require(not SECRETS.exists(), "secrets are left after down")
        print("`./dev cluster down` left nothing, and took nothing else", flush=True)
    print(f"took {(time.monotonic() - begin) / 60:.1f} min")


def keep_logs(docker, work):
    """The logs of a failed test's containers."""
    logs = work / "logs"
    shutil.rmtree(logs, ignore_errors=True)
    logs.mkdir()
    for name in docker.docker("ps", "-a", "--format", "{{.Names}}").split():
        (logs / f"{re.sub('[^a-z0-9-]', '_', name)}.log").write_text(docker.docker("logs", name), encoding="utf-8")
    print(f"logs of all containers are in {logs}", flush=True)


if __name__ == "__main__":
    try:
        main()
    except Failed as problem:
        sys.exit(str(problem))

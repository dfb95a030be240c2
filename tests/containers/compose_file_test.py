#!/usr/bin/python3
"""docker-compose.yml keeps its promises: no service without limits, health check and restart policy, nothing on the host's
network or privileged, no secret in the file, ports on loopback only, nothing said to ZooKeeper and RabbitMQ without TLS, nor to a
broker without a user.

usage: compose_file_test.py
"""

import copy
import json
import re
import subprocess
import sys
import tempfile
import types
from pathlib import Path
from unittest import mock

import yaml

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "deploy/cluster"))

import cluster  # noqa: E402  (its folder is known now)
SERVICES = {"zookeeper", "registry-tls", "rabbitmq", "kafka", "master-1", "master-2", "gateway-1", "gateway-2", "topology-1", "topology-2",
            "pool-1", "pool-2", "prometheus", "storm-zookeeper", "nimbus", "supervisor"}
DAEMONS = {"master-1", "master-2", "gateway-1", "gateway-2", "topology-1", "topology-2", "pool-1", "pool-2"}
RUN_ONCE = {"bench", "cli", "secrets", "storm"}  # by a person, or by ./dev cluster
# Who is on another network than the daemons. On that of the registry's ZooKeeper nothing is encrypted: it is for the other end of
# the tunnels, and for the workers of Apache Storm. Storm asks nobody who he is, so it is on a network of its own, with a ZooKeeper
# of its own; RabbitMQ comes to its workers there.
NETWORKS = {"zookeeper": ["registry"], "registry-tls": ["default", "registry"], "rabbitmq": ["default", "storm"],
            "storm-zookeeper": ["storm"], "nimbus": ["storm"], "supervisor": ["storm", "registry"], "storm": ["storm"]}
# What gateways may share with others: it is public.
SHARED = {"ca.pem", "revoked.pem", "registry.users", "master-1.orders.pub", "master-2.orders.pub", "plugins.pub"}
FOLDER = re.compile(r"\$\{SECRETS:-\./build/cluster/secrets\}/([a-z0-9-]+):/run/secrets:ro")
FORBIDDEN = ["privileged", "pid", "ipc", "userns_mode", "devices", "cgroup_parent", "env_file"]
SECRET_WORD = re.compile(r"(?i)(password|passwd|pass|token|secret|credential)[a-z_]*$")


def problems_of(file):
    """The errors of a compose file, as sentences."""
    found = []
    services = file["services"]
    for name in (SERVICES | RUN_ONCE) ^ set(services):
        found.append(f"{name} is in one of the file and this test only")
    for name, service in services.items():
        found += [f"{name} {problem}" for problem in problems_of_service(name, service, services)]
    found += shared_secrets(services)
    found += ways_around_the_tunnel(file)
    if "secrets" in file:
        found.append("secrets are mounted as files, of which a container sees no later one")
    return found


def folder_of(service):
    """The folder of secrets that a service mounts; None: it has none."""
    return next((match.group(1) for volume in service.get("volumes", []) if (match := FOLDER.fullmatch(volume))), None)


def secrets_of(service):
    """What a service gets of the authority's files."""
    return set(cluster.FILES.get(folder_of(service), {}).values())


def shared_secrets(services):
    """What the thief of one gateway has is of no use elsewhere: it shares no secret with another service."""
    for name in sorted(SERVICES & set(services)):
        for other in sorted(SERVICES & set(services) - {name}) if name.startswith("gateway-") else []:
            for secret in sorted(secrets_of(services[name]) & secrets_of(services[other]) - SHARED):
                yield f"{name} shares the secret {secret} with {other}"


def ways_around_the_tunnel(file):
    """Only registry-tls and the workers of Apache Storm are on ZooKeeper's network, and each daemon has a tunnel to it, with a
    certificate; no daemon is on a network with Storm."""
    services = file["services"]
    if file.get("networks") != {"registry": {"internal": True}, "storm": {"internal": True}}:
        yield "the networks of ZooKeeper and Storm lead elsewhere"
    if services["zookeeper"]["environment"].get("ZOO_MAX_CLIENT_CNXNS") != "0":
        yield "zookeeper allows one address so few connections as all daemons, which come by way of registry-tls, must share"
    for name, service in services.items():
        if service.get("networks") != NETWORKS.get(name):
            yield f"{name} is on the networks {service.get('networks')}"
        if name in NETWORKS and name != "rabbitmq" and "ports" in service:
            yield f"{name} publishes {service['ports']}, where nobody is asked who he is"
        if name in ("nimbus", "supervisor") and 'storm.zookeeper.servers=["storm-zookeeper"]' not in service["command"]:
            yield f"{name} has its nodes in the registry's ZooKeeper, where no right guards them"
        if name in DAEMONS:
            if service["command"][0] != "iotcloud-with-registry-tunnel":
                yield f"{name} has no tunnel to the registry"
            if not {"host.pem", "host.key", "ca.pem", "revoked.pem"} <= set(cluster.FILES.get(folder_of(service), {})):
                yield f"{name} has no certificate, authority or list of revoked certificates for its tunnel"


def directives(file):
    return {line for line in file.read_text(encoding="utf-8").splitlines() if line and not line.startswith((";", "["))}


def problems_of_configurations():
    """The daemons speak to their tunnel, whose configuration is the shipped one with the names of this cluster."""
    folder = ROOT / "deploy/cluster"
    for file in [*folder.glob("*.yaml"), *folder.glob("submitted/*.yaml")]:
        found = re.findall(r"(?:zookeeper://|zk.servers: \[\")([^\"]*)", file.read_text(encoding="utf-8"))
        expected = "zookeeper:2181" if file.stem.endswith("-on-storm") else "127.0.0.1:2181"
        if found != [expected]:
            yield f"{file.name} has the registry {found}, not {expected}"
        for name, broker in yaml.safe_load(file.read_text(encoding="utf-8")).get("brokers", {}).items():
            if not broker.get("user") or not broker.get("password_file", "").startswith("/run/secrets/"):
                yield f"{file.name} comes to {name} without a user and a password of its own"
            if name == "rabbitmq" and (not broker["urls"][0].startswith("amqps://") or not broker.get("tls", {}).get("ca")):
                yield f"{file.name} comes to {name} without TLS"
            if name == "rabbitmq" and not broker.get("tls", {}).get("revoked"):
                yield f"{file.name} comes to {name} also when the server's certificate is revoked"
    expected = directives(ROOT / "deploy/systemd/registry-tunnel.conf") - {"connect = zk1:2281", "checkHost = zk1"}
    expected = {line.replace("/etc/iotcloud/lab1-tunnel", "/run/secrets/host").replace("/etc/iotcloud", "/run/secrets") for line in expected}
    expected |= {"connect = registry-tls:2281", "checkHost = registry-tls", "delay = yes"}
    if directives(folder / "registry-tunnel.conf") != expected:
        yield f"registry-tunnel.conf differs from the shipped one: {directives(folder / 'registry-tunnel.conf') ^ expected}"


def problems_of_service(name, service, services):
    for key in FORBIDDEN:
        if key in service:
            yield f"has {key}"
    if service.get("network_mode", "none") != "none":
        yield f"has network_mode {service['network_mode']}"
    if service.get("cap_drop") != ["ALL"] or "no-new-privileges:true" not in service.get("security_opt", []):
        yield "keeps capabilities, or may gain privileges"
    for key in ("mem_limit", "cpus", "pids_limit"):
        if not service.get(key):
            yield f"has no {key}"
    if service.get("restart") != ("no" if name in RUN_ONCE else "unless-stopped"):
        yield f"has the restart policy {service.get('restart')}"
    if name in SERVICES and not {"test", "interval", "timeout", "retries"} <= set(service.get("healthcheck", {})):
        yield "has no whole health check"
    for other, how in service.get("depends_on", {}).items():
        if how != {"condition": "service_healthy"} or "healthcheck" not in services.get(other, {}):
            yield f"does not wait until {other} is healthy"
    if name in SERVICES - {"zookeeper", "storm-zookeeper", "rabbitmq", "kafka"} and not service.get("depends_on"):
        yield "waits for nobody"
    for port in service.get("ports", []):
        if not re.fullmatch(r"127\.0\.0\.1:\$\{[A-Z0-9_]+:-\d+\}:\d+", port):
            yield f"publishes {port}: not on loopback, or not to be chosen"
    if "secrets" in service:
        yield "has secrets that are mounted as files"
    whole = [volume for volume in service.get("volumes", []) if "SECRETS" in volume and not FOLDER.fullmatch(volume)]
    if whole and name != "secrets":
        yield f"has the secrets of others: {whole}"
    if folder_of(service) not in (None, {"cli": "operator"}.get(name, name)) or folder_of(service) not in (None, *cluster.FILES):
        yield f"has the secrets of {folder_of(service)}"
    for key, value in service.get("environment", {}).items():
        if SECRET_WORD.search(key) and not str(value).startswith("/run/secrets/"):
            yield f"has a secret in its environment: {key}"
    for volume in service.get("volumes", []):
        if "docker.sock" in volume:
            yield "reaches the Docker daemon"


def check_that_it_finds(file):
    """The checker finds every broken promise."""
    breaks = {
        "zookeeper has no cpus": lambda services: services["zookeeper"].pop("cpus"),
        "zookeeper allows one address so few": lambda services: services["zookeeper"]["environment"].pop("ZOO_MAX_CLIENT_CNXNS"),
        "rabbitmq has no whole health check": lambda services: services["rabbitmq"].pop("healthcheck"),
        "kafka has no mem_limit": lambda services: services["kafka"].pop("mem_limit"),
        "master-1 has the restart policy no": lambda services: services["master-1"].update(restart="no"),
        "master-2 has network_mode host": lambda services: services["master-2"].update(network_mode="host"),
        "gateway-1 has privileged": lambda services: services["gateway-1"].update(privileged=True),
        "gateway-2 keeps capabilities": lambda services: services["gateway-2"].pop("cap_drop"),
        "topology-1 waits for nobody": lambda services: services["topology-1"].pop("depends_on"),
        "topology-2 publishes": lambda services: services["topology-2"].update(ports=["9406:9406"]),
        "rabbitmq has a secret in its environment":
            lambda services: services["rabbitmq"].update(environment={"RABBITMQ_DEFAULT_PASS": "guest"}),
        "gateway-1 has the secrets of master-1":
            lambda services: replace_volume(services["gateway-1"], "secrets}/gateway-1:", "secrets}/master-1:"),
        "gateway-2 has the secrets of others":
            lambda services: replace_volume(services["gateway-2"], "secrets}/gateway-2:", "secrets}:"),
        "master-1 is on the networks": lambda services: services["master-1"].update(networks=["default", "registry"]),
        "gateway-1 has no tunnel": lambda services: services["gateway-1"]["command"].pop(0),
        "pool-1 has no tunnel": lambda services: services["pool-1"]["command"].pop(0),
        "topology-1 has no certificate": lambda services: services["topology-1"].update(volumes=[]),
        "prometheus publishes": lambda services: services["prometheus"].update(ports=["${PROMETHEUS_PORT:-9090}:9090"]),
        "nimbus is on the networks": lambda services: services["nimbus"].update(networks=["default", "storm"]),
        "supervisor is on the networks": lambda services: services["supervisor"].update(networks=["default", "registry"]),
        "supervisor has its nodes in the registry's ZooKeeper": lambda services: services["supervisor"]["command"].pop(3),
        "storm-zookeeper is on the networks": lambda services: services["storm-zookeeper"].update(networks=["registry"]),
        "gateway-2 is on the networks": lambda services: services["gateway-2"].update(networks=["default", "storm"]),
        "nimbus publishes": lambda services: services["nimbus"].update(ports=["127.0.0.1:${NIMBUS_PORT:-6627}:6627"]),
        "supervisor has the secrets of pool-1":
            lambda services: replace_volume(services["supervisor"], "secrets}/supervisor:", "secrets}/pool-1:"),
        "bench has secrets that are mounted as files": lambda services: services["bench"].update(secrets=["ca.pem"]),
    }
    for expected, break_it in breaks.items():
        broken = copy.deepcopy(file)
        break_it(broken["services"])
        found = problems_of(broken)
        if not any(problem.startswith(expected) for problem in found):
            sys.exit(f"nobody noticed: {expected}; found: {found}")


def replace_volume(service, old, new):
    service["volumes"] = [volume.replace(old, new) for volume in service["volumes"]]


def check_brokers_users():
    """A gateway reaches its own queues and keys only, workers those of the gateways, and nobody the server's own names. What the
    server makes of that is tested in tests/brokers."""
    queues = ["gateway-1.loadgen.0a1b.data", "gateway-1.loadgen.data"]
    of_others = ["gateway-2.loadgen.data", "gateway-10.loadgen.data", "x.gateway-1.a", "lab.loadgen.data", "#"]
    always = ["amq.direct", "amq.default", "gateway-10.loadgen.data", "x.gateway-1.a", "lab.loadgen.data"]
    exchange = cluster.GATEWAYS_EXCHANGE
    for user, right, reached, refused in [
            ("gateway-1", "configure", [], [*queues, *of_others, *always, exchange, "loadgen"]),
            ("gateway-1", "write", [exchange], [*queues, *of_others, *always, "loadgen"]),
            ("gateway-1", "read", [], [*queues, *of_others, *always, exchange, "loadgen"]),
            ("gateway-1", "keys", queues, of_others),
            ("gateway-1-reads", "configure", queues, [*of_others, *always, exchange, "loadgen"]),
            ("gateway-1-reads", "write", queues, [*of_others, *always, exchange, "loadgen"]),
            ("gateway-1-reads", "read", [*queues, exchange], [*of_others, *always, "loadgen"]),
            ("gateway-1-reads", "keys", queues, of_others),
            *(("workers", right, [*queues, "gateway-2.loadgen.data.echo", exchange, "loadgen", "loadgen.durable"], always)
              for right in ("configure", "write", "read")),
            ("workers", "keys", [*queues, "gateway-2.loadgen.data.echo"], [*always, "#"])]:
        pattern = cluster.RABBITMQ_USERS[user][right]
        for name, expected in [*((name, True) for name in reached), *((name, False) for name in refused)]:
            if bool(re.search(pattern, name)) != expected:
                sys.exit(f"RabbitMQ: {user} {'has not' if expected else 'has'} the right {right} of \"{name}\"")
    told = json.loads(cluster.rabbitmq_users(dict.fromkeys(cluster.RABBITMQ_USERS, "sesame")))
    unlimited = {user["name"] for user in told["users"] if not {"max-connections", "max-channels"} <= set(user["limits"])}
    if unlimited != {"bench"}:
        sys.exit(f"RabbitMQ has no limits for {unlimited}")
    if [policy["pattern"] for policy in told["policies"]] != [".*"] or told["policies"][0]["definition"]["overflow"] != "reject-publish":
        sys.exit(f"what waits in RabbitMQ's queues: {told['policies']}")
    if {user["tags"] for user in told["users"]} != {""} or "sesame" in json.dumps(told):
        sys.exit(f"RabbitMQ's users: {told}")


def check_kafkas_users():
    """Every user of Kafka has rights, and those of a gateway are about what begins with its id. What the server makes of them is
    tested in tests/brokers."""
    told = subprocess.run(["bash", ROOT / "deploy/cluster/kafka-rights", "echo"], check=True, capture_output=True, text=True,
                          timeout=60).stdout.splitlines()
    rules = {}
    for line in told:
        words = line.split()
        rules.setdefault(words[words.index("--allow-principal") + 1].removeprefix("User:"), []).append(words)
    if set(rules) != set(cluster.KAFKA_USERS):
        sys.exit(f"kafka-rights is about {sorted(rules)}, and the users are {sorted(cluster.KAFKA_USERS)}")
    for gateway in cluster.GATEWAYS:
        named = [word for words in rules[gateway] for at, word in enumerate(words) if words[at - 1] in ("--topic", "--group")]
        patterns = {words[words.index("--resource-pattern-type") + 1] for words in rules[gateway]}
        if set(named) != {f"{gateway}."} or patterns != {"prefixed"} or "--cluster" in sum(rules[gateway], []):
            sys.exit(f"kafka-rights: {gateway} has {rules[gateway]}")
    topics = {words[at + 1] for words in rules["workers"] for at, word in enumerate(words) if word == "--topic"}
    if topics != {f"{gateway}." for gateway in cluster.GATEWAYS}:
        sys.exit(f"kafka-rights: workers reach {topics}")


def check_kafkas_quotas():
    """Every user of Kafka but the benchmark's sends and reads so many bytes a second, and no more."""
    told = subprocess.run(["bash", ROOT / "deploy/cluster/kafka-quotas", "echo"], check=True, capture_output=True, text=True, timeout=60,
                          env={"PATH": "/usr/bin:/bin", "GATEWAY_BYTES_PER_S": "1000"}).stdout.splitlines()
    quotas = {words[words.index("--entity-name") + 1]: words[words.index("--add-config") + 1] for words in map(str.split, told)}
    expected = {**dict.fromkeys(cluster.GATEWAYS, 1000), "workers": 4000}
    if quotas != {user: f"producer_byte_rate={rate},consumer_byte_rate={rate}" for user, rate in expected.items()}:
        sys.exit(f"kafka-quotas: {quotas}")


def check_renewal():
    """A file that changed is another one in the folder that a container has mounted, and others stay as they are."""
    with tempfile.TemporaryDirectory() as work:
        folder = Path(work)
        (folder / "authority").mkdir()
        for name in {source for files in cluster.FILES.values() for source in files.values()}:
            (folder / "authority" / name).write_text(name, encoding="utf-8")
            (folder / "authority" / name).chmod(0o600)
        cluster.distribute(folder)
        mounted = folder / "gateway-1"
        pool = {str(file.relative_to(folder / "pool-1")) for file in (folder / "pool-1").rglob("*") if file.is_file()}
        if pool != set(cluster.FILES["pool-1"]) or (folder / "pool-1/workers").stat().st_mode & 0o777 != 0o700:
            sys.exit(f"pool-1 has {pool}")
        before = {file.name: file.stat().st_ino for file in mounted.iterdir()}
        if set(before) != set(cluster.FILES["gateway-1"]) or mounted.stat().st_mode & 0o777 != 0o700:
            sys.exit(f"gateway-1 has {before}")
        readable = {service for service in cluster.FILES if (folder / service).stat().st_mode & 0o077}
        if readable != cluster.READ_BY_A_USER_OF_THE_IMAGE:
            sys.exit(f"others than their owner may read the secrets of {sorted(readable)}")
        (folder / "authority/gateway-1.pem").write_text("renewed", encoding="utf-8")
        cluster.distribute(folder)
        if (mounted / "host.pem").read_text(encoding="utf-8") != "renewed":
            sys.exit("a renewed certificate does not come to its container")
        after = {file.name: file.stat().st_ino for file in mounted.iterdir()}
        if {name for name in before if before[name] != after[name]} != {"host.pem"} or set(after) != set(before):
            sys.exit(f"files changed beside the certificate: {before} {after}")


def check_that_renewal_is_told(file):
    """`./dev cluster certs` tells every service that has a certificate, from inside of its container: one that `docker kill` has
    sent any signal is not started again when it dies later."""
    commands = []
    holders = {name for name in SERVICES & set(file["services"]) if "host.pem" in cluster.FILES.get(name, {})}
    containers = {name: {"Id": f"id-of-{name}", "State": {"Running": True}} for name in SERVICES}
    docker = types.SimpleNamespace(containers=lambda: containers, once=lambda *_: [], compose=lambda *words: ["compose", *words])
    with tempfile.TemporaryDirectory() as folder, \
            mock.patch.multiple(cluster, Docker=lambda: docker, run=lambda *_, **__: types.SimpleNamespace(returncode=0),
                                asked=commands.append, SECRETS=Path(folder), distribute=lambda _: None, say=lambda *_: None):
        cluster.certs(types.SimpleNamespace(verb="renew", words=["gateway-1"]))
    if {tuple(command[:2]) for command in commands} != {("docker", "exec")}:
        sys.exit(f"`./dev cluster certs` tells of it by {commands}")
    if {command[2].removeprefix("id-of-") for command in commands} != holders:
        sys.exit(f"`./dev cluster certs` tells {commands}, and {sorted(holders)} have certificates")


def commands_of_revocation(folder, holder, services):
    """What Docker is told by `./dev cluster certs revoke HOLDER`, beside what it is told by `renew`, while these services run, and
    at the end why the command fails, if it does."""
    commands = []

    def revoke():
        try:
            cluster.certs(types.SimpleNamespace(verb="revoke", words=[holder]))
        except cluster.Refused as why:
            commands.append(["refused:", str(why)])

    containers = {name: {"Id": f"id-of-{name}", "State": {"Running": True}} for name in services}
    docker = types.SimpleNamespace(containers=lambda: containers, once=lambda *_: [], compose=lambda *words: ["compose", *words])
    with mock.patch.multiple(cluster, Docker=lambda: docker, run=lambda *_, **__: types.SimpleNamespace(returncode=0),
                             asked=commands.append, SECRETS=folder, distribute=lambda _: None, say=lambda *_: None):
        revoke()
        told = len(commands)
        commands.clear()
        cluster.certs(types.SimpleNamespace(verb="renew", words=[holder]))
        renewed = len(commands)
        commands.clear()
        revoke()
    if told != len(commands):
        sys.exit(f"a second `./dev cluster certs revoke` does other things: {commands}")
    return [" ".join(command) for command in commands[renewed:]]


def check_revocation():
    """`./dev cluster certs revoke` ends what is open by way of the tunnel, and a gateway's users at the brokers and in the registry."""
    restart = "docker restart id-of-registry-tls"
    with tempfile.TemporaryDirectory() as work:
        folder = Path(work)
        (folder / "authority").mkdir()
        files = {"rabbitmq.users.json": cluster.rabbitmq_users(dict.fromkeys(cluster.RABBITMQ_USERS, "sesame")),
                 "kafka.server.jaas": cluster.kafka_users(dict.fromkeys([*cluster.KAFKA_USERS, "admin"], "sesame")),
                 "registry.users": "master master-1:d=\ngateway gateway-1:d=\ngateway gateway-2:d=\nworker workers:d=\n"}
        for name, text in files.items():
            (folder / "authority" / name).write_text(text, encoding="utf-8")
        told = commands_of_revocation(folder, "topology-2", SERVICES)
        if told != [restart] or any((folder / "authority" / name).read_text() != text for name, text in files.items()):
            sys.exit(f"a revoked worker, whose users others share: {told}")
        told = commands_of_revocation(folder, "gateway-1", SERVICES)
        expected = ["id-of-rabbitmq rabbitmqctl delete_user gateway-1", "id-of-rabbitmq rabbitmqctl delete_user gateway-1-reads",
                    "id-of-kafka env", "id-of-master-1 iotcloud registry rights", restart]
        if len(told) != len(expected) or not all(start in line for start, line in zip(expected, told)):
            sys.exit(f"a revoked gateway: {told}")
        if "--remove --force --allow-principal User:gateway-1 " not in told[2]:
            sys.exit(f"Kafka's rules for a revoked gateway: {told[2]}")
        small = commands_of_revocation(folder, "gateway-1", SERVICES - {"kafka"})
        if small != [told[0], told[1], *told[3:]]:
            sys.exit(f"a revoked gateway without Kafka: {small}")
        for down, left in (({"rabbitmq"}, told[2:]), (set(cluster.MASTERS), [*told[:3], restart])):
            *others, refusal = commands_of_revocation(folder, "gateway-1", SERVICES - down)
            if others != left or not refusal.startswith("refused:") or min(down) not in refusal:
                sys.exit(f"a revoked gateway while {' and '.join(sorted(down))} are down: {others}, {refusal}")
        for name, text in files.items():
            left = (folder / "authority" / name).read_text(encoding="utf-8")
            if name.endswith(".json"):
                kept = {kind: [one for one in every if not {"gateway-1", "gateway-1-reads"} & {one.get("name"), one.get("user")}]
                        for kind, every in json.loads(text).items()}
                good = json.loads(left) == kept
            else:
                good = left.splitlines() == [line for line in text.splitlines() if "gateway-1" not in line]
            if not good:
                sys.exit(f"{name} after the revocation of gateway-1:\n{left}")


def check_down(file):
    """`./dev cluster down` takes the services of all profiles away."""
    profiles = {profile for service in file["services"].values() for profile in service.get("profiles", [])}
    words = ["down", "--volumes", "--remove-orphans"]
    for profile in profiles:
        words = ["--profile", profile, *words]
    asked = []
    docker = types.SimpleNamespace(compose=lambda *given: asked.extend(given))
    with mock.patch.multiple(cluster, Docker=lambda: docker, run=lambda *_, **__: types.SimpleNamespace(returncode=0),
                             SECRETS=Path("/nonexistent/secrets"), say=lambda *_: None):
        cluster.down(types.SimpleNamespace(images=False))
    if sorted(asked) != sorted(words):
        sys.exit(f"`./dev cluster down` asks for {' '.join(asked)}, and the compose file has the profiles {profiles}")


def main():
    text = (ROOT / "docker-compose.yml").read_text(encoding="utf-8")
    file = yaml.safe_load(text)
    found = [*problems_of(file), *problems_of_configurations()]
    if re.search(r"://[^/\s\"]*:[^/\s\"]*@", text):
        found.append("a URL has a password in it")
    if found:
        sys.exit("docker-compose.yml: " + "; ".join(found))
    check_that_it_finds(file)
    check_down(file)
    check_that_renewal_is_told(file)
    check_revocation()
    check_brokers_users()
    check_kafkas_users()
    check_kafkas_quotas()
    check_renewal()
    print(f"{len(file['services'])} services keep the promises")


if __name__ == "__main__":
    main()

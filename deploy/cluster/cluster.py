#!/usr/bin/python3
"""The cluster of docker-compose.yml on this machine's Docker daemon: ./dev cluster up|status|bench|cli|storm|certs|tokens|passwords|down

Its containers belong to the compose project `iotcloud` (COMPOSE_PROJECT_NAME), its files are in build/cluster; `down`
removes both.
"""

import argparse
import base64
import hashlib
import json
import os
import secrets
import shlex
import shutil
import subprocess
import sys
import time
from pathlib import Path

import revocation

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "development"))

import package  # noqa: E402

OUT = ROOT / "build" / "cluster"
SECRETS = OUT / "secrets"
JARS = ROOT / "build" / "storm"  # of topologies for Apache Storm
MASTERS, GATEWAYS = ["master-1", "master-2"], ["gateway-1", "gateway-2"]  # each gets a certificate
WORKERS, POOLS = ["topology-1", "topology-2"], ["pool-1", "pool-2"]  # as these do
USER_OF_IMAGE = 10001  # used when root runs this: the containers' user is never root
REPORT = "/var/lib/iotcloud-reports/cluster.json"
ALL_PROFILES = [word for profile in ("whole", "metrics", "storm", "bench", "tools") for word in ("--profile", profile)]
START_LIMIT_S = 300
FOR_A_YEAR = ["--days", "365"]  # tokens, as certificates


ORDER_KEYS = {f"{master}.orders.pub": f"{master}.orders.pub" for master in MASTERS}
OPERATOR = {name: name for name in ("ca.pem", "revoked.pem", "operator.pem", "operator.key", "admin.token")}


def host_files(name):
    return {"ca.pem": "ca.pem", "revoked.pem": "revoked.pem", "host.pem": f"{name}.pem", "host.key": f"{name}.key"}


def own_pages(name):
    """Whom a daemon's pages take, and the token by which its own health check reads them."""
    return {"pages.tokens": f"{name}.pages.tokens", "health.token": f"{name}.health.token"}


def of_workers(name):
    """What a worker of the registry and the brokers finds; its pages take the token of a master."""
    return {"ca.pem": "ca.pem", "revoked.pem": "revoked.pem", **ORDER_KEYS, "pages.tokens": "pages.tokens",
            "registry.users": "registry.users", "registry.password": "workers.registry.password",
            "rabbitmq.password": "workers.rabbitmq.password", "kafka.password": "workers.kafka.password",
            "host.pem": f"{name}.pem", "host.key": f"{name}.key"}


def certificate_of_workers(pool):
    """The holder of the certificate that a pool's workers show: the components in them read its key, and not the pool's."""
    return f"{pool}-workers"


# What each service finds in /run/secrets, and whence: a file of the folder `authority`.
FILES = {
    "registry-tls": host_files("registry-tls"),
    "rabbitmq": {**host_files("rabbitmq"), "users.json": "rabbitmq.users.json"},
    "kafka": {"server.jaas": "kafka.server.jaas", "admin.properties": "kafka.admin.properties"},
    **{name: {**host_files(name), **ORDER_KEYS, "masters.tokens": "masters.tokens", "orders.key": f"{name}.orders.key",
              "pages.token": f"{name}.pages.token", **own_pages(name), "registry.users": "registry.users",
              "registry.password": f"{name}.registry.password",
              **{f"{asked}.token": f"{name}-{asked}.token" for asked in GATEWAYS + POOLS}} for name in MASTERS},
    **{name: {**host_files(name), **ORDER_KEYS, **own_pages(name), "plugins.pub": "plugins.pub", "tokens": f"{name}.tokens", "registry.users": "registry.users",
              "registry.password": f"{name}.registry.password", "rabbitmq.password": f"{name}.rabbitmq.password",
              "rabbitmq-reads.password": f"{name}-reads.rabbitmq.password", "kafka.password": f"{name}.kafka.password"}
       for name in GATEWAYS},
    **{name: {**of_workers(name), "health.token": f"{name}.pages.token"} for name in WORKERS},
    # A pool's workers reach the folder `workers` only.
    **{name: {**host_files(name), **ORDER_KEYS, "pages.tokens": "pages.tokens", "health.token": f"{name}.pages.token",
              "registry.users": "registry.users", "registry.password": "workers.registry.password", "tokens": f"{name}.tokens",
              "plugins.pub": "plugins.pub",
              **{f"workers/{file}": source for file, source in of_workers(certificate_of_workers(name)).items()}} for name in POOLS},
    "supervisor": {"ca.pem": "ca.pem", "revoked.pem": "revoked.pem", "registry.users": "registry.users",
                   "registry.password": "workers.registry.password", "rabbitmq.password": "workers.rabbitmq.password"},
    "prometheus": {"ca.pem": "ca.pem", "host.pem": "prometheus.pem", "host.key": "prometheus.key",
                   "prometheus.token": "prometheus.token"},
    "operator": OPERATOR,
    "bench": {**OPERATOR, "rabbitmq.password": "bench.rabbitmq.password", "kafka.password": "bench.kafka.password"},
}
# The servers of these images run as a user of the image's own, who must read them. On this machine nobody gets there, because the
# folder above is for its owner only.
READ_BY_A_USER_OF_THE_IMAGE = {"kafka", "supervisor"}

# What each user of RabbitMQ may configure, write and read, and with which routing keys it may write to the gateways' exchange
# and read from it (keys and queues begin with the gateway's id, docs/wire.md#topics). All gateways have the exchange amq.topic,
# because RabbitMQ looks at routing keys there only. Each gateway has two users. The server looks at them when a client publishes,
# not at what comes out of a queue or an exchange: who may declare these could send anything through them, if he might also write
# to the exchange.
GATEWAYS_EXCHANGE = "amq.topic"
EXCHANGE = GATEWAYS_EXCHANGE.replace(".", r"\.")
NOTHING, EVERYTHING = "^$", ".*"


def rights_of_gateway(gateway):
    own = rf"{gateway}\..+"
    return {
        gateway: {"configure": NOTHING, "write": f"^{EXCHANGE}$", "read": NOTHING, "keys": f"^{own}$"},
        f"{gateway}-reads": {"configure": f"^{own}$", "write": f"^{own}$", "read": f"^({EXCHANGE}|{own})$", "keys": f"^{own}$"},
    }


def rights_of_workers():
    keys = rf"({'|'.join(GATEWAYS)})\..+"
    # Exchanges have the name of a driver, with or without `.durable`, where a topic is not a gateway's (dead letters).
    names = rf"^({EXCHANGE}|[^.]+(\.durable)?|{keys})$"
    return {"configure": names, "write": names, "read": names, "keys": f"^{keys}$"}


RABBITMQ_USERS = {
    **{user: rights for gateway in GATEWAYS for user, rights in rights_of_gateway(gateway).items()},
    "workers": rights_of_workers(),
    "bench": dict.fromkeys(("configure", "write", "read", "keys"), EVERYTHING),  # its bare clients have names of their own
}


# What RabbitMQ keeps of what one user could take from all others: a server whose memory or disk runs full takes no message from
# anybody. Of connections and channels each user has so many; of queues there are so many for all, and in each so many bytes wait. A
# message for a queue that is full is refused, and waits at its sender: of those that were taken none is lost.
USER_LIMITS = {**dict.fromkeys((user for gateway in GATEWAYS for user in rights_of_gateway(gateway)),
                               {"max-connections": 128, "max-channels": 2048}),
               "workers": {"max-connections": 512, "max-channels": 8192}}
MOST_QUEUES = 4000
QUEUE_LIMITS = {"max-length-bytes": 128 * 1024 * 1024, "overflow": "reject-publish"}

# The users of Kafka; what each may do is in the file kafka-rights, and how much in kafka-quotas. The administrator gives them these.
KAFKA_USERS = [*GATEWAYS, "workers", "bench"]
KAFKA_ADMINISTRATOR = "admin"


class Refused(Exception):
    """The command cannot work here; the text says why, and how to mend that."""


def say(text):
    print(f"\033[1m==>\033[0m {text}", flush=True)


def project():
    return os.environ.get("COMPOSE_PROJECT_NAME", "iotcloud")


def user_id():
    return os.getuid() or USER_OF_IMAGE


def environment(**more):
    """The variables of docker-compose.yml; those that the caller has set win."""
    processors = min(2, os.cpu_count() or 1)
    ours = {"COMPOSE_PROJECT_NAME": project(), "IOTCLOUD_UID": str(user_id()), "SECRETS": str(SECRETS),
            "BROKER_CPUS": str(processors), "DOCKER_BUILDKIT": "1", "COMPOSE_DOCKER_CLI_BUILD": "1",
            "BUILDKIT_PROGRESS": "plain", "IOTCLOUD_VERSION": package.version_here()}
    return {**ours, **os.environ, **more}


def run(command, **options):
    options.setdefault("env", environment())
    return subprocess.run(command, cwd=ROOT, text=True, **options)


def asked(command):
    """Runs a command and returns its output. Raises Refused with its complaint."""
    done = run(command, capture_output=True)
    if done.returncode:
        raise Refused(f"{' '.join(command)}: {(done.stderr or done.stdout).strip()}")
    return done.stdout


class Docker:
    """The Docker daemon, and whichever compose is installed."""

    def __init__(self):
        how = "install it (Debian: apt install docker.io docker-compose) and start its daemon"
        if not shutil.which("docker"):
            raise Refused(f"there is no program docker: {how}")
        answer = run(["docker", "version", "--format", "{{.Server.Version}}"], capture_output=True)
        if answer.returncode:
            raise Refused(f"no Docker daemon answers: {answer.stderr.strip()}\nWithout one {how}; one that runs may ask "
                          "for root or the group docker, or be elsewhere (DOCKER_HOST)")
        if "rootless" in asked(["docker", "info", "--format", "{{.SecurityOptions}}"]):
            raise Refused("this daemon is rootless: it gives containers other users than files have here, so that they "
                          "cannot read their secrets; use one that runs as root")
        for command in (["docker", "compose"], ["docker-compose"]):
            if shutil.which(command[0]) and run([*command, "version"], capture_output=True).returncode == 0:
                self.command = command
                return
        raise Refused("there is neither `docker compose` nor `docker-compose`: install one (Debian: apt install "
                      "docker-compose)")

    def compose(self, *words):
        return [*self.command, "-f", str(ROOT / "docker-compose.yml"), *words]

    def once(self, service, *words, entrypoint=None):
        """The command line of a container that runs once, beside the others."""
        terminal = [] if sys.stdin.isatty() and sys.stdout.isatty() else ["-T"]
        other = ["--entrypoint", entrypoint] if entrypoint else []
        return self.compose("run", "--rm", "--no-deps", *terminal, *other, service, *words)

    def containers(self):
        """What docker says of the project's containers, by service. A container that starts or ends may be missing."""
        ours = [f"--filter=label=com.docker.compose.project={project()}", "--filter=label=com.docker.compose.oneoff=False"]
        listed = asked(["docker", "ps", "-a", "--no-trunc", *ours, "--format", "{{.ID}}"]).split()
        told = run(["docker", "inspect", *listed], capture_output=True) if listed else None
        if told and told.returncode and "No such object" not in told.stderr:
            raise Refused(f"docker inspect: {told.stderr.strip()}")
        found = json.loads(told.stdout) if told else []
        return {container["Config"]["Labels"]["com.docker.compose.service"]: container for container in found}


def state_of(container):
    state = container["State"]
    return state.get("Health", {}).get("Status") or state["Status"] if state["Running"] else state["Status"]


def follow(process, log, what):
    """Waits for a process that writes a log, and prints its last line twice a minute."""
    begin = told = time.monotonic()
    while process.poll() is None:
        time.sleep(0.2)
        if time.monotonic() - told > 30:
            told = time.monotonic()
            lines = log.read_text(errors="replace").splitlines()
            print(f"    {what}, {(told - begin) / 60:.1f} min: {lines[-1][:100] if lines else ''}", flush=True)
    if process.returncode:
        tail = "\n".join(log.read_text(errors="replace").splitlines()[-30:])
        raise Refused(f"{tail}\n{what} failed; all it said is in {log}")


def build(docker, service):
    OUT.mkdir(parents=True, exist_ok=True)
    log = OUT / f"build-{service}.log"
    begin = time.monotonic()
    say(f"the image of {service} (from source it takes long the first time; log: {log.relative_to(ROOT)})")
    with open(log, "w", encoding="utf-8") as out:
        process = subprocess.Popen(docker.compose("build", service), cwd=ROOT, env=environment(), stdout=out,
                                   stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL)
        try:
            follow(process, log, "building")
        finally:
            process.terminate()
    say(f"it is there after {time.monotonic() - begin:.0f} s")


def write_secret(folder, name, text):
    file = folder / name
    file.touch(0o600)
    file.write_text(text + "\n", encoding="utf-8")
    if os.getuid() == 0:
        os.chown(file, user_id(), user_id())


def hashed_for_rabbitmq(password):
    """https://www.rabbitmq.com/docs/passwords: four bytes of salt, and SHA-256"""
    salt = secrets.token_bytes(4)
    return base64.b64encode(salt + hashlib.sha256(salt + password.encode()).digest()).decode()


def rabbitmq_users(passwords):
    """RabbitMQ's definitions of its users, with their limits: no other is there, and none is an administrator."""
    return json.dumps({
        "vhosts": [{"name": "/"}],
        "users": [{"name": user, "password_hash": hashed_for_rabbitmq(password), "hashing_algorithm": "rabbit_password_hashing_sha256",
                   "tags": "", "limits": USER_LIMITS.get(user, {})} for user, password in passwords.items()],
        "permissions": [{"user": user, "vhost": "/", **{what: rights[what] for what in ("configure", "write", "read")}}
                        for user, rights in RABBITMQ_USERS.items()],
        "topic_permissions": [{"user": user, "vhost": "/", "exchange": GATEWAYS_EXCHANGE, "write": rights["keys"],
                               "read": rights["keys"]} for user, rights in RABBITMQ_USERS.items()],
        "parameters": [{"vhost": "/", "component": "vhost-limits", "name": "limits", "value": {"max-queues": MOST_QUEUES}}],
        "policies": [{"vhost": "/", "name": "limits", "pattern": ".*", "apply-to": "queues", "priority": 0,
                      "definition": QUEUE_LIMITS}]}, indent=1)


def kafka_users(passwords):
    """What Kafka reads of its users, the administrator among them, as which it also speaks to itself."""
    own = f'username="{KAFKA_ADMINISTRATOR}" password="{passwords[KAFKA_ADMINISTRATOR]}"'
    users = "".join(f'\n    user_{user}="{password}"' for user, password in passwords.items())
    return f"KafkaServer {{\n  org.apache.kafka.common.security.plain.PlainLoginModule required\n    {own}{users};\n}};"


def kafka_administrator(passwords):
    """The administrator's access, for Kafka's own programs."""
    return ("security.protocol=SASL_PLAINTEXT\nsasl.mechanism=PLAIN\n"
            "sasl.jaas.config=org.apache.kafka.common.security.plain.PlainLoginModule required "
            f'username="{KAFKA_ADMINISTRATOR}" password="{passwords[KAFKA_ADMINISTRATOR]}";')


def distribute(folder):
    """Gives each service its files of the authority's folder. A file that changed is replaced in one step, which a daemon
    sees in the folder that it has mounted."""
    for service, files in FILES.items():
        own = folder / service
        for inner in sorted({own, *((own / target).parent for target in files)}):
            inner.mkdir(mode=0o700, exist_ok=True)
            if os.getuid() == 0:
                os.chown(inner, user_id(), user_id())
        for target, source in files.items():
            given, fresh = folder / "authority" / source, own / (target + ".new")
            if (own / target).exists() and (own / target).read_bytes() == given.read_bytes():
                continue
            shutil.copy(given, fresh)  # with its permissions
            if service in READ_BY_A_USER_OF_THE_IMAGE:
                fresh.chmod(0o644)
            if os.getuid() == 0:
                os.chown(fresh, user_id(), user_id())
            fresh.replace(own / target)
        if service in READ_BY_A_USER_OF_THE_IMAGE:
            own.chmod(0o755)


def make_secrets(docker):
    """Makes certificates, tokens and passwords, readable by the containers' user only: all of them, or none."""
    if SECRETS.exists():
        missing = sorted({service for service, files in FILES.items() for name in files if not (SECRETS / service / name).exists()})
        if missing:
            raise Refused(f"{SECRETS.relative_to(ROOT)} was made by an earlier version, and has not what these need: "
                          f"{', '.join(missing)}; `./dev cluster down` takes it away, then `up` makes it anew")
        return
    say(f"certificates, tokens and passwords, in {SECRETS.relative_to(ROOT)}")
    fresh = SECRETS.with_name("secrets.new")
    shutil.rmtree(fresh, ignore_errors=True)
    all_of_it, fresh = fresh, fresh / "authority"
    fresh.mkdir(parents=True, mode=0o700)
    for folder in (all_of_it, fresh):
        folder.chmod(0o700)
        if os.getuid() == 0:
            os.chown(folder, user_id(), user_id())

    def iotcloud(*words):
        done = run(docker.once("secrets", *words), capture_output=True, env=environment(SECRETS=str(all_of_it)))
        if done.returncode:
            raise Refused(f"iotcloud {' '.join(words)}: {done.stderr.strip()}")
        return done.stdout.strip()

    iotcloud("certs", "init", "/secrets", "--host", ",".join([*MASTERS, *GATEWAYS, *WORKERS, *POOLS, "registry-tls", "rabbitmq", "prometheus"]))
    for pool in POOLS:
        iotcloud("certs", "add", "/secrets", "--host", pool, "--daemon", certificate_of_workers(pool))
    write_secret(fresh, "admin.token",  # a person's, of no use to whoever catches it in a master's place
                 iotcloud("token", "add", *FOR_A_YEAR, "admin", "--role", "admin", "--certificate", "/secrets/operator.pem",
                          "--file", "/secrets/masters.tokens"))
    for master in MASTERS:
        for asked in GATEWAYS + POOLS:
            write_secret(fresh, f"{master}-{asked}.token",
                         iotcloud("token", "add", *FOR_A_YEAR, master, "--role", "master", "--certificate", f"/secrets/{master}.pem",
                                  "--file", f"/secrets/{asked}.tokens"))
    for reader in MASTERS + WORKERS + POOLS:  # of the workers' pages; a worker's or pool's health check reads its own
        write_secret(fresh, f"{reader}.pages.token",
                     iotcloud("token", "add", *FOR_A_YEAR, reader, "--role", "viewer", "--certificate", f"/secrets/{reader}.pem",
                              "--file", "/secrets/pages.tokens"))
    for daemon in MASTERS + GATEWAYS:
        write_secret(fresh, f"{daemon}.health.token",
                     iotcloud("token", "add", *FOR_A_YEAR, daemon, "--role", "viewer", "--certificate", f"/secrets/{daemon}.pem",
                              "--file", f"/secrets/{daemon}.pages.tokens"))
    write_secret(fresh, "prometheus.token",
                 iotcloud("token", "add", *FOR_A_YEAR, "prometheus", "--role", "viewer", "--certificate", "/secrets/prometheus.pem",
                          "--file", "/secrets/prometheus.tokens"))
    for file in ["pages.tokens", *(f"{daemon}.pages.tokens" for daemon in MASTERS + GATEWAYS)]:
        with open(fresh / file, "a", encoding="utf-8") as tokens:  # one token, which all daemons know
            tokens.write((fresh / "prometheus.tokens").read_text(encoding="utf-8"))
    iotcloud("keys", "new", "/secrets/plugins")  # signs plugins that are sent
    for master in MASTERS:
        iotcloud("keys", "new", f"/secrets/{master}.orders")  # signs its orders
    roles = {**dict.fromkeys(MASTERS, "master"), **dict.fromkeys(GATEWAYS, "gateway"), "workers": "worker"}
    for user, role in roles.items():
        write_secret(fresh, f"{user}.registry.password",
                     iotcloud("registry", "user", user, "--role", role, "--file", "/secrets/registry.users"))
    passwords = {user: secrets.token_hex(24) for user in RABBITMQ_USERS}
    for user, password in passwords.items():
        write_secret(fresh, f"{user}.rabbitmq.password", password)
    write_secret(fresh, "rabbitmq.users.json", rabbitmq_users(passwords))
    passwords = {user: secrets.token_hex(24) for user in [*KAFKA_USERS, KAFKA_ADMINISTRATOR]}
    for user in KAFKA_USERS:
        write_secret(fresh, f"{user}.kafka.password", passwords[user])
    write_secret(fresh, "kafka.server.jaas", kafka_users(passwords))
    write_secret(fresh, "kafka.admin.properties", kafka_administrator(passwords))
    distribute(all_of_it)
    all_of_it.rename(SECRETS)


def wait_until_healthy(docker, process, log):
    begin, known = time.monotonic(), {}
    while True:
        ended = process.poll()
        containers = docker.containers()
        for service, container in sorted(containers.items()):
            state = state_of(container)
            if known.get(service) != state:
                known[service] = state
                print(f"    {time.monotonic() - begin:5.1f} s  {service}: {state}", flush=True)
        if ended:
            raise Refused(f"{log.read_text(errors='replace').strip()}\nthe cluster did not start: "
                          "`./dev cluster status`, `docker logs CONTAINER`; `./dev cluster down` takes it away")
        if ended == 0 and known and all(state == "healthy" for state in known.values()):
            say(f"{len(known)} containers are healthy after {time.monotonic() - begin:.0f} s")
            return
        if time.monotonic() - begin > START_LIMIT_S:
            waiting = sorted(f"{service}: {state}" for service, state in known.items() if state != "healthy")
            raise Refused(f"not within {START_LIMIT_S} s: {', '.join(waiting)}; see `docker logs CONTAINER`")
        time.sleep(0.3)


HOW_TO = """
The topology `echo` sends back what load generators send. Look at the cluster, deploy one, and take it away:

  ./dev cluster cli status
  ./dev cluster cli deploy loadgen.so --gateway gateway-1 --property rate=100
  ./dev cluster cli drivers
  ./dev cluster cli logs --help
  ./dev cluster cli undeploy --driver loadgen

Two pools run the topologies that are submitted, such as one that sends back what the driver `mirrored` sends:

  ./dev cluster cli topology submit deploy/cluster/submitted/mirror.yaml --workers 2
  ./dev cluster cli deploy loadgen.so --driver mirrored --gateway gateway-1 --property rate=100
  ./dev cluster cli topology kill mirror

{storm}The command line sees this folder: `./dev cluster cli deploy --plugin ./build/release/plugins/turtle.so ...` sends a file.
`./dev cluster bench` measures, `./dev cluster down` takes everything away.
"""
HOW_TO_STORM = """Apache Storm runs the topologies that are packed for it, such as one that does the same for the driver `mirrored-on-storm`:

  ./dev build && ./dev storm jar
  build/release/bin/iotcloud topology pack deploy/cluster/submitted/mirror-on-storm.yaml build/storm/mirror.jar
  ./dev cluster storm jar mirror.jar iotcloud.storm.Submit
  ./dev cluster storm list

"""


def up(given):
    docker = Docker()
    build(docker, "master-1")
    make_secrets(docker)
    say("starting" + (" without Kafka" if given.small else ""))
    profile = [] if given.small else ["--profile", "whole"]
    for name in ("metrics", "storm"):
        profile += ["--profile", name] if getattr(given, name) else []
    log = OUT / "up.log"
    with open(log, "w", encoding="utf-8") as out:
        process = subprocess.Popen(docker.compose(*profile, "up", "-d", "--no-build"), cwd=ROOT, env=environment(),
                                   stdout=out, stderr=subprocess.STDOUT, stdin=subprocess.DEVNULL)
        try:
            wait_until_healthy(docker, process, log)
        finally:
            process.terminate()
            process.wait()
    say("closing ZooKeeper's own nodes to those without a credential")
    until_done(["docker", "exec", docker.containers()[MASTERS[0]]["Id"], *revocation.rights(MASTERS[0])])
    print(HOW_TO.format(storm=HOW_TO_STORM if given.storm else ""))


def require_up(docker):
    containers = docker.containers()
    if not containers:
        raise Refused("the cluster is not up: ./dev cluster up")
    return containers


def status(_):
    docker = Docker()
    containers = require_up(docker)
    print(f"{'SERVICE':12} {'STATE':10} {'RESTARTS':>8}  PORTS ON THIS MACHINE")
    for service, container in sorted(containers.items()):
        bound = container["NetworkSettings"]["Ports"] or {}
        ports = [f"{each['HostIp']}:{each['HostPort']} -> {port}" for port, hosts in bound.items() for each in hosts or []]
        print(f"{service:12} {state_of(container):10} {container['RestartCount']:8}  {', '.join(ports)}")
    print(flush=True)
    if run(docker.once("cli", "status"), stderr=subprocess.DEVNULL).returncode:
        raise Refused("no master answers")
    return 0 if all(state_of(container) == "healthy" for container in containers.values()) else 1


def bench(given):
    docker = Docker()
    require_up(docker)
    build(docker, "bench")
    commit = run(["git", "describe", "--always", "--dirty", "--abbrev=40"], capture_output=True).stdout.strip() or "unknown"
    done = run(docker.once("bench", "--commit", commit, *(["--quick"] if given.quick else [])))
    if done.returncode:
        raise Refused(f"the benchmark failed with status {done.returncode}")
    report = OUT / "cluster.json"
    report.write_text(asked(docker.once("bench", REPORT, entrypoint="cat")), encoding="utf-8")
    say(f"the report is in the volume {project()}_reports, and in {report.relative_to(ROOT)}")


def become(docker, service, words):
    """Goes on as a service's command line."""
    os.chdir(ROOT)
    command = docker.once(service, *words)
    os.execvpe(command[0], command, environment())


def cli(given):
    docker = Docker()
    require_up(docker)
    become(docker, "cli", given.words)


def storm(given):
    docker = Docker()
    if "nimbus" not in require_up(docker):
        raise Refused("the cluster is up without Apache Storm: ./dev cluster up --storm")
    JARS.mkdir(exist_ok=True)  # Docker would make it root's
    become(docker, "storm", given.words)


def certs(given):
    docker = Docker()
    if not SECRETS.exists():
        raise Refused("there are no certificates: ./dev cluster up")
    of_workers_too = [certificate_of_workers(holder) for holder in given.words if holder in POOLS]
    done = run(docker.once("secrets", "certs", given.verb, "/secrets", *given.words, *of_workers_too))
    if done.returncode:
        raise Refused(f"iotcloud certs {given.verb} failed with status {done.returncode}")
    gone = [holder for holder in given.words if holder in GATEWAYS] if given.verb == "revoke" else []
    for gateway in gone:
        revocation.forget(SECRETS / "authority", gateway)
    distribute(SECRETS)
    # Daemons look by themselves within seconds; the tunnels read their files again only when they are told. They are told from
    # inside: a container that `docker kill` has sent a signal, whichever, is not started again when it dies later.
    told = {**dict.fromkeys([*MASTERS, *GATEWAYS, *WORKERS, *POOLS, "registry-tls", "prometheus"], ["sh", "-c", "kill -HUP 1"]),
            "rabbitmq": ["bash", "/etc/iotcloud/rabbitmq-certificate", "renewed"]}
    running = {service: container["Id"] for service, container in docker.containers().items()
               if service in told and container["State"]["Running"]}
    untold = []
    for service, container in running.items():
        try:
            asked(["docker", "exec", container, *told[service]])
        except Refused as why:
            untold.append(f"{service}: {why}")
    if untold:
        raise Refused("not told of the new files, so run the command again once they are well: " + "; ".join(untold))
    say(f"given to {len(running)} containers, which go on with them")
    if given.verb == "revoke":
        cut_off(docker, gone)


def tokens(_):
    """Puts off the end of all tokens. Their holders keep them, and daemons see it within seconds."""
    docker = Docker()
    if not SECRETS.exists():
        raise Refused("there are no tokens: ./dev cluster up")
    files = sorted((SECRETS / "authority").glob("*.tokens"))
    renewals = ["set -e", *(shlex.join(["iotcloud", "token", "renew", holder, *FOR_A_YEAR, "--file", f"/secrets/{file.name}"])
                            for file in files for holder in holders_in(file))]
    asked(docker.once("secrets", "-c", "\n".join(renewals), entrypoint="sh"))
    distribute(SECRETS)
    say(f"{len(renewals) - 1} tokens in {len(files)} files count for another year")


def holders_in(tokens_file):
    lines = tokens_file.read_text(encoding="utf-8").splitlines()
    return [line.split(":")[0] for line in lines if line and not line.startswith("#")]


def passwords(_):
    """Gives the workers, who share theirs, other passwords at the registry and the brokers, after one of them was stolen; ends what is
    open with the old ones, and starts all daemons again, because they read passwords and users when they start."""
    docker = Docker()
    if not SECRETS.exists():
        raise Refused("there are no passwords: ./dev cluster up")
    authority, of_brokers = SECRETS / "authority", {broker: secrets.token_hex(24) for broker in ("rabbitmq", "kafka")}
    revocation.replace_passwords(authority, hashed_for_rabbitmq(of_brokers["rabbitmq"]), of_brokers["kafka"])
    for broker, password in of_brokers.items():
        write_secret(authority, f"workers.{broker}.password", password)
    made = run(docker.once("secrets", "registry", "user", "workers", "--role", "worker", "--file", "/secrets/registry.users"),
               capture_output=True)
    if made.returncode:
        raise Refused(f"iotcloud registry user failed, run the command again: {made.stderr.strip()}")
    write_secret(authority, "workers.registry.password", made.stdout.strip())
    distribute(SECRETS)
    running = {service: container["Id"] for service, container in docker.containers().items() if container["State"]["Running"]}
    if "rabbitmq" in running:
        for command in revocation.commands_for_passwords():
            asked(["docker", "exec", running["rabbitmq"], *command])
    again = [service for service in ("kafka", *MASTERS, *GATEWAYS, *WORKERS, *POOLS, "supervisor") if service in running]
    say(f"the workers have other passwords; starting again: {', '.join(again)}")
    asked(["docker", "restart", *(running[service] for service in again)])
    master = next((master for master in MASTERS if master in running), None)
    if not master:
        raise Refused("the registry's nodes have their old rights, because no master runs: run the command again once one does")
    until_done(["docker", "exec", running[master], *revocation.rights(master)])
    say("the old passwords of the workers open nothing any more")


def until_done(command):
    """Runs a command until it succeeds, in a container that is starting."""
    deadline, told = time.monotonic() + START_LIMIT_S, ""
    while True:
        try:
            return asked(command)
        except Refused as refused:
            if time.monotonic() > deadline:
                raise
            if str(refused) != told:
                told = str(refused)
                say(f"tried again: {told}")
            time.sleep(1)


def cut_off(docker, gateways):
    """Ends what holders of revoked certificates still have: a tunnel that was open, and gateways' users. What cannot be done keeps
    nothing else from being done."""
    running = {service: container["Id"] for service, container in docker.containers().items() if container["State"]["Running"]}
    kept = []
    for gateway in gateways:
        master = next((master for master in MASTERS if master in running), MASTERS[0])
        before = len(kept)
        for service, command in revocation.commands(gateway, master):
            its_user = f"{gateway} keeps its user of {'the registry' if service == master else service}"
            if service in running:
                try:
                    asked(["docker", "exec", running[service], *command])
                except Refused as why:
                    if "does not exist" not in str(why):  # a user who went before
                        kept.append(f"{its_user}: {why}")
            elif service != "kafka":
                kept.append(f"{its_user}: {service} does not run")
        if len(kept) == before:
            say(f"{gateway} has no user at the brokers and in the registry any more; another gateway takes its place after "
                "`./dev cluster down` and `up`")
    if "registry-tls" in running:
        # Sessions outlive the seconds that it takes.
        asked(["docker", "restart", running["registry-tls"]])
        say("the tunnels to the registry are open anew, for those who may")
    if kept:
        raise Refused("; ".join(dict.fromkeys(kept)) + ": run the command again once they are well")


def down(given):
    docker = Docker()
    done = run(docker.compose(*ALL_PROFILES, "down", "--volumes", "--remove-orphans"))
    if done.returncode:
        raise Refused(f"docker compose down failed with status {done.returncode}")
    for folder in (SECRETS, SECRETS.with_name("secrets.new")):
        shutil.rmtree(folder, ignore_errors=True)
    if given.images:
        for image in ("iotcloud:local", "iotcloud-bench:local"):
            run(["docker", "image", "rm", image], capture_output=True)
    say("containers, networks, volumes and secrets are gone" + ("" if given.images else
                                                                 "; images stay for the next time (--images: they go too)"))


def main():
    own = {"cli": cli, "storm": storm}.get(sys.argv[1] if len(sys.argv) > 1 else "")
    if own:  # all words behind belong to that program
        return own(argparse.Namespace(words=sys.argv[2:]))
    parser = argparse.ArgumentParser(prog="./dev cluster", description="A whole IoTCloud in containers")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    def command(name, function, what):
        sub = commands.add_parser(name, help=what, description=what)
        sub.set_defaults(function=function)
        return sub

    sub = command("up", up, "build the images, make the secrets, start it and wait until all is healthy")
    sub.add_argument("--small", action="store_true", help="without Kafka")
    sub.add_argument("--metrics", action="store_true", help="with a Prometheus that reads all daemons' pages")
    sub.add_argument("--storm", action="store_true", help="with Apache Storm")
    command("status", status, "what runs, and what the masters say")
    command("bench", bench, "measure round trips through it").add_argument(
        "--quick", action="store_true", help="fewer sizes and rounds")
    command("cli", cli, "the command line iotcloud, as an admin")
    command("storm", storm, "Apache Storm's own command line")
    sub = command("certs", certs, "renew or revoke certificates, and give them to the containers, which go on")
    sub.add_argument("verb", choices=["renew", "revoke"])
    sub.add_argument("words", nargs=argparse.REMAINDER, help="as those of `iotcloud certs`, without the folder")
    command("tokens", tokens, "let all tokens count for another year, without a restart").add_argument("verb", choices=["renew"])
    command("passwords", passwords, "give the workers, who share theirs, other passwords, and start all daemons again").add_argument(
        "verb", choices=["renew"])
    command("down", down, "take away all that `up` made").add_argument(
        "--images", action="store_true", help="the images too")
    given = parser.parse_args()
    return given.function(given)


if __name__ == "__main__":
    try:
        sys.exit(main())
    except Refused as problem:
        sys.exit(str(problem))
    except KeyboardInterrupt:
        sys.exit("interrupted: `./dev cluster down` takes away what is there")

#!/usr/bin/python3
"""A private Kafka for tests and benchmarks, on loopback only, that leaves nothing behind.

    kafka.py --dir DIR [--port N] [--partitions N] [--tls] [--throughput] [--acls] [--users] [--listener PORT:ADVERTISED]...

Runs one node (KRaft: broker and controller in one JVM) with its data and log below DIR, on free ports. Its jars come
from Maven Central (maven_jars.py). Topics are made when they are first used, with --partitions partitions (default 1).
When the node takes requests it prints one line on stdout:

    READY kafka://127.0.0.1:PORT

(or `SKIP text` when the jars cannot be fetched; with CI=true that is an `ERROR text`). Then it obeys one command for
each line of stdin and answers with one line on stdout:

    kill    SIGKILL to the node                    KILLED
    start   starts it again, same port and data    READY kafka://...
    pause   SIGSTOP to the node: it hangs          PAUSED
    resume  SIGCONT                                RESUMED
    stop    ends everything                        STOPPED

With --acls there are also

    forbid  nobody may write to any topic          FORBIDDEN
    permit  everybody may again                    PERMITTED

The end of stdin means `stop`, so the server ends with whoever started it. A command that fails answers `ERROR text`.
Data of an earlier run in DIR are kept. What was confirmed survives `kill`: the log's pages are the kernel's by then.

With --listener it also listens on PORT, and whoever comes there is told to go on at the port ADVERTISED: that of a proxy.

With --tls the URL is kafkas://localhost:PORT: the server wants a client certificate, and user and password (SASL PLAIN;
certificates.py; the files are in DIR). With --users it has the users of docker-compose.yml, each with the password `sesame` and
with the rights that it has there, and quotas, which are lower; `READY` comes when they have them. Then there are also

    cut_off  gateway-2, as `./dev cluster certs revoke gateway-2` does    CUT_OFF
    let_in   gives it back what that took                                 LET_IN
"""
import os
import struct
import subprocess
import sys
import time

import certificates
import maven_jars
import private_server

# Requests of Kafka's protocol.
METADATA, SASL_HANDSHAKE, DESCRIBE_ACLS, CREATE_ACLS, DELETE_ACLS, SASL_AUTHENTICATE = 3, 17, 29, 30, 31, 36
# Words of its access rules.
ANY, TOPIC, LITERAL = 1, 2, 3
ALL, WRITE = 2, 4
DENY, ALLOW = 2, 3
CLUSTER = os.path.abspath(os.path.join(os.path.dirname(__file__), "..", "..", "deploy", "cluster"))
PASSWORD_OF_USERS = "sesame"
RULES_LIMIT_S = 120
QUOTA_OF_GATEWAY = "1048576"  # bytes a second, which a slow machine can exceed, too


class Kafka(private_server.Server):
    name = "Kafka"

    def __init__(self, folder, port, partitions, tls, jvm=private_server.QUICK_START, listeners=(), acls=False,
                 users=False):
        """`listeners`: (port, advertised port) of those beside the clients' own. `acls`: forbid() and permit() work.
        `users`: those of docker-compose.yml."""
        super().__init__(folder)
        self.acls = acls
        self.users = self.write_users() if users else None
        self.jvm = jvm
        self.listeners = listeners
        self.class_path = maven_jars.fetch("kafka")
        ports = private_server.free_ports(2)
        self.port, self.controller_port = port or ports[0], ports[1]
        if tls:
            self.certificates = certificates.Certificates(self.folder)
        self.partitions = partitions
        self.configure(1, {1: self.controller_port})

    def configure(self, number, controllers):
        """Writes the configuration. `controllers`: by node number, the controller port of each node of the cluster
        (kafka_cluster.py)."""
        copies = len(controllers)
        self.peers = copies  # number of nodes that this one must see before it is ready
        protocol = "SASL_SSL" if self.certificates else "SASL_PLAINTEXT" if self.users else "PLAINTEXT"
        more = ["LINK%d" % number for number in range(len(self.listeners))]
        self.config = self.write("server.properties", [
            "process.roles=broker,controller", "node.id=%d" % number,
            "controller.quorum.voters=" + ",".join("%d@127.0.0.1:%d" % item for item in controllers.items()),
            "controller.listener.names=CONTROLLER", "inter.broker.listener.name=CLIENT",
            "listener.security.protocol.map=CONTROLLER:%s," % ("SASL_PLAINTEXT" if self.users else "PLAINTEXT") + ",".join(
                "%s:%s" % (name, protocol) for name in ["CLIENT", *more]),
            ",".join(["listeners=CLIENT://127.0.0.1:%d" % self.port, "CONTROLLER://127.0.0.1:%d" % self.controller_port] + [
                "%s://127.0.0.1:%d" % (name, port) for name, (port, _) in zip(more, self.listeners)]),
            ",".join(["advertised.listeners=CLIENT://%s:%d" % (self.host(), self.port)] + [
                "%s://%s:%d" % (name, self.host(), port) for name, (_, port) in zip(more, self.listeners)]),
            "log.dirs=" + self.path("data"), "num.partitions=%d" % self.partitions, "auto.create.topics.enable=true",
            # Allows bodies of 8 MB and more, with their envelope and headers.
            "message.max.bytes=16777216", "replica.fetch.max.bytes=16777216", "socket.request.max.bytes=33554432",
            # A record is confirmed when a majority of the nodes has it.
            "min.insync.replicas=%d" % (copies // 2 + 1),
            *(topic + "replication.factor=%d" % copies for topic in (
                "default.", "offsets.topic.", "transaction.state.log.", "share.coordinator.state.topic.")),
            "transaction.state.log.min.isr=1", "share.coordinator.state.topic.min.isr=1",
            "offsets.topic.num.partitions=4", "transaction.state.log.num.partitions=4",
            # Consumer groups form without delay, because tests wait for each of them.
            "group.initial.rebalance.delay.ms=0", "group.min.session.timeout.ms=1000",
            "controlled.shutdown.enable=false", "broker.heartbeat.interval.ms=500",
            # A short session, so that a killed node can register again soon after its restart.
            "broker.session.timeout.ms=1500",
            "num.network.threads=2", "num.io.threads=2", "background.threads=2", "log.cleaner.enable=false",
            # A benchmark writes hundreds of megabytes a second; nobody reads what is gigabytes old.
            "log.retention.bytes=2147483648", "log.retention.check.interval.ms=2000",
            "log.segment.delete.delay.ms=1000", "log.initial.task.delay.ms=2000",
            "log.segment.bytes=67108864", "log.index.size.max.bytes=1048576", "auto.include.jmx.reporter=false",
            "metadata.max.idle.interval.ms=0"] + (self.security() if self.certificates else []) + (
                ["authorizer.class.name=org.apache.kafka.metadata.authorizer.StandardAuthorizer",
                 "allow.everyone.if.no.acl.found=true"] if self.acls else []) + (self.shipped_users() if self.users else []))

    def write_users(self):
        """The users of docker-compose.yml. Returns the user as which this script asks, and his password."""
        sys.path.insert(0, CLUSTER)
        import cluster  # pylint: disable=import-outside-toplevel
        passwords = dict.fromkeys([*cluster.KAFKA_USERS, cluster.KAFKA_ADMINISTRATOR], PASSWORD_OF_USERS)
        self.write("server.jaas", [cluster.kafka_users(passwords)])
        self.write("admin.properties", [cluster.kafka_administrator(passwords)])
        return cluster.KAFKA_ADMINISTRATOR, PASSWORD_OF_USERS

    def shipped_users(self):
        """What docker-compose.yml says of them."""
        import yaml  # pylint: disable=import-outside-toplevel
        with open(os.path.join(CLUSTER, "..", "..", "docker-compose.yml"), encoding="utf-8") as file:
            said = yaml.safe_load(file)["services"]["kafka"]["environment"]
        return ["%s=%s" % (name[len("KAFKA_"):].lower().replace("_", "."), value) for name, value in said.items()
                if name.startswith(("KAFKA_SASL_", "KAFKA_AUTHORIZER_", "KAFKA_SUPER_", "KAFKA_ALLOW_"))]

    def start(self):
        answer = super().start()
        if self.users:
            self.administrate("kafka.admin.AclCommand", "bash", os.path.join(CLUSTER, "kafka-rights"))
            self.administrate("kafka.admin.ConfigCommand", "bash", os.path.join(CLUSTER, "kafka-quotas"))
        return answer

    def administrate(self, main, *before, words=()):
        """One of Kafka's own programs (kafka-acls.sh and the like) as the administrator, with these words, or run by the command
        `before`."""
        with open(self.log(), "ab") as log:
            subprocess.run([*before, *self.java(main, "--bootstrap-server", "127.0.0.1:%d" % self.port, "--command-config",
                                                self.path("admin.properties")), *words],
                           env={**self.environment(), "GATEWAY_BYTES_PER_S": QUOTA_OF_GATEWAY}, cwd=self.folder,
                           stdin=subprocess.DEVNULL, stdout=log, stderr=log, check=True, timeout=private_server.START_LIMIT_S)

    @staticmethod
    def words_of_revocation():
        import revocation  # pylint: disable=import-outside-toplevel
        words = dict(revocation.commands("gateway-2", "master-1"))["kafka"]
        return words[words.index("--command-config") + 2:]

    def cut_off(self):
        self.administrate("kafka.admin.AclCommand", words=self.words_of_revocation())
        return "CUT_OFF"

    def let_in(self):
        self.administrate("kafka.admin.AclCommand", words=["--add" if word == "--remove" else word for word in self.words_of_revocation()])
        return "LET_IN"

    def security(self):
        user = {"user": certificates.USER, "password": certificates.PASSWORD}
        settings = ["ssl.keystore.type=PEM", "ssl.keystore.location=" + self.certificates.server_chain(),
                    "ssl.truststore.type=PEM", "ssl.truststore.location=" + self.certificates.path("ca.pem"),
                    "sasl.enabled.mechanisms=PLAIN", "sasl.mechanism.inter.broker.protocol=PLAIN"]
        for name in ["client", *("link%d" % number for number in range(len(self.listeners)))]:
            # With SASL Kafka ignores these settings without the listener's name.
            settings += ["listener.name.%s.ssl.client.auth=required" % name,
                         "listener.name.%s.plain.sasl.jaas.config=" % name +
                         "org.apache.kafka.common.security.plain.PlainLoginModule "
                         'required username="{user}" password="{password}" user_{user}="{password}";'.format(**user)]
        return settings

    def host(self):
        return "localhost" if self.certificates else "127.0.0.1"

    def java(self, main, *arguments):
        return ["java", *self.jvm, *private_server.JVM_OPTIONS, *maven_jars.shared_classes("kafka", self.jvm),
                "-Dorg.slf4j.simpleLogger.log.org.apache.kafka.common.config=warn",
                "-Dorg.slf4j.simpleLogger.log.kafka.server.KafkaConfig=warn",
                "-cp", self.class_path, main, *arguments]

    def command(self):
        users = ["-Djava.security.auth.login.config=" + self.path("server.jaas")] if self.users else []
        java, *words = self.java("kafka.Kafka", self.config)
        return [java, *users, *words]

    def environment(self):
        return private_server.java_environment()

    def launch(self):
        if not os.path.exists(self.path("data", "meta.properties")):
            with open(self.log(), "ab") as log:
                subprocess.run(self.java("kafka.tools.StorageTool", "format", "--config", self.config,
                                         "--cluster-id", "aW90Y2xvdWQtdGVzdHMtMQ"),
                               env=self.environment(), cwd=self.folder, stdin=subprocess.DEVNULL, stdout=log,
                               stderr=log, check=True, timeout=private_server.START_LIMIT_S,
                               preexec_fn=private_server.become_child)
        super().launch()

    def url(self):
        return "%s://%s:%d" % ("kafkas" if self.certificates else "kafka", self.host(), self.port)

    def answers(self):
        """The port opens early; the node serves once its metadata name itself (and its peers) as living brokers."""
        with self.connect(self.port) as probe:
            probe.settimeout(2)
            user = (certificates.USER, certificates.PASSWORD) if self.certificates else self.users
            if user:
                # SaslHandshake v1, SaslAuthenticate v0
                self.ask(probe, SASL_HANDSHAKE, 1, text("PLAIN"))
                token = "\0%s\0%s" % user
                self.ask(probe, SASL_AUTHENTICATE, 0, struct.pack(">i", len(token)) + token.encode())
            brokers = self.ask(probe, METADATA, 1, struct.pack(">i", 0))  # of no topic
            return struct.unpack_from(">i", brokers)[0] == self.peers

    def leader_of(self, topic):
        """The node that leads the topic's partition 0, as this one knows; below 1: none does, or there is no topic."""
        with self.connect(self.port) as probe:
            probe.settimeout(2)
            answer = Answer(self.ask(probe, METADATA, 1, struct.pack(">i", 1) + text(topic)))
        for _ in range(answer.number("i")):  # brokers: id, host, port, rack
            answer.number("i"), answer.text(), answer.number("i"), answer.text()
        answer.number("i")  # the controller
        answer.number("i"), answer.number("h"), answer.text(), answer.number("b")  # one topic: error, name, internal
        for _ in range(answer.number("i")):
            _, partition, leader = answer.number("h"), answer.number("i"), answer.number("i")
            if partition == 0:
                return leader
            for _ in range(2):  # replicas, those in sync
                answer.skip(4 * answer.number("i"))
        return 0

    def forbid(self):
        """Takes from everybody the permission to write to topics; all else stays permitted."""
        rules = [(ALL, ALLOW), (WRITE, DENY)]
        body = struct.pack(">i", len(rules)) + b"".join(
            struct.pack(">b", TOPIC) + text("*") + struct.pack(">b", LITERAL) + text("User:*") + text("*") +
            struct.pack(">bb", *rule) for rule in rules)
        self.administer(CREATE_ACLS, body)
        self.wait_for_rules(True)
        return "FORBIDDEN"

    def permit(self):
        self.administer(DELETE_ACLS, struct.pack(">i", 1) + ALL_TOPIC_RULES)
        self.wait_for_rules(False)
        return "PERMITTED"

    def administer(self, request, body):
        """A request that changes rules; raises RuntimeError when one of them is refused."""
        with self.connect(self.port) as probe:
            probe.settimeout(RULES_LIMIT_S)
            answer = Answer(self.ask(probe, request, 1, body))
        answer.number("i")  # throttled so long
        for _ in range(answer.number("i")):
            error, why = answer.number("h"), answer.text()
            if error:
                raise RuntimeError("Kafka refuses to change its rules: error %d, %s" % (error, why))
            if request == DELETE_ACLS:
                return  # what follows are the rules that were deleted

    def wait_for_rules(self, wanted):
        """Waits until the node obeys rules about topics, or none."""
        limit = time.monotonic() + RULES_LIMIT_S
        while True:
            with self.connect(self.port) as probe:
                probe.settimeout(RULES_LIMIT_S)
                answer = Answer(self.ask(probe, DESCRIBE_ACLS, 1, ALL_TOPIC_RULES))
            answer.number("i"), answer.number("h"), answer.text()
            if (answer.number("i") > 0) == wanted:
                return
            if time.monotonic() > limit:
                raise RuntimeError("Kafka does not take its rules over")
            time.sleep(0.01)

    def commands(self):
        more = {"forbid": self.forbid, "permit": self.permit} if self.acls else {}
        of_users = {"cut_off": self.cut_off, "let_in": self.let_in} if self.users else {}
        return {**super().commands(), **more, **of_users}

    @staticmethod
    def ask(connection, request, version, body):
        """One request of Kafka's protocol, and the body of its answer."""
        words = struct.pack(">hhi", request, version, 1) + text("probe") + body
        connection.sendall(struct.pack(">i", len(words)) + words)
        answers = connection.makefile("rb")
        head = answers.read(4)
        if len(head) < 4:
            raise ConnectionError("the node closed the connection")
        size, = struct.unpack(">i", head)
        answer = answers.read(size)
        if len(answer) < size:
            raise ConnectionError("the node closed the connection in the middle of an answer")
        return answer[4:]


class Answer:
    """Reads an answer of Kafka's protocol from the front."""

    def __init__(self, content):
        self.content, self.at = content, 0

    def number(self, kind):
        value, = struct.unpack_from(">" + kind, self.content, self.at)
        self.at += struct.calcsize(">" + kind)
        return value

    def text(self):
        """A string; None when it is absent."""
        size = self.number("h")
        if size < 0:
            return None
        self.at += size
        return self.content[self.at - size:self.at]

    def skip(self, size):
        self.at += size


def text(value):
    """A string of Kafka's protocol."""
    return struct.pack(">h", len(value)) + value.encode()


NO_TEXT = struct.pack(">h", -1)
ALL_TOPIC_RULES = struct.pack(">b", TOPIC) + NO_TEXT + struct.pack(">b", ANY) + NO_TEXT + NO_TEXT + struct.pack(">bb", ANY, ANY)


def main():
    parser = private_server.options("A private Kafka")
    private_server.add_client_options(parser)
    private_server.add_jvm_options(parser)
    parser.add_argument("--partitions", type=int, default=1, help="of a topic that is made by its first use")
    parser.add_argument("--listener", action="append", default=[], metavar="PORT:ADVERTISED",
                        type=lambda word: tuple(map(int, word.split(":"))), help="another listener, for a proxy")
    parser.add_argument("--acls", action="store_true", help="permission to write can be taken away: forbid, permit")
    parser.add_argument("--users", action="store_true", help="those of docker-compose.yml, with their rights")
    given = parser.parse_args()
    private_server.run(lambda: Kafka(given.dir, given.port, given.partitions, given.tls, given.jvm, given.listener,
                                     given.acls, given.users))


if __name__ == "__main__":
    main()

#!/usr/bin/python3
"""A private ActiveMQ Classic for tests and benchmarks, on loopback only, that leaves nothing behind.

    activemq.py --dir DIR [--port N] [--tls] [--throughput] [--memory-mb N] [--flow-control]
    [--store-mb N]

Runs one broker that speaks AMQP 1.0, with its data and log below DIR, on a free port. Its jars come from Maven Central
(maven_jars.py). When it takes connections it prints one line on stdout:

    READY activemq://127.0.0.1:PORT

(or `SKIP text` when the jars cannot be fetched; with CI=true that is an `ERROR text`). Then it obeys one command for
each line of stdin and answers with one line on stdout:

    kill    SIGKILL to the broker                  KILLED
    start   starts it again, same port and data    READY activemq://...
    pause   SIGSTOP to the broker: it hangs        PAUSED
    resume  SIGCONT                                RESUMED
    stop    ends everything                        STOPPED

The end of stdin means `stop`, so the server ends with whoever started it. A command that fails answers `ERROR text`.
Data of an earlier run in DIR are kept: a confirmed durable message is on the disk. A client that is silent for 4 s is
cut off.

With --flow-control the broker keeps its default flow control: while its memory (--memory-mb) is full it puts messages
aside, and may change their order (brokers/activemq/README.md). With --store-mb N it stores at most N MB of durable
messages, and refuses those that do not fit.

With --tls the URL is activemqs://localhost:PORT: the server wants a client certificate, and user and password
(certificates.py; the files are in DIR).
"""
from xml.sax.saxutils import quoteattr as quoted

import certificates
import maven_jars
import private_server

GREETING = b"AMQP\x03\x01\x00\x00"  # AMQP's header with SASL; the broker refuses the one without

CONFIGURATION = """\
<beans xmlns="http://www.springframework.org/schema/beans" xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"
    xsi:schemaLocation="
      http://www.springframework.org/schema/beans http://www.springframework.org/schema/beans/spring-beans.xsd
      http://activemq.apache.org/schema/core http://activemq.apache.org/schema/core/activemq-core.xsd">
  <broker xmlns="http://activemq.apache.org/schema/core" brokerName="iotcloud" useJmx="false" dataDirectory={data}>
    <destinationPolicy>
      <policyMap>
        <policyEntries>
          <policyEntry queue=">" producerFlowControl={flow_control} strictOrderDispatch="true"/>
        </policyEntries>
      </policyMap>
    </destinationPolicy>
    <persistenceAdapter>
      <!-- Synchronous: with less a broker that is killed loses what it has confirmed. -->
      <kahaDB directory={data} journalMaxFileLength={journal} cleanupInterval="500" journalDiskSyncStrategy="always"/>
    </persistenceAdapter>
    <plugins>
      <!-- Our clients ask it which queues there are. -->
      <statisticsBrokerPlugin/>{users}
    </plugins>{security}
    <systemUsage>
      <systemUsage sendFailIfNoSpace={store_refuses}>
        <memoryUsage><memoryUsage limit={memory}/></memoryUsage>
        <storeUsage><storeUsage limit={store}/></storeUsage>
        <tempUsage><tempUsage limit="1 gb"/></tempUsage>
      </systemUsage>
    </systemUsage>
    <transportConnectors>
      <transportConnector name="amqp" uri={connector}/>
    </transportConnectors>
  </broker>
</beans>
"""


USERS = """
      <simpleAuthenticationPlugin anonymousAccessAllowed="false">
        <users><authenticationUser username={user} password={password} groups="users"/></users>
      </simpleAuthenticationPlugin>"""

SECURITY = """
    <sslContext>
      <sslContext keyStore={key_store} keyStorePassword={store_password} keyStoreType="PKCS12"
          trustStore={trust_store} trustStorePassword={store_password} trustStoreType="PKCS12"/>
    </sslContext>"""


class ActiveMq(private_server.Server):
    name = "ActiveMQ"

    def __init__(self, folder, port, tls, jvm=private_server.QUICK_START, memory_mb=192, flow_control=False,
                 store_mb=None):
        super().__init__(folder)
        self.jvm = jvm
        self.class_path = maven_jars.fetch("activemq")
        self.port = port or private_server.free_ports(1)[0]
        # By default the server waits for a client's late acknowledgement (Nagle): 40 ms for small messages.
        connector = ("amqp://127.0.0.1:%d?wireFormat.maxFrameSize=67108864&wireFormat.idleTimeout=4000"
                     "&transport.tcpNoDelay=true" % self.port)
        if tls:
            self.certificates = certificates.Certificates(self.folder)
            connector = connector.replace("amqp:", "amqp+ssl:") + "&transport.needClientAuth=true"
        self.config = self.write("activemq.xml", CONFIGURATION.format(
            data=quoted(self.path("data")), connector=quoted(connector), memory=quoted("%d mb" % memory_mb),
            flow_control=quoted(str(flow_control).lower()), store=quoted("%d mb" % (store_mb or 4096)),
            store_refuses=quoted(str(store_mb is not None).lower()), journal=quoted("1mb" if store_mb else "32mb"),
            users=self.users() if tls else "", security=self.security() if tls else "").splitlines())

    @staticmethod
    def users():
        return USERS.format(user=quoted(certificates.USER), password=quoted(certificates.PASSWORD))

    def security(self):
        return SECURITY.format(
            key_store=quoted("file:" + self.certificates.key_store()),
            trust_store=quoted("file:" + self.certificates.trust_store()),
            store_password=quoted(certificates.STORE_PASSWORD))

    def command(self):
        return ["java", *self.jvm, *private_server.JVM_OPTIONS, *maven_jars.shared_classes("activemq", self.jvm),
                "-cp", self.class_path,
                "org.apache.activemq.console.command.ShellCommand", "start", "xbean:file:" + self.config]

    def environment(self):
        return private_server.java_environment()

    def url(self):
        return ("activemqs://localhost:%d" if self.certificates else "activemq://127.0.0.1:%d") % self.port

    def answers(self):
        with self.connect(self.port) as probe:
            probe.settimeout(2)
            probe.sendall(GREETING)
            return probe.makefile("rb").read(len(GREETING)) == GREETING


def main():
    parser = private_server.options("A private ActiveMQ")
    private_server.add_client_options(parser)
    private_server.add_jvm_options(parser)
    parser.add_argument("--memory-mb", type=int, default=192, help="of messages that wait")
    parser.add_argument("--flow-control", action="store_true", help="the server's own, its default")
    parser.add_argument("--store-mb", type=int, help="of durable messages; more are refused")
    given = parser.parse_args()
    private_server.run(lambda: ActiveMq(given.dir, given.port, given.tls, given.jvm, given.memory_mb, given.flow_control,
                                        given.store_mb))


if __name__ == "__main__":
    main()

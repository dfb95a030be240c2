#!/usr/bin/python3
"""A private ZooKeeper for tests and demos, on loopback only, that leaves nothing behind.

    zookeeper.py --dir DIR [--port N] [--steady] [--setting LINE]...

Runs one server from Debian's jars with its data and log below DIR, on a free port. When it answers requests it prints
one line on stdout:

    READY zookeeper://127.0.0.1:PORT

Then it obeys one command for each line of stdin and answers with one line on stdout:

    kill    SIGKILL to the server                  KILLED
    start   starts it again, same port and data    READY zookeeper://...
    pause   SIGSTOP to the server: it hangs        PAUSED
    resume  SIGCONT                                RESUMED
    stop    ends everything                        STOPPED

The end of stdin means `stop`, so the server ends with whoever started it. A command that fails answers `ERROR text`.
Data of an earlier run in DIR are kept. Session time-outs from 0.4 s on are accepted. One address may have
any number of connections (--setting maxClientCnxns=N: this number).
"""
import os
import socket

import maven_jars
import private_server

JARS = "/usr/share/java"
CLASS_PATH = ["zookeeper", "zookeeper-jute", "slf4j-api", "slf4j-simple", "metrics-core", "snappy-java",
              "netty-handler", "netty-common", "netty-transport", "netty-buffer", "netty-codec", "netty-resolver",
              "netty-transport-native-epoll", "netty-transport-native-unix-common", "commons-cli"]
# JVM options by use. A test needs a server that is small and starts quickly. In a benchmark no driver should wait while
# the garbage collector stops the JVM: with thousands of nodes in the small heap it does so for 0.1 to 0.4 s. In a small
# young generation few objects are alive, so collecting it takes milliseconds; the old generation never fills.
QUICK_START = ["-Xms24m", "-Xmx128m"]
STEADY = ["-Xms768m", "-Xmx768m", "-Xmn32m"]


class ZooKeeper(private_server.Server):
    name = "ZooKeeper"  # it has a write-ahead log, so nothing is lost when it is killed

    def __init__(self, folder, port=None, settings=(), jvm=QUICK_START):
        """settings: further lines of the configuration."""
        super().__init__(folder)
        self.jvm = jvm
        self.port = port or private_server.free_ports(1)[0]
        os.makedirs(self.path("data"), exist_ok=True)
        self.config = self.write("zoo.cfg", [
            # Sessions expire in steps of tickTime.
            "tickTime=200", "initLimit=50", "syncLimit=25", "minSessionTimeout=400", "maxSessionTimeout=60000",
            "dataDir=" + self.path("data"), "clientPortAddress=127.0.0.1", "clientPort=%d" % self.port,
            "maxClientCnxns=0", "admin.enableServer=false", "4lw.commands.whitelist=srvr", *settings])

    def command(self):
        jars = [os.path.join(JARS, name + ".jar") for name in CLASS_PATH]
        if not os.path.exists(jars[0]):
            raise RuntimeError("%s is missing; install Debian's package zookeeper" % jars[0])
        jvm = [*self.jvm, *private_server.SMALL_JVM]
        return ["java", *jvm, *private_server.JVM_OPTIONS, *maven_jars.shared_classes("zookeeper", jvm),
                "-Dzookeeper.jmx.log4j.disable=true", "-Dzookeeper.forceSync=no",
                "-Dzookeeper.preAllocSize=1024", "-cp", ":".join(jars),
                "org.apache.zookeeper.server.quorum.QuorumPeerMain", self.config]

    def environment(self):
        return {**private_server.java_environment(), "JMXDISABLE": "true"}

    def url(self):
        return "zookeeper://127.0.0.1:%d" % self.port

    def mode(self):
        """"standalone", "leader" or "follower"; empty while it serves nobody. `srvr` tells the mode only once requests
        are served; `ruok` says imok long before."""
        with socket.create_connection(("127.0.0.1", self.port), timeout=1) as probe:
            probe.settimeout(0.3)  # a server that is asked too early may never answer
            probe.sendall(b"srvr")
            answer = b""
            while True:
                chunk = probe.recv(4096)
                if not chunk:
                    break
                answer += chunk
        words = [line.split(b": ")[1] for line in answer.splitlines() if line.startswith(b"Mode: ")]
        return words[0].decode() if words else ""

    def answers(self):
        return self.mode() != ""


def main():
    parser = private_server.options("A private ZooKeeper")
    parser.add_argument("--port", type=int, default=0, help="client port; default: a free one")
    parser.add_argument("--steady", dest="jvm", action="store_const", const=STEADY, default=QUICK_START,
                        help="for benchmarks: more memory, so that it never stops for long")
    parser.add_argument("--setting", action="append", default=[], metavar="LINE", help="a line of its configuration")
    given = parser.parse_args()
    private_server.run(lambda: ZooKeeper(given.dir, given.port, given.setting, jvm=given.jvm))


if __name__ == "__main__":
    main()

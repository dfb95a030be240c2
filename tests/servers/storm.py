#!/usr/bin/python3
"""A private Apache Storm for tests, on loopback only, that leaves nothing behind.

    storm.py --dir DIR [--port N] [--slots N]

Runs a ZooKeeper, a Nimbus and a Supervisor with N slots (4) with their data and logs below DIR, on free ports. Storm's
jars come from Maven Central (maven_jars.py). When the Supervisor has told Nimbus of itself it prints one line on stdout:

    READY 127.0.0.1:PORT

(or `SKIP text` when the jars cannot be fetched; with CI=true that is an `ERROR text`), with the port of Nimbus. Then it
obeys one command for each line of stdin and answers with one line on stdout; PART is nimbus, supervisor or zookeeper,
and without it they are meant all:

    kill [PART]     SIGKILL; workers go on         KILLED
    start [PART]    starts it again, same data     READY 127.0.0.1:PORT
    pause [PART]    SIGSTOP: it hangs              PAUSED
    resume [PART]   SIGCONT                        RESUMED
    workers         the workers that run           WORKERS PORT=PROCESS...
    stop            ends everything                STOPPED

The end of stdin means `stop`. A command that fails answers `ERROR text`. The logs of workers are below
DIR/logs/workers-artifacts.
"""
import os
import shutil
import signal
import socket
import stat
import struct

import maven_jars
import private_server
import zookeeper

JVM = ["-Xms32m", "-Xmx384m", *private_server.SMALL_JVM]
WORKER_JVM = "-Xmx128m -XX:+UseSerialGC -XX:TieredStopAtLevel=1"
REPLY = 2  # a Thrift message that is an answer, and no exception
LOG4J = """<configuration monitorInterval="5" shutdownHook="disable">
<appenders><RollingFile name="A" immediateFlush="true" fileName="%(file)s" filePattern="%(file)s.%%i">
<PatternLayout pattern="%%d{yyyy-MM-dd HH:mm:ss.SSS} %%c{1.} %%t [%%p] %%msg%%n"/>
<Policies><SizeBasedTriggeringPolicy size="20 MB"/></Policies><DefaultRolloverStrategy max="2"/></RollingFile></appenders>
<loggers><root level="info"><appender-ref ref="A"/></root></loggers>
</configuration>
"""
LOG_SETTINGS = {name: LOG4J % {"file": file} for name, file in (
    ("cluster.xml", "${sys:storm.log.dir}/${sys:logfile.name}"),
    ("worker.xml", "${sys:workers.artifacts}/${sys:storm.id}/${sys:worker.port}/${sys:logfile.name}"))}
# Ends a worker's JVM when this script ends, however it does: Storm lets workers go on without their supervisor.
JAVA = """#!/bin/bash
exec 9<"%s"
process=$$
(while kill -0 $process; do
  read -r -t 2 -u 9
  [ $? -gt 128 ] || kill -9 $process  # not the end of the 2 s, but of the other side
done) </dev/null >/dev/null 2>&1 &
exec 9<&- "%s" "$@"
"""


class Daemon(private_server.Server):
    """A Nimbus or a Supervisor, with the folder and the settings of the cluster."""

    def __init__(self, name, main, cluster, has_begun):
        super().__init__(cluster.folder)
        self.name, self.main, self.cluster, self.answers = name, main, cluster, has_begun

    def log(self):
        return self.path(self.name + ".out")

    def command(self):
        return ["java", *JVM, "-Ddaemon.name=" + self.name, "-Dstorm.options=", "-Dstorm.home=" + self.folder,
                "-Dstorm.log.dir=" + self.path("logs"), "-Dstorm.conf.file=", "-Dlogfile.name=%s.log" % self.name,
                "-DLog4jContextSelector=org.apache.logging.log4j.core.selector.BasicContextSelector",
                "-Dlog4j.configurationFile=" + self.path("log4j2", "cluster.xml"), "-cp",
                ":".join([self.path("lib", "*"), self.path("extlib", "*"), self.path("conf")]), self.main]

    def environment(self):
        return {**private_server.java_environment(), "JAVA_HOME": self.path("java")}

    def signal(self, number):
        """Only to the daemon: its workers, which are of the same group, go on."""
        if not self.runs():
            raise RuntimeError("%s does not run" % self.name)
        self.process.send_signal(number)

    def url(self):
        return self.cluster.url()


class Storm:
    def __init__(self, folder, port=None, slots=4, worker_jvm=WORKER_JVM, more=None):
        """`worker_jvm`: options of the workers' JVMs; `more`: other settings of storm.yaml."""
        self.worker_jvm, self.more = worker_jvm, more or {}
        self.folder = os.path.abspath(folder)
        for name in ("conf", "log4j2", "extlib", "logs", os.path.join("java", "bin")):
            os.makedirs(os.path.join(self.folder, name), exist_ok=True)
        self.link("lib", maven_jars.fetch("storm"))
        self.link("lib-worker", maven_jars.fetch("storm_worker"))
        ports = private_server.free_ports(2 + slots)
        self.port = port or ports[0]
        self.zookeeper = zookeeper.ZooKeeper(os.path.join(self.folder, "zookeeper"))
        self.configure(ports[1], ports[2:])
        self.parts = {"zookeeper": self.zookeeper,
                      "nimbus": Daemon("nimbus", "org.apache.storm.daemon.nimbus.Nimbus", self, self.leads),
                      "supervisor": Daemon("supervisor", "org.apache.storm.daemon.supervisor.Supervisor", self, self.has_slots)}

    def link(self, name, jars):
        path = os.path.join(self.folder, name)
        if os.path.islink(path):
            os.unlink(path)
        os.symlink(os.path.dirname(jars), path)

    def configure(self, supervisor_port, slots):
        java = shutil.which("java")
        if not java:
            raise RuntimeError("java is missing; install Debian's package openjdk-17-jre-headless")
        alive = os.path.join(self.folder, "alive")
        if not os.path.exists(alive):
            os.mkfifo(alive)
        self.alive = os.open(alive, os.O_RDWR)  # not inherited: closed when this process ends
        wrapper = os.path.join(self.folder, "java", "bin", "java")
        self.write(wrapper, JAVA % (alive, os.path.realpath(java)))
        os.chmod(wrapper, stat.S_IRWXU)
        for name, text in LOG_SETTINGS.items():
            self.write(os.path.join(self.folder, "log4j2", name), text)
        settings = {
            "storm.zookeeper.servers": '["127.0.0.1"]', "storm.zookeeper.port": self.zookeeper.port,
            "nimbus.seeds": '["127.0.0.1"]', "nimbus.thrift.port": self.port, "storm.local.hostname": '"127.0.0.1"',
            "storm.local.dir": '"%s"' % os.path.join(self.folder, "data"), "supervisor.slots.ports": list(slots),
            "supervisor.thrift.port": supervisor_port, "nimbus.monitor.freq.secs": 2, "supervisor.monitor.frequency.secs": 1,
            "supervisor.heartbeat.frequency.secs": 2, "supervisor.worker.shutdown.sleep.secs": 1,
            # At 0 Nimbus would delete what it still uses.
            "nimbus.topology.blobstore.deletion.delay.ms": 60000,
            "executor.metrics.frequency.secs": 5, "worker.childopts": '"%s"' % self.worker_jvm,
            "topology.worker.logwriter.childopts": '"-Xmx32m %s"' % " ".join(private_server.SMALL_JVM), **self.more}
        self.write(os.path.join(self.folder, "conf", "storm.yaml"),
                   "".join("%s: %s\n" % setting for setting in settings.items()))

    @staticmethod
    def write(path, text):
        with open(path, "w", encoding="utf-8") as file:
            file.write(text)

    def url(self):
        return "127.0.0.1:%d" % self.port

    def ask(self, method):
        """The body of Nimbus' answer to a call without arguments; empty when it failed."""
        name = method.encode()
        call = struct.pack(">II", 0x80010001, len(name)) + name + struct.pack(">IB", 1, 0)
        with socket.create_connection(("127.0.0.1", self.port), timeout=5) as connection:
            connection.sendall(struct.pack(">I", len(call)) + call)
            answer = connection.makefile("rb")
            head = answer.read(4)
            body = answer.read(struct.unpack(">I", head)[0]) if len(head) == 4 else b""
        return body[12 + len(name):] if body[3:4] == bytes([REPLY]) else b""

    def leads(self):
        return self.ask("getLeader") != b""

    def has_slots(self):
        """Whether the first field of the answer, the list of supervisors, has one."""
        answer = self.ask("getClusterInfo")
        return len(answer) > 11 and struct.unpack_from(">xxxxxxxI", answer)[0] > 0

    def chosen(self, part):
        if part is None:
            return list(self.parts.values())
        if part not in self.parts:
            raise RuntimeError("there is no %s; there are %s" % (part, " ".join(self.parts)))
        return [self.parts[part]]

    def start(self, part=None):
        for each in self.chosen(part):
            if part is not None or not each.runs():
                each.start()
        return "READY " + self.url()

    def each(self, part, action):
        return [action(each) for each in self.chosen(part) if part is not None or each.runs()][0]

    def kill(self, part=None):
        return self.each(part, lambda each: each.kill())

    def pause(self, part=None):
        return self.each(part, lambda each: each.pause())

    def resume(self, part=None):
        return self.each(part, lambda each: each.resume())

    def running_workers(self, topology=None):
        """The workers' processes, by port: all, or those of a topology."""
        found = {}
        for process in filter(str.isdigit, os.listdir("/proc")):
            try:
                with open("/proc/%s/cmdline" % process, "rb") as file:
                    words = file.read().decode(errors="replace").split("\0")
            except OSError:
                continue
            # The shell that watches a worker has the worker's words, after its own.
            if (os.path.basename(words[0]) == "java" and "-Dstorm.home=" + self.folder in words and
                    "org.apache.storm.daemon.worker.Worker" in words):
                said = dict(word.partition("=")[::2] for word in words if word.startswith(("-Dworker.port=", "-Dstorm.id=")))
                # The id is NAME-NUMBER-TIME.
                wanted = topology in (None, said.get("-Dstorm.id", "").rsplit("-", 2)[0])
                if "-Dworker.port" in said and wanted and "org.apache.storm.LogWriter" not in words:
                    found[int(said["-Dworker.port"])] = int(process)
        return found

    def workers(self):
        return " ".join(["WORKERS", *("%d=%d" % worker for worker in sorted(self.running_workers().items()))])

    def stop(self):
        for part in reversed(list(self.parts.values())):
            if part.runs():
                os.killpg(part.process.pid, signal.SIGKILL)
                part.process.wait()
        os.close(self.alive)
        return "STOPPED"

    def commands(self):
        return {"kill": self.kill, "start": self.start, "pause": self.pause, "resume": self.resume, "workers": self.workers}


def main():
    parser = private_server.options("A private Storm")
    parser.add_argument("--port", type=int, default=0, help="Nimbus' port; default: a free one")
    parser.add_argument("--slots", type=int, default=4, help="how many workers its one machine may run")
    given = parser.parse_args()
    private_server.run(lambda: Storm(given.dir, given.port, given.slots))


if __name__ == "__main__":
    main()

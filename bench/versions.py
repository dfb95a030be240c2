"""Which versions a benchmark ran with: asked from the programs, libraries and jars that it uses, never typed in."""

import re
import subprocess
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FETCHED = ROOT / "build/servers"  # what tests/servers/maven_jars.py fetched


def said_by(*command):
    """The first line that a program prints; None when it is not there or fails."""
    try:
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=60)
    except (OSError, subprocess.TimeoutExpired):
        return None
    lines = done.stdout.strip().splitlines()
    return lines[0].strip() if done.returncode == 0 and lines else None


def of_jar(folder, pattern):
    """What the manifest of the only jar of this name says; None when there is none."""
    jars = sorted(Path(folder).glob(pattern))
    if len(jars) != 1:
        return None
    try:
        with zipfile.ZipFile(jars[0]) as jar:
            manifest = jar.read("META-INF/MANIFEST.MF").decode()
    except (KeyError, OSError, zipfile.BadZipFile):
        return None
    found = re.search(r"^(?:Implementation-)?Version: (\S+)\s*$", manifest, re.M)
    return found[1] if found else None


def compiler(build):
    cache = Path(build) / "CMakeCache.txt"
    found = re.search(r"^CMAKE_CXX_COMPILER:\w+=(.+)$", cache.read_text(), re.M) if cache.exists() else None
    return said_by(found[1], "--version") if found else None


def rabbitmq():
    return {"RabbitMQ": said_by("/usr/lib/rabbitmq/bin/rabbitmqctl", "version"),
            "librabbitmq": said_by("pkg-config", "--modversion", "librabbitmq")}


def kafka():
    return {"Kafka": of_jar(FETCHED / "kafka", "kafka_*.jar"),
            "librdkafka": said_by("pkg-config", "--modversion", "rdkafka"), "JVM": jvm()}


def activemq():
    return {"ActiveMQ": of_jar(FETCHED / "activemq", "activemq-broker-*.jar"),
            "qpid-proton-cpp": said_by("pkg-config", "--modversion", "libqpid-proton"), "JVM": jvm()}


def zookeeper():
    said = said_by("java", "-cp", "/usr/share/java/zookeeper.jar", "org.apache.zookeeper.version.VersionInfoMain")
    return {"ZooKeeper": said, "JVM": jvm()}


def storm():
    return {"Storm": of_jar(ROOT / "build/bench/storm/jars", "storm-server-*.jar"), "JVM": jvm()}


def jvm():
    return said_by("java", "-version")


SERVERS = {"rabbitmq": rabbitmq, "kafka": kafka, "activemq": activemq, "zookeeper": zookeeper,
           "storm": storm}


def asked(build, *servers):
    """{what: its version} of the compiler and of these servers with their libraries, for the key "versions" of a
    figure's file. What does not tell is not in it."""
    versions = {"compiler": compiler(build)}
    for server in servers:
        versions |= SERVERS[server]()
    return {what: version for what, version in versions.items() if version}

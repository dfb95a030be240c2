"""Finds the versions that a benchmark ran with by asking the programs, libraries and jars that it uses."""

import re
import subprocess
import zipfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
FETCHED = ROOT / "build/servers"  # where tests/servers/maven_jars.py puts jars


def said_by(*command):
    """The first line that a program prints; None when the program is missing or fails."""
    try:
        done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, timeout=60)
    except (OSError, subprocess.TimeoutExpired):
        return None
    lines = done.stdout.strip().splitlines()
    return lines[0].strip() if done.returncode == 0 and lines else None


def of_jar(folder, pattern):
    """The version in the manifest of the only jar with this name; None when there is no such jar."""
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
    # rabbitmqctl is not asked for its version, because it would start Erlang's port mapper, which does not end.
    return {"RabbitMQ": said_by("dpkg-query", "-W", "-f=${Version}", "rabbitmq-server"),
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


def redis():
    return {"Redis": said_by("dpkg-query", "-W", "-f=${Version}", "redis-server"),
            "hiredis": said_by("pkg-config", "--modversion", "hiredis")}


def storm():
    return {"Storm": of_jar(ROOT / "build/bench/storm/jars", "storm-server-*.jar") or of_jar(FETCHED / "storm", "storm-server-*.jar"),
            "JVM": jvm()}


def jvm():
    return said_by("java", "-version")


SERVERS = {"rabbitmq": rabbitmq, "kafka": kafka, "activemq": activemq, "zookeeper": zookeeper,
           "redis": redis, "storm": storm}


def asked(build, *servers):
    """{name: version} of the compiler and of these servers with their libraries, for the key "versions" of a figure's
    file. Names whose version is unknown are left out."""
    versions = {"compiler": compiler(build)}
    for server in servers:
        versions |= SERVERS[server]()
    return {what: version for what, version in versions.items() if version}

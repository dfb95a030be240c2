#!/usr/bin/python3
"""Makes an archive of the classes that a Java server of tests loads, once: its JVM then starts in half the time.

    share_classes.py kafka activemq zookeeper

`./dev test` calls it after maven_jars.py (ZooKeeper's jars are Debian's). It starts the server and ends it; the JVM writes the archive as it ends
(JEP 350). A server's script uses the archive if there is one (maven_jars.shared_classes); without it all works as well.
"""
import os
import shutil
import signal
import sys
import tempfile

import activemq
import kafka
import maven_jars
import private_server
import zookeeper

MAKE = {"kafka": lambda folder, option: kafka.Kafka(folder, None, 1, False, [*private_server.QUICK_START, option]),
        "activemq": lambda folder, option: activemq.ActiveMq(folder, None, False, [*private_server.QUICK_START, option]),
        "zookeeper": lambda folder, option: zookeeper.ZooKeeper(folder, jvm=[*zookeeper.QUICK_START, option])}
END_LIMIT_S = 120


def share(name):
    """Raises what `PASSING` lists when the server does not start or end, or writes nothing."""
    if name not in maven_jars.DEBIANS:
        maven_jars.fetch(name)
    archive = maven_jars.archive_of(name)
    if os.path.exists(archive):
        return
    os.makedirs(os.path.dirname(archive), exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="iotcloud-classes-") as folder:
        written = os.path.join(folder, "classes.jsa")
        server = MAKE[name](folder, "-XX:ArchiveClassesAtExit=" + written)
        try:
            server.start()
            server.signal(signal.SIGTERM)
            server.process.wait(END_LIMIT_S)
        finally:
            server.stop()
        own = "%s.%d" % (archive, os.getpid())
        try:
            shutil.copyfile(written, own)
            os.replace(own, archive)
        finally:
            if os.path.exists(own):
                os.unlink(own)


def main():
    for name in sys.argv[1:]:
        try:
            share(name)
        except (private_server.Unavailable, *private_server.PASSING) as error:
            print("the classes of %s are not shared, so its servers start slower: %s" % (name, error), file=sys.stderr)


if __name__ == "__main__":
    main()

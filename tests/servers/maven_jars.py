#!/usr/bin/python3
"""Fetches the Java servers of this folder from Maven Central, once: java/NAME/pom.xml into build/servers/NAME.

    maven_jars.py kafka activemq

`./dev test` calls it while it builds, so that no test's time-out pays for the download; a server's script calls it
again and finds them there. Several callers at once wait for one another.
"""
import fcntl
import hashlib
import os
import shutil
import subprocess
import sys

import private_server

HERE = os.path.dirname(os.path.abspath(__file__))
FETCHED = os.path.join(HERE, "..", "..", "build", "servers")
DEBIANS = {"zookeeper": "/usr/share/java/zookeeper.jar"}  # servers whose jars are Debian's: one of them
LIMIT_S = 600
# Maven's messages when the network or the registry fails, not the pom.
UNREACHABLE = ("Could not transfer", "Unknown host", "Connection refused", "timed out", "Network is unreachable")


def fetch(name):
    """Returns a class path with all jars of java/NAME/pom.xml. Raises Unavailable when they cannot be fetched."""
    private_server.require_label("java")
    pom = os.path.join(HERE, "java", name, "pom.xml")
    with open(pom, "rb") as file:
        version = hashlib.sha256(file.read()).hexdigest()
    os.makedirs(FETCHED, exist_ok=True)
    folder = os.path.realpath(os.path.join(FETCHED, name))
    with open(folder + ".lock", "w", encoding="ascii") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        complete = os.path.join(folder, "complete-" + version)
        if not os.path.exists(complete):
            shutil.rmtree(folder, ignore_errors=True)
            copy(name, pom, folder)
            with open(complete, "w", encoding="ascii"):
                pass
    return os.path.join(folder, "*")


def archive_of(name):
    """Where share_classes.py keeps what it made with the Java that is installed; it goes with the jars. One of another Java,
    or of other jars of Debian, would be ignored."""
    made_of = [os.path.realpath(shutil.which("java") or "/"), DEBIANS.get(name, "")]
    times = ["%d" % os.stat(file).st_mtime for file in made_of if os.path.exists(file)]
    return os.path.join(os.path.realpath(os.path.join(FETCHED, name)), "classes-%s.jsa" % "-".join(times))


def shared_classes(name, jvm):
    """Options that let a JVM for tests read its classes from the archive, if there is one. A JVM of another version starts
    without it (-Xshare:auto)."""
    archive = archive_of(name)
    fits = set(private_server.SMALL_JVM).issubset(jvm)
    return ["-XX:SharedArchiveFile=" + archive] if fits and os.path.exists(archive) else []


def copy(name, pom, folder):
    command = ["mvn", "-B", "-q", "-f", pom, "dependency:copy-dependencies", "-DincludeScope=runtime",
               "-DoutputDirectory=" + folder]
    try:
        done = subprocess.run(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                              text=True, timeout=LIMIT_S, preexec_fn=private_server.become_child)
    except FileNotFoundError:
        raise RuntimeError("mvn is missing; install Debian's package maven") from None
    except subprocess.TimeoutExpired:
        raise private_server.Unavailable("the jars of %s did not come within %d s" % (name, LIMIT_S)) from None
    if done.returncode == 0:
        return
    said = [line for line in done.stdout.splitlines() if "ERROR" in line] or done.stdout.splitlines() or ["nothing"]
    text = "Maven cannot fetch the jars of %s: %s" % (name, said[0])
    if any(sign in done.stdout for sign in UNREACHABLE):
        raise private_server.Unavailable(text)
    raise RuntimeError(text)


def main():
    status = 0
    for name in sys.argv[1:]:
        try:
            fetch(name)
        except (private_server.Unavailable, RuntimeError) as error:
            print(error, file=sys.stderr)
            status = 1
    return status


if __name__ == "__main__":
    sys.exit(main())

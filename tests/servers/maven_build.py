"""Builds a project of ours with Maven, once for each state of its sources."""
import fcntl
import hashlib
import subprocess

from maven_jars import UNREACHABLE
from private_server import Unavailable, become_child

LIMIT_S = 600


def build_once(sources, folder, make):
    """Calls make(folder) unless it was done for these sources; another process waits meanwhile. Returns the folder."""
    digest = hashlib.sha256()
    for file in sorted(sources):
        digest.update(file.name.encode() + b"\0" + file.read_bytes())
    folder.mkdir(parents=True, exist_ok=True)
    folder = folder.resolve()
    with open(folder.with_suffix(".lock"), "w", encoding="ascii") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        complete = folder / "complete"
        if not complete.exists() or complete.read_text() != digest.hexdigest():
            complete.unlink(missing_ok=True)
            make(folder)
            complete.write_text(digest.hexdigest())
    return folder


def package(project, name, folder):
    """Runs `mvn package` with the property `folder`. Raises Unavailable when Maven Central cannot be reached, RuntimeError
    when the build fails; `name` is what they call the project."""
    command = ["mvn", "-B", "-q", "-Dstyle.color=never", "-f", str(project / "pom.xml"), f"-Dfolder={folder}", "package"]
    try:
        done = subprocess.run(command, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                              text=True, timeout=LIMIT_S, preexec_fn=become_child)
    except FileNotFoundError:
        raise RuntimeError("mvn is missing; install Debian's packages maven and openjdk-17-jdk-headless") from None
    except subprocess.TimeoutExpired:
        raise Unavailable(f"Maven did not build {name} within {LIMIT_S} s") from None
    if done.returncode == 0:
        return
    said = [line for line in done.stdout.splitlines() if "ERROR" in line] or done.stdout.splitlines() or ["nothing"]
    text = f"Maven cannot build {name}: {said[0]}"
    if any(sign in done.stdout for sign in UNREACHABLE):
        raise Unavailable(text)
    raise RuntimeError(f"{text}\n{done.stdout}")

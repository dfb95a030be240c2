"""The images of a test that can pull none: a base from debootstrap, stand-ins for the servers, and the binaries of a
build that is there, or of the Dockerfile's own."""

import hashlib
import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(HERE.parent / "servers"))

import maven_jars  # noqa: E402
import storm as private_storm  # noqa: E402
from private_docker import Failed, run  # noqa: E402

BASE, SERVERS, BINARIES = "debian:bookworm-slim", "iotcloud-test:servers", "iotcloud-test:binaries"
BUILD_BASE = "iotcloud-test:build-base"
STAND_INS = {"RABBITMQ_IMAGE": "rabbitmq", "ZOOKEEPER_IMAGE": "zookeeper", "KAFKA_IMAGE": "kafka", "STORM_IMAGE": "storm"}
OF_SERVERS = ["rabbitmq-server", "zookeeper", "libslf4j-java", "libsnappy-java", "openjdk-17-jre-headless", "procps"]


def words_of(pattern):
    """A list in the Dockerfile."""
    text = (ROOT / "Dockerfile").read_text(encoding="utf-8").replace("\\\n", " ")
    return [word for found in re.findall(pattern, text) for word in found.split()]


def installed(stages):
    """The packages that these stages of the Dockerfile (a pattern) install: the base has them, so that a container needs
    no network."""
    text = " ".join(words_of(stages))
    return sorted({word for found in re.findall(r"--no-install-recommends((?: [a-z0-9.+-]+)+)", text)
                   for word in found.split()})


def mirror():
    """This machine's mirror of Debian 12, and how apt reaches it."""
    listed = run("apt-get", "indextargets", "--format", "$(RELEASE) $(SITE)", "Created-By: Packages").splitlines()
    sites = [line.split()[1] for line in listed if line.split()[0] == "bookworm"]
    if not sites:
        raise Failed("apt knows no mirror of bookworm: this test makes a Debian 12 from it")
    environment = dict(os.environ)
    for protocol in ("http", "https"):
        said = run("apt-config", "shell", "proxy", f"Acquire::{protocol}::Proxy")
        if said:
            environment[f"{protocol}_proxy"] = said.split("=", 1)[1].strip("'")
    return sites[0], environment


def debian(packages, work):
    """A tar archive of a small Debian 12 with these packages, made once."""
    mark = hashlib.sha256(" ".join(packages).encode()).hexdigest()[:16]
    archive = work / f"debian-{mark}.tar"
    if archive.exists():
        return archive
    print(f"a Debian 12 with {len(packages)} packages from this machine's mirror, once: {archive}", flush=True)
    site, environment = mirror()
    folder = work / f"debian-{mark}"
    debs = work / "debs"
    debs.mkdir(parents=True, exist_ok=True)
    shutil.rmtree(folder, ignore_errors=True)
    try:
        run("debootstrap", "--variant=minbase", f"--cache-dir={debs.resolve()}", f"--include={','.join(packages)}",
            "bookworm", folder, site, env=environment)
        shutil.rmtree(folder / "var/cache/apt/archives", ignore_errors=True)
        shutil.rmtree(folder / "var/lib/apt/lists", ignore_errors=True)
        run("tar", "-C", folder, "--exclude=./dev/*", "--exclude=./usr/share/doc/*", "--exclude=./usr/share/man/*",
            "--exclude=./usr/share/locale/*", "-cf", f"{archive}.new", ".")
        Path(f"{archive}.new").rename(archive)
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return archive


def load(docker, build, work, without, full):
    """Loads all images into the daemon. Returns the variables of docker-compose.yml. `without`: stand-ins that nobody needs.
    `full`: the Dockerfile's stage `build` makes the binaries, in a Debian with the compilers and headers that it names."""
    base = installed(r"(?s)FROM \$\{BINARIES\}.*")
    docker.import_image(BASE, debian(base, work))
    docker.import_image(SERVERS, debian(sorted({*base, *OF_SERVERS}), work))
    needed = {variable: name for variable, name in STAND_INS.items() if name not in without}
    stand_ins(docker, work, needed.values())
    told = {variable: f"iotcloud-test:{name}" for variable, name in needed.items()}
    if full:
        docker.import_image(BUILD_BASE, debian(sorted({*base, *installed(r"(?s)AS build\n.*?WORKDIR")}), work))
        return {**told, "BUILD_BASE_IMAGE": BUILD_BASE}
    binaries(docker, build, work)
    return {**told, "BINARIES": BINARIES}


def stand_ins(docker, work, names):
    context = work / "stand_ins"
    shutil.rmtree(context, ignore_errors=True)
    shutil.copytree(HERE / "stand_ins", context)
    if "kafka" in names:
        shutil.copytree(Path(maven_jars.fetch("kafka")).parent, context / "jars")
    if "storm" in names:
        shutil.copytree(Path(maven_jars.fetch("storm")).parent, context / "storm-lib")
        shutil.copytree(Path(maven_jars.fetch("storm_worker")).parent, context / "storm-lib-worker")
        (context / "log4j2").mkdir()
        for file, text in private_storm.LOG_SETTINGS.items():
            (context / "log4j2" / file).write_text(text, encoding="utf-8")
    for name in names:
        docker.docker("build", "--quiet", "--build-arg", f"SERVERS={SERVERS}", "--target", name, "-t", f"iotcloud-test:{name}",
                      context)


def binaries(docker, build, work):
    """An image with /out as the Dockerfile's stage `build` leaves it, from an existing build."""
    out = work / "binaries"
    shutil.rmtree(out, ignore_errors=True)
    run("/usr/bin/python3", ROOT / "development/package.py", "--build", build, "--out", out / "out/packages", "--no-lint", "--fast",
        "--components", *words_of(r'ARG PROGRAMS="([^"]*)"'), "files")
    for part in words_of(r'ARG CLIENTS="([^"]*)"'):
        run("cmake", "--install", build, "--strip", "--prefix", out / "out", "--component", part)
    packed = subprocess.Popen(["tar", "-C", str(out), "-c", "."], stdout=subprocess.PIPE)
    run("docker", "import", "-", BINARIES, env=docker.environment, stdin=packed.stdout)
    packed.stdout.close()
    if packed.wait():
        raise Failed("tar of the binaries failed")


def sizes(docker):
    """The size of the build, in MB."""
    wanted = [BASE, "iotcloud:local", "iotcloud-bench:local"]
    return {tag: json.loads(docker.docker("image", "inspect", tag))[0]["Size"] / 1e6 for tag in wanted
            if docker.docker("images", "-q", tag)}

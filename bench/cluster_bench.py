#!/usr/bin/python3
"""Measures round trips through the cluster of docker-compose.yml, from inside of it: `./dev cluster bench`.

    cluster_bench.py [--quick] [--commit ID]

Load generators on both gateways send through broker, topology workers and back; beside them, in turns, the bare
clients of `./dev bench brokers` on the same broker, in this container. Prints a table and writes REPORT.
"""

import argparse
import contextlib
import json
import os
import shlex
import socket
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from figures import ProgramFailed, Programs, Verdict, machine, number

REPORTS = Path("/var/lib/iotcloud-reports")
PASSWORDS = Path("/run/secrets")
SIZES = {"100 B": 100, "10 KB": 10_000, "60 KB": 60_000, "200 KB": 200_000}
# broker: driver whose channels deploy/cluster/topology.yaml reads
DRIVERS = {"rabbitmq": "loadgen", "kafka": "loadgen-kafka"}
GATEWAYS, ON_EACH, RATE = ["gateway-1", "gateway-2"], 2, 100
OURS = "our broker client"
WARM_UP_S = 1  # of sending, in which drivers and bare clients connect; it does not count
SETTLE_S = 2  # time that the workers have to begin reading the new drivers; nothing is sent in it
LIMIT_S = 60  # how long a run may take in addition to the sending


def iotcloud(*words):
    done = subprocess.run(["iotcloud", *words], capture_output=True, text=True, timeout=300)
    if done.returncode:
        raise ProgramFailed(f"iotcloud {shlex.join(words)}: {done.stderr.strip() or done.stdout.strip()}")


def manifest(name, instances, properties, state):
    """Writes a manifest with the deployments NAME-0, NAME-1, ... on the gateways in turn, each with a report file of
    its own. Returns the report files."""
    reports = {f"{name}-{at}": REPORTS / f"{name}-{at}.json" for at in range(instances)}
    broker = properties["broker"]
    deployments = {key: {
        "plugin": "loadgen.so", "driver": DRIVERS[broker], "gateways": [GATEWAYS[at % len(GATEWAYS)]], "state": state,
        "metadata": {"bench": name},
        "properties": {**properties, "rate": RATE, "shared": broker == "kafka", "report": str(report)},
    } for at, (key, report) in enumerate(reports.items())}
    with tempfile.NamedTemporaryFile("w", suffix=".yaml") as file:
        json.dump({"fleet": name, "deployments": deployments}, file)
        file.flush()
        iotcloud("apply", "-f", file.name)
    return reports.values()


def take_away(name, reports):
    iotcloud("undeploy", "--where", f'bench == "{name}"')
    for report in reports:
        report.unlink(missing_ok=True)


@contextlib.contextmanager
def warm(broker):
    """Deploys a load generator on each gateway and waits until each has had an answer, so that the topics exist and are
    read. They stay."""
    name = f"warm-{broker}-{os.getpid()}-{int(time.time())}"
    reports = manifest(name, len(GATEWAYS), {"broker": broker, "count": 2 * RATE}, "active")
    try:
        wait_for(reports, LIMIT_S)
        yield
    finally:
        take_away(name, reports)


def through_the_cluster(broker, size, seconds, run):
    """One figure from the reports of a run's load generators: means over the drivers, and the largest maximum."""
    warm_up = int(RATE * WARM_UP_S)
    count = warm_up + int(RATE * seconds)
    reports = manifest(run, len(GATEWAYS) * ON_EACH,
                       {"broker": broker, "size": size, "count": count, "warm_up": warm_up}, "inactive")
    try:
        time.sleep(SETTLE_S)
        iotcloud("start", "--where", f'bench == "{run}"')
        results = wait_for(reports, WARM_UP_S + seconds + LIMIT_S)
    finally:
        take_away(run, reports)
    wrong = [result for result in results if result["lost"] or result["damaged"] or result["sent"] != count]
    if wrong:
        raise ProgramFailed(f"messages were lost or damaged: {wrong}")
    latencies = [result["latency_us"] for result in results]
    return {"p50_us": statistics.mean(each["p50"] for each in latencies),
            "p99_us": statistics.mean(each["p99"] for each in latencies), "max_us": max(each["max"] for each in latencies),
            "start_us": max(result["warm_up_latency_us"]["max"] for result in results)}


def wait_for(reports, limit):
    deadline = time.monotonic() + limit
    while True:
        texts = [report.read_text() if report.exists() else "" for report in reports]
        if all(text.rstrip().endswith("}") for text in texts):
            return [json.loads(text) for text in texts]
        if time.monotonic() > deadline:
            raise ProgramFailed(f"not everything came back within {limit:.0f} s")
        time.sleep(0.1)


class Report(Verdict):
    def compare(self, name, ours, baseline, theirs):
        ratios = [our / their for our, their in zip(ours, theirs)]
        self.results.append({
            "name": name, "value": statistics.median(ours), "unit": "ms", "baseline": baseline,
            "baseline_value": statistics.median(theirs), "ratio": statistics.median(ratios), "target": None, "met": None,
            "rounds": len(ours), "spread": (max(ours) - min(ours)) / statistics.median(ours)})
        last = self.results[-1]
        print(f"{name:44} {number(last['value']):>8} ms   {baseline:22} {number(last['baseline_value']):>8} ms   "
              f"{number(last['ratio']):>6} x", flush=True)


def measure(broker, title, url, bare, sizes, rounds, seconds, report):
    programs = Programs(Path(__file__).parent, "brokers")
    drivers = len(GATEWAYS) * ON_EACH

    def client(name, size, run):
        shared = ["--shared"] if broker == "kafka" else []
        return programs.run(name, "--url", url, "--name", run, "--drivers", drivers, "--size", size, "--rate", RATE,
                            "--warm-up", WARM_UP_S, "--seconds", seconds, *shared)[0]

    for text, size in sizes.items():
        lines = {"cluster": [], bare: [], OURS: []}
        for turn in range(rounds):
            run = f"{broker}-{size}-{turn}-{os.getpid()}-{int(time.time())}"
            steps = [("cluster", lambda run=run: through_the_cluster(broker, size, seconds, run)),
                     (bare, lambda run=run: client(broker, size, f"bare-{run}")),
                     (OURS, lambda run=run: client("iotcloud", size, f"ours-{run}"))]
            for name, step in steps if turn % 2 == 0 else reversed(steps):
                lines[name].append(step())
        for share in ("p50", "p99"):
            for beside in (bare, OURS):
                ours, theirs = ([line[f"{share}_us"] / 1000 for line in lines[name]] for name in ("cluster", beside))
                report.compare(f"{title}, {text}, {drivers} x {RATE}/s: {share}", ours, beside, theirs)


def reachable(host):
    try:
        socket.getaddrinfo(host, None)
        return True
    except socket.gaierror:
        return False


def password_of(broker):
    return (PASSWORDS / f"{broker}.password").read_text().strip()


def url_of(broker, scheme, port):
    return f"{scheme}://bench:{password_of(broker)}@{broker}:{port}"


def without_passwords(text):
    for file in PASSWORDS.glob("*.password"):
        text = text.replace(file.read_text().strip(), "PASSWORD")
    return text


def main():
    options = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    options.add_argument("--quick", action="store_true", help="two sizes, three rounds of 5 s")
    options.add_argument("--commit", default="unknown", help="what the images were made from")
    given = options.parse_args()
    facts, report, began = machine(), Report(), time.monotonic()
    print(f"{facts['cpu']}, {facts['cores']} cores, load {facts['load_average_before']:.2f}", flush=True)
    sizes = {text: SIZES[text] for text in ("100 B", "60 KB")} if given.quick else SIZES
    how = (sizes, 3, 5, report) if given.quick else (sizes, 5, 10, report)
    with warm("rabbitmq"):
        measure("rabbitmq", "RabbitMQ", url_of("rabbitmq", "amqp", 5672) + "/", "librabbitmq", *how)
    if reachable("kafka"):
        with warm("kafka"):
            measure("kafka", "Kafka", url_of("kafka", "kafka", 9092), "librdkafka", *how)
    else:
        print("Kafka: not there (./dev cluster up without --small has it)")
    written = {"machine": facts, "commit": given.commit, "command": shlex.join(["./dev", "cluster", "bench",
               *(["--quick"] if given.quick else [])]), "results": report.results}
    file = REPORTS / "cluster.json"
    file.write_text(json.dumps(written, indent=1) + "\n")
    print(f"{time.monotonic() - began:.0f} s; all figures are in {file}")


if __name__ == "__main__":
    try:
        main()
    except ProgramFailed as failure:  # its text has the command line, whose URL has the password
        sys.exit(without_passwords(str(failure)))

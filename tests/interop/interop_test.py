#!/usr/bin/python3
"""Programs of the original system on the data plane, with ours: a Java topology reads our drivers and answers them, and
our topology reads the drivers of a Java gateway and answers them, on RabbitMQ and Kafka. The Java programs
(tests/interop/java) know nothing of ours: they find channels in ZooKeeper by the original's rules, and send back every
header that they get. Each direction is counted where it ends, in our topology by tally_bolt.cc. Prints how many messages were sent, received and lost, how many had wrong headers, and which further
headers a program of the original sees; `./dev bench interop` writes the same as figures (`./dev bench keep interop`).

usage: interop_test.py BUILD_DIR [--json FILE]
Exit status 77: skipped, because a server or a library cannot be had.
"""

import argparse
import shutil
import signal
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(HERE.parent / "servers"))
sys.path.insert(0, str(ROOT / "bench"))

import figures  # noqa: E402
import private_server  # noqa: E402
import versions  # noqa: E402
from java_programs import build  # noqa: E402
from private_cluster import PATIENT_STOP, PrivateCluster, Unavailable, require, result_of, wait_for  # noqa: E402

COUNT = 300
SKIPPED = 77
RABBITMQ, KAFKA = "RabbitMQ", "Kafka"

# Our drivers, which a Java topology reads and answers: name, broker, how the channels are, instances, properties. Java writers
# declare the queue that they send to, so a RabbitMQ driver's incoming channel has it as they declare it. With a single queue the
# outgoing channel has the original's queue, too. Kafka has no queues: there the option changes nothing.
INTEROP = {"channel.control.interop": "java"}
SINGLE = {"channel.data.interop": "java", **INTEROP}
OUT_SHARED, IN_SHARED = {"channel.data.shared": "true"}, {"channel.control.shared": "true"}
SHARED = {**OUT_SHARED, **IN_SHARED}
ON_KAFKA = {"channel.data.broker": "kafka", "channel.control.broker": "kafka", **SHARED}
OWN_NAMES = {"own_names": "true"}
DRIVERS = (
    ("exclusive", RABBITMQ, "exclusive", 1, INTEROP),
    ("shared", RABBITMQ, "shared", 2, {**INTEROP, **SHARED}),
    ("single", RABBITMQ, "single queue, own names", 1, {**SINGLE, **OWN_NAMES}),
    ("single_two", RABBITMQ, "single queue, exclusive", 2, SINGLE),
    ("single_shared", RABBITMQ, "single queue, shared", 2, {**SINGLE, **SHARED}),
    ("single_shared_names", RABBITMQ, "single queue, shared, own names", 2, {**SINGLE, **SHARED, **OWN_NAMES}),
    ("single_shared_out", RABBITMQ, "single queue, only out shared", 2, {**SINGLE, **OUT_SHARED}),
    ("single_shared_in", RABBITMQ, "single queue, only in shared", 2, {**SINGLE, **IN_SHARED}),
    ("over_kafka", KAFKA, "shared", 2, {**ON_KAFKA, **OWN_NAMES}),
    ("single_kafka", KAFKA, "shared, with the option", 2, {**ON_KAFKA, **SINGLE}),
)
# Drivers of a Java gateway, which our topology reads and answers: name, broker, how the channels are, instances.
JAVA_DRIVERS = (("java_exclusive", RABBITMQ, "exclusive", 2), ("java_shared", RABBITMQ, "shared", 2),
                ("java_kafka", KAFKA, "shared", 2))


def tally_of(out, name):
    """The file in which our topology says what it got of a Java gateway's driver (tally_bolt.cc)."""
    return out / f"{name}-tally.json"


def topology_yaml(out, library):
    lines = ['zk.servers: ["{zookeeper}"]', "topology.name: answers", f'topology.library: "{library}"']
    spouts, bolts = [], []
    for name, broker, _, _ in JAVA_DRIVERS:
        spouts.append(f"  from_{name}: {{broker: {broker.lower()}, driver: {name}, channel: data, "
                      "fields: [data, driverID, time, gatewayID, {property: battery}, redelivered]}")
        bolts.append(f"  tally_{name}: {{class: test.Tally, parallelism: 1, conf: {{report: {tally_of(out, name)}, gateway: java-site}}, "
                     f"inputs: {{from: from_{name}}}}}")
        bolts.append(f"  to_{name}: {{broker: {broker.lower()}, driver: {name}, channel: control, "
                     "fields: [data, driverID, time, {property: battery}, {property: seen, as: gatewayID}], "
                     f"inputs: {{from: tally_{name}}}}}")
    return "\n".join([*lines, "spouts:", *spouts, "bolts:", *bolts, ""])


class JavaPrograms:
    """One JVM that plays the original's programs, one after the other."""

    def __init__(self, cluster, class_path):
        self.process = cluster.spawn("java", ["java", "-Xmx256m", "-XX:+UseSerialGC", "-XX:TieredStopAtLevel=1",
                                              "-Dorg.slf4j.simpleLogger.defaultLogLevel=warn", "-cp", class_path,
                                              "interop.Main"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.log = cluster.log("java")

    def say(self, *words):
        self.process.stdin.write(" ".join(map(str, words)) + "\n")
        self.process.stdin.flush()

    def hear(self):
        return self.process.stdout.readline().strip()

    def figures(self):
        answer = self.hear()
        require(answer.startswith("sent "), f"the Java program said: {answer or 'nothing'}; see {self.log}")
        words = answer.split()
        told = dict(zip(words[::2], words[1::2]))
        return {word: value if word == "others" else int(value) for word, value in told.items()}


def with_java_topology(cluster, java, servers, row):
    """Instances of a driver of ours and a Java topology: yields both directions' figures."""
    name, broker, kind, instances, properties = row
    reports = [cluster.out / f"{name}-{number}.json" for number in range(instances)]
    for report in reports:
        cluster.cli("deploy", "courier.so", "--driver", name, "--gateway", "gateway-1",
                    *(f"--property={key}={value}" for key, value in
                      {"count": COUNT, "report": report, **properties}.items()))
    java.say("topology", *servers[broker], name, COUNT)
    read = java.figures()
    layout = f"{kind}, {instances} instance{'s' if instances > 1 else ''}"
    yield "our driver -> Java topology", broker, layout, COUNT * instances, read
    wait_for(f"the instances of {name} have every answer", lambda: all(map(result_of, reports)))
    results = [result_of(report) for report in reports]
    answers = {key: sum(result[key] for result in results) for key in ("received", "twice", "wrong", "others")}
    yield "Java topology -> our driver", broker, layout, read["sent"], {**answers, "others": answers["others"] or "none"}


def with_java_gateway(java, servers, row):
    """Drivers of a Java gateway and our topology, which has a queue of its own: the gateway sends nothing that counts
    before it is answered. Returns what the gateway sent and got back."""
    name, broker, kind, instances = row
    java.say("gateway", *servers[broker], name, COUNT, instances, str(kind == "shared").lower())
    return java.figures()


def ways_through_our_topology(row, told, tally):
    """The figures of both directions. `tally`: what our topology counted; it sends on what it gets."""
    name, broker, kind, instances = row
    require(tally, f"our topology did not say what it got of {name}")
    layout = f"{kind}, {instances} instances"
    # A spout reads the properties that its topology names: others are not seen.
    yield "Java gateway -> our topology", broker, layout, told["sent"], {**tally, "others": "-"}
    yield "our topology -> Java gateway", broker, layout, tally["received"], told


def run(work, build_dir, plugins, class_path):
    with PrivateCluster(work, build_dir / "bin", plugins) as cluster:
        # RabbitMQ's Java client takes a slash at the end for a virtual host without a name.
        # Topics of Kafka have partitions, so that the programs must agree in which one a driver's messages are.
        kafka, rabbitmq = cluster.server("kafka", "--partitions", "4"), cluster.server("rabbitmq").rstrip("/")
        cluster.start(gateways=1, brokers=[f'rabbitmq: {{type: rabbitmq, urls: ["{rabbitmq}"]}}',
                                           f'kafka: {{type: kafka, urls: ["{kafka}"]}}'])
        cluster.topology("answers", topology_yaml(cluster.out, plugins / "tally_bolt.so"), PATIENT_STOP)
        java = JavaPrograms(cluster, class_path)
        zookeeper = cluster.zookeeper.removeprefix("zookeeper://")
        servers = {RABBITMQ: (zookeeper, "rabbitmq", rabbitmq), KAFKA: (zookeeper, "kafka", kafka)}
        cluster.wait_until_ready()
        rows = [row for driver in DRIVERS for row in with_java_topology(cluster, java, servers, driver)]
        told = [with_java_gateway(java, servers, driver) for driver in JAVA_DRIVERS]
        cluster.require_alive()
        cluster.end("answers", signal.SIGTERM)  # its bolts write what they counted
        for driver, answer in zip(JAVA_DRIVERS, told):
            rows += ways_through_our_topology(driver, answer, result_of(tally_of(cluster.out, driver[0])))
    return rows


def figures_of(rows):
    """The table in the form of a benchmark's results."""
    for way, broker, kind, sent, got in rows:
        name = f"{way}, {broker}, {kind}"
        yield {"name": f"{name}: received", "value": got["received"], "unit": "messages", "baseline": "sent", "baseline_value": sent,
               "ratio": got["received"] / sent if sent else None, "target": "all", "met": 0 < sent == got["received"]}
        for what, value in (("lost", sent - got["received"]), ("twice", got["twice"]), ("wrong headers", got["wrong"])):
            yield {"name": f"{name}: {what}", "value": value, "unit": "messages", "target": "none", "met": value == 0}
        if got["others"] == "-":
            continue
        told = str(got["others"]).split(",")
        yield {"name": f"{name}: other headers", "value": 0 if told == ["none"] else sum(int(each.rpartition("=")[2]) for each in told),
               "unit": "" if told == ["none"] else "of " + ", ".join(each.rpartition("=")[0] or "a driver's message" for each in told),
               "target": "none", "met": told == ["none"]}


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("build", type=Path)
    parser.add_argument("--json", type=Path, help="writes the figures to this file")
    given = parser.parse_args()
    build_dir, begun = given.build.resolve(), figures.begin(ROOT)
    try:
        class_path = build()
        work = build_dir / "interop"
        shutil.rmtree(work, ignore_errors=True)
        rows = run(work, build_dir, build_dir / "tests" / "interop" / "plugins", class_path)
    except (Unavailable, private_server.Unavailable) as error:
        print(f"skipped: {error}")
        return SKIPPED
    print(f"{'messages':<30} {'broker':<9} {'channels':<46} {'sent':>5} {'received':>9} {'lost':>5} {'twice':>6} "
          f"{'wrong headers':>14}  others")
    for way, broker, kind, sent, got in rows:
        print(f"{way:<30} {broker:<9} {kind:<46} {sent:>5} {got['received']:>9} {sent - got['received']:>5} "
              f"{got['twice']:>6} {got['wrong']:>14}  {got['others']}")
    if given.json:
        figures.write(given.json, "./dev bench interop", begun, {"versions": versions.asked(build_dir, "rabbitmq", "kafka")},
                      list(figures_of(rows)))
    bad = [row for row in rows if row[3] == 0 or row[3] != row[4]["received"] or row[4]["twice"] or row[4]["wrong"]
           or row[4]["others"] not in ("none", "-")]
    require(not bad, f"messages were lost, came twice, had wrong or other headers, or were in other partitions: {bad}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

#!/usr/bin/python3
"""What topology/storm/README.md says of components on Storm and no other test tries, on a private Storm, with exact counts:
windows, values and keys of all kinds, time-outs that begin anew, bolts that hang; and with a private broker a join of two drivers
over two workers, metadata, keepLast, a deadline, the fence of a worker that stood still, a topology that is inactive, and state in
Redis while a worker is killed.

usage: rows_on_storm.py BUILD LIBRARY COUNTING
       (BUILD: build/release; LIBRARY: the library of components.cc; COUNTING: that of tests/cluster/counting_bolt.cc)
"""
import os
import re
import signal
import sys
import time
import urllib.request
from pathlib import Path

TESTS = Path(__file__).resolve().parents[2]
sys.path[0:0] = [str(TESTS / "servers"), str(TESTS / "cluster")]
from private_cluster import PrivateCluster, result_of  # noqa: E402
from private_server import free_ports  # noqa: E402
from state_test import Store  # noqa: E402
from storm_case import StormCase, run  # noqa: E402

WAITS = "spout_wait: 5ms, bolt_wait: 5ms, back_pressure_wait: 5ms"
COUNT = 4000
KEYS = ["k%d" % number for number in range(10)]
SUM = COUNT * (COUNT + 1) // 2
WINDOW = 100
MESSAGES = 400
FEW = 50


def kinds(library, out):
    return f"""
topology.name: kinds
topology.library: {library}
conf: {{out: "{out}", count: {COUNT}}}
runtime: {{max_spout_pending: 500, message_timeout: 600s}}
engine: {{storm: {{workers: 2, {WAITS}}}}}
spouts:
  numbers: {{class: test.Numbers}}
bolts:
  mixed: {{class: test.Mixed, parallelism: 2, inputs: {{from: numbers}}}}
  typed: {{class: test.Typed, parallelism: 4, tick: 200ms, inputs: {{from: mixed, grouping: partial_key, fields: [half, key]}}}}
  window: {{class: test.Window, conf: {{window.length: {WINDOW}}}, inputs: {{from: numbers, grouping: global}}}}
  of_counts: {{class: test.Sums, inputs: {{from: window}}}}
  second: {{class: test.Window, parallelism: 2, conf: {{window.length: 1s}}, inputs: {{from: numbers, grouping: fields, fields: [key]}}}}
  of_times: {{class: test.Sums, inputs: {{from: second, grouping: global}}}}
"""


def held(library, out, name, reset):
    return f"""
topology.name: {name}
topology.library: {library}
conf: {{out: "{out}", count: 3, told_from: 0}}
runtime: {{message_timeout: 10s}}
engine: {{storm: {{{WAITS}}}}}
spouts:
  numbers: {{class: test.Numbers}}
bolts:
  holder: {{class: test.Holder, tick: 500ms, {reset}inputs: {{from: numbers}}}}
"""


def hanging(library, out):
    return f"""
topology.name: hanging
topology.library: {library}
conf: {{out: "{out}", period_ms: 50}}
runtime: {{max_spout_pending: 10, message_timeout: 600s}}
engine: {{storm: {{{WAITS}}}}}
spouts:
  numbers: {{class: test.Steady}}
  others: {{class: test.Steady}}
bolts:
  hangs: {{class: test.Hangs, tick: 100ms, inputs: {{from: others}}}}
  aside: {{class: test.Aside, inputs: {{from: numbers}}}}
  count: {{class: test.Count, tick: 100ms, inputs: {{from: aside}}}}
"""


class RowsOnStorm(StormCase):
    limit_s = 300
    cluster = counting = None

    @classmethod
    def drivers(cls):
        """A private broker with a gateway, made for the first test that asks."""
        if cls.cluster is None:
            cls.cluster = PrivateCluster(Path(cls.place.name) / "cluster", cls.build / "bin", cls.build / "plugins")
            cls.addClassCleanup(cls.cluster.stop)
            cls.cluster.start(gateways=1)
            cls.cluster.wait_until_ready(cls.limit_s)
        return cls.cluster

    def setUp(self):
        self.out = Path(self.place.name) / self.id().rpartition(".")[2]
        self.out.mkdir()

    def submit(self, name, text):
        file = self.out / ("%s.yaml" % name)
        file.write_text(text)
        print(self.ask("submit", str(file), "--limit", str(self.limit_s)), end="", flush=True)
        self.addCleanup(self.ask, "kill", name, "--wait", "0")

    def only(self, component):
        """What a component of one task wrote; empty before it does."""
        return next(iter(self.counts(self.out, component).values()), {})

    def test_values_keys_and_windows(self):
        self.submit("kinds", kinds(self.library, self.out))
        self.wait_for("all numbers are done", lambda: self.only("numbers"))
        self.assertEqual(self.only("numbers"), {"done": COUNT, "failed": 0}, self.logs())
        self.assertEqual(self.only("of_counts"), {"windows": COUNT // WINDOW, "numbers": COUNT, "sum": SUM})
        # Its tuples were acked when their windows were emitted, and those are acked, too.
        times = self.only("of_times")
        self.assertEqual((times["numbers"], times["sum"]), (COUNT, SUM))
        self.assertGreater(times["windows"], 1)
        both = [half + key for half in "ab" for key in KEYS]

        def seen():
            return {task: {word: number for word, number in words.items() if word in both}
                    for task, words in self.counts(self.out, "typed").items()}
        self.wait_for("all values are counted", lambda: sum(sum(words.values()) for words in seen().values()) == COUNT)
        self.assertEqual({words["damaged"] for words in self.counts(self.out, "typed").values()}, {0})
        # A key has two tasks at most; one of its fields alone would have as few.
        for half in "ab":
            self.assertGreater(len({task for task, words in seen().items() if any(word[0] == half for word in words)}), 2)
        for keys in both:
            self.assertLessEqual(len([task for task, words in seen().items() if keys in words]), 2, keys)
        self.assertEqual(self.table("errors", "kinds"), [])

    def test_a_time_out_that_begins_anew_does_not_pass(self):
        folder = self.out
        (folder / "left").mkdir()
        self.submit("held", held(self.library, folder, "held", "conf: {reset: 1}, "))
        self.submit("left", held(self.library, folder / "left", "left", ""))

        def left():
            return next(iter(self.counts(folder / "left", "numbers").values()), {"failed": 0})
        # A tuple fails after one to two time-outs: after two fails of each of the three, two have passed.
        self.wait_for("tuples that are left alone fail", lambda: left()["failed"] >= 6)
        self.assertEqual(self.only("numbers").get("failed", 0), 0)
        (folder / "release").touch()
        self.wait_for("the held tuples are acked", lambda: self.only("numbers").get("done") == 3)
        self.assertEqual(self.only("numbers"), {"done": 3, "failed": 0})

    def test_a_bolt_that_hangs_stops_no_other(self):
        os.mkfifo(self.out / "go")
        self.submit("hanging", hanging(self.library, self.out))
        self.wait_for("a bolt hangs", lambda: self.only("hangs").get("hangs") == 1)
        before = self.only("hangs")["ticks"]

        def ticks():
            return self.only("count").get("ticks", 0)

        def goes_on(what):
            was = ticks(), self.only("numbers").get("acked", 0)
            self.wait_for(what, lambda: ticks() >= was[0] + 30 and self.only("numbers").get("acked", 0) >= was[1] + 30)
        goes_on("ticks and answers of other bolts")
        lines = re.compile(r"\[DEBUG\] number \d+ is emitted")

        def debugs():
            return any(lines.search(log.read_text(errors="replace")) for log in self.artifacts("worker.log"))
        self.assertFalse(debugs())
        self.ask("set_log_level", "hanging", "iotcloud.test=DEBUG")
        self.wait_for("the level of the log changes", debugs)
        goes_on("ticks and answers of other bolts, still")
        self.assertEqual(self.only("hangs")["hangs"], 1)
        released = ticks()
        (self.out / "go").write_text("go")
        self.wait_for("more ticks", lambda: ticks() >= released + 10 and self.only("hangs")["hangs"] == 0)
        passed = ticks() - released
        # Those of the time in which it hung are not made up for.
        self.assertLessEqual(self.only("hangs")["ticks"], before + passed + 10)
        self.assertGreater(self.only("hangs")["ticks"], before + 1)

    def with_drivers(self, name, components, library=None):
        cluster = self.drivers()
        text = f"""
zk.servers: ["{cluster.zookeeper.removeprefix("zookeeper://")}"]
topology.name: {name}
topology.library: {library or self.library}
conf: {{out: "{self.out}"}}
metrics: {{address: "127.0.0.1:{free_ports(1)[0]}"}}
{components}"""
        self.submit(name, text)
        self.addCleanup(self.drivers().undeploy_all)

    def deploy(self, count, rate, report=None, **more):
        """Returns the instance of a load generator."""
        properties = {"size": 200, "rate": rate, "count": count, **({"report": report} if report else {}), **more}
        words = [f"--property={name}={value}" for name, value in properties.items()]
        return self.drivers().json("deploy", "loadgen.so", "--gateway", "gateway-1", *words)["outcomes"][0]["instance"]

    def counter(self, name, words=""):
        """The sum of a counter's values at all workers."""
        total = 0
        for page in self.worker_pages():
            try:
                text = urllib.request.urlopen(page, timeout=60).read().decode()
            except OSError:
                continue  # of a worker of before
            total += sum(int(value) for labels, value in re.findall(r"^%s\{(.*)\} (\d+)$" % name, text, re.M) if words in labels)
        return total

    def test_a_join_of_two_drivers_over_two_workers(self):
        self.with_drivers("joined", f"""
runtime: {{max_spout_pending: 1000, message_timeout: 300s}}
engine: {{storm: {{workers: 2, {WAITS}}}}}
spouts:
  receive:
    broker: rabbitmq
    driver: loadgen
    channel: data
    fields: [data, driverID, time, gatewayID, channel, redelivered]
    parallelism: 2
    properties: {{prefetchCount: {MESSAGES}}}
bolts:
  unpack: {{class: test.Unpack, parallelism: 2, inputs: {{from: receive}}}}
  join: {{class: test.Join, parallelism: 4, inputs: {{from: unpack, grouping: fields, fields: [n]}}}}
""")
        for _ in range(2):
            self.deploy(MESSAGES, 100)

        def total(word):
            return sum(task[word] for task in self.counts(self.out, "join").values())
        self.wait_for("all pairs", lambda: total("pairs") == MESSAGES)
        self.assertEqual((total("waiting"), total("twice")), (0, 0))
        tasks = self.counts(self.out, "join").values()
        self.assertEqual((len(tasks), len({task["process"] for task in tasks})), (4, 2))
        self.assertEqual(self.table("errors", "joined"), [])

    def echo(self, name, of_spout="", of_sender="", timeout="300s"):
        """A topology of one worker that sends messages back which its gate lets through."""
        (self.out / "shut").touch()
        self.with_drivers(name, f"""
runtime: {{message_timeout: {timeout}}}
engine: {{storm: {{{WAITS}}}}}
spouts:
  receive: {{broker: rabbitmq, driver: loadgen, channel: data, fields: [data, driverID, time], {of_spout}}}
bolts:
  gate: {{class: test.Gate, inputs: {{from: receive}}}}
  send: {{broker: rabbitmq, driver: loadgen, channel: echo, fields: [data, driverID, time], {of_sender}inputs: {{from: gate}}}}
""")

    def test_keep_last_of_a_spout(self):
        self.echo("newest", "max_spout_pending: 1, properties: {keepLast: 1}")
        self.deploy(MESSAGES, 200)
        self.wait_for("a message is at the gate", lambda: self.only("gate"))
        time.sleep(2 * MESSAGES / 200)  # the driver sends them all
        (self.out / "shut").unlink()
        self.wait_for("the newest message", lambda: self.only("gate")["last"] == MESSAGES - 1)
        # Of those for which the full spout has no room only the newest is kept.
        self.assertLess(self.only("gate")["came"], MESSAGES)

    def test_a_deadline_counts_from_the_spout_on(self):
        deadline_s = 10
        self.echo("timely", f"properties: {{prefetchCount: {2 * FEW}}}", f"deadline: {deadline_s}s, ")
        reports = [self.out / "late.json", self.out / "in_time.json"]
        self.deploy(FEW, 200, reports[0])
        self.wait_for("all are received", lambda: self.counter("iotcloud_spout_received_total") == FEW)
        time.sleep(deadline_s + 1)  # they get too old
        (self.out / "shut").unlink()
        self.wait_for("all have passed the gate", lambda: self.only("gate")["came"] == FEW)
        self.wait_for("all are late", lambda: self.counter("iotcloud_task_late_total", 'component="send"') == FEW)
        self.deploy(FEW, 20, reports[1])
        self.wait_for("those in time are back", lambda: result_of(reports[1]))
        self.assertEqual(result_of(reports[1])["received"], FEW)
        self.assertEqual(self.counter("iotcloud_task_late_total"), FEW)
        self.assertIsNone(result_of(reports[0]))

    def test_what_a_worker_had_that_stood_still_is_not_sent(self):
        self.echo("fenced", f"properties: {{prefetchCount: {2 * FEW}, maxTries: 100}}")
        report = self.out / "report.json"
        self.deploy(FEW, 200, report)
        self.wait_for("all are received", lambda: self.counter("iotcloud_spout_received_total") == FEW)
        (worker,) = self.storm.running_workers("fenced").values()
        os.kill(worker, signal.SIGSTOP)
        (self.out / "shut").unlink()
        time.sleep(16)  # the broker gives a silent connection up after three heartbeats at most, 12 s
        os.kill(worker, signal.SIGCONT)
        self.wait_for("all have come again, and are back", lambda: result_of(report))
        self.assertEqual(result_of(report)["received"], FEW)
        self.assertEqual(self.counter("iotcloud_bolt_lost_total", 'reason="fenced"'), FEW)
        self.assertEqual(set(self.storm.running_workers("fenced").values()), {worker})


    def test_a_topology_that_is_inactive_takes_no_more_than_it_holds(self):
        prefetch = 10
        self.with_drivers("paused", f"""
runtime: {{message_timeout: 300s}}
engine: {{storm: {{{WAITS}}}}}
spouts:
  receive: {{broker: rabbitmq, driver: loadgen, channel: data, fields: [data, driverID, time], properties: {{prefetchCount: {prefetch}}}}}
  steady: {{class: test.Steady, conf: {{period_ms: 50}}}}
bolts:
  count: {{class: test.Count, tick: 200ms, inputs: {{from: steady}}}}
  gate: {{class: test.Gate, inputs: {{from: receive}}}}
  send: {{broker: rabbitmq, driver: loadgen, channel: echo, fields: [data, driverID, time], inputs: {{from: gate}}}}
""")
        self.ask("deactivate", "paused")
        self.wait_for("the spouts are inactive", lambda: self.only("steady").get("deactivated") == 1)
        report = self.out / "report.json"
        self.deploy(MESSAGES, 200, report)
        time.sleep(2 * MESSAGES / 200)  # the driver sends them all
        # An executor may hear of it a moment later than the other.
        came = self.only("gate").get("came", 0)
        self.assertLess(came, MESSAGES)
        self.assertLessEqual(self.counter("iotcloud_spout_received_total", 'topology="paused"'), came + prefetch)
        self.ask("activate", "paused")
        self.wait_for("all messages are back", lambda: result_of(report))
        self.assertEqual(result_of(report)["received"], MESSAGES)

    def count_while_a_worker_is_killed(self, store, tasks, more, counts, chosen):
        """`counts`: what the bolt's state has of the driver instances that are its argument. `chosen`: of the processes of workers
        the one to kill."""
        self.with_drivers("remembered", f"""
runtime: {{max_spout_pending: 200, message_timeout: 20s}}
engine: {{storm: {{workers: 2, {more}{WAITS}}}}}
spouts:
  receive:
    broker: rabbitmq
    driver: loadgen
    channel: data
    fields: [data, driverID, time]
    parallelism: 2
    properties: {{maxTries: 1000}}
bolts:
  between:
    class: test.Counting
    parallelism: {tasks}
    conf: {{state.store: "{store}", state.checkpoint: 200ms}}
    inputs: {{from: receive, grouping: fields, fields: [driverID]}}
""", self.counting)
        # RabbitMQ drops the queue of another channel when nobody has read it for a minute.
        instances = [self.deploy(MESSAGES, 20, **{"channel.data.durable": "true"}) for _ in range(4)]
        self.wait_for("some are counted", lambda: any(counts(instances)))
        before = self.storm.running_workers("remembered")
        os.kill(chosen(before.values()), signal.SIGKILL)
        self.wait_for("all are counted", lambda: sum(counts(instances)) >= MESSAGES * len(instances))
        self.assertEqual(counts(instances), [MESSAGES] * len(instances))
        self.assertNotEqual(set(self.storm.running_workers("remembered").values()), set(before.values()))

    def test_state_in_redis_has_each_message_once_though_a_worker_is_killed(self):
        url = self.drivers().server("redis")
        store = Store(url, "remembered")
        self.count_while_a_worker_is_killed(url, 2, "", lambda instances: [store.value("count of " + each) for each in instances],
                                            lambda processes: next(iter(processes)))

    def test_state_in_a_rocksdb_on_a_common_folder_has_each_message_once_though_a_worker_is_killed(self):
        folder = self.out / "state"

        def counts(instances):
            return [self.only("between").get(each, 0) for each in instances]

        def user(processes):
            (one,) = [process for process in processes if any(file.is_symlink() and file.readlink() == folder / "LOCK"
                                                              for file in Path("/proc/%d/fd" % process).iterdir())]
            return one
        self.count_while_a_worker_is_killed(f"rocksdb://{folder}", 1, f"shared_folders: [{self.out}], ", counts, user)


if __name__ == "__main__":
    RowsOnStorm.counting = sys.argv[3]
    sys.exit(run(RowsOnStorm, *sys.argv[1:3]))

#!/usr/bin/python3
"""`iotcloud record`, `info` and `play` with RabbitMQ and ZooKeeper: a recorder that is killed loses no message, a replay driver sends
what was recorded in its order and at its pace, and so does a play. RabbitMQ has the users and rights of docker-compose.yml: the gateway is
gateway-1, the recorder one of the workers.

usage: recording_test.py BUILD_DIR
       recording_test.py BUILD_DIR --minutes 10 [--channels 1000] [--rate 1] [--speed 4] [--json FILE]
                         records so many channels for so long, with so many messages a second on each, plays that so much faster, and
                         records it again: each message must be there, with its bytes, in its order
"""

import argparse
import json
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path[:0] = [str(HERE.parent / "servers"), str(ROOT / "bench"), str(ROOT / "deploy/cluster")]

import cluster as shipped  # noqa: E402
import figures  # noqa: E402
import versions  # noqa: E402
from private_cluster import PrivateCluster, require, wait_for  # noqa: E402
from private_server import die_with_parent  # noqa: E402

RATE = 200
SIZE = 100
PASSWORD = "sesame"


class Recordings(PrivateCluster):
    def begin(self):
        """Starts servers and a gateway."""
        users, password = self.out / "users.json", self.out / "password"
        users.write_text(shipped.rabbitmq_users(dict.fromkeys(shipped.RABBITMQ_USERS, PASSWORD)))
        password.write_text(PASSWORD + "\n")
        self.rabbitmq = self.server("rabbitmq", "--users", users)
        own = f'urls: ["{self.rabbitmq}"], password_file: "{password}"'
        of_gateway = f'exchange: {shipped.GATEWAYS_EXCHANGE}, reader: gateway-1-reads, reader_password_file: "{password}"'
        self.start(gateways=1, brokers=[f"rabbitmq: {{type: rabbitmq, {own}, user: gateway-1, properties: {{{of_gateway}}}}}"])
        self.config = self.out / "recorder.yaml"
        self.config.write_text(f"brokers: {{rabbitmq: {{{own}, user: workers}}}}\n")
        self.wait_until_ready()

    def record(self, file, *words):
        """A recorder that has begun; what it says is in FILE.said."""
        command = [self.bin / "iotcloud", "record", self.out / file, *self.access(), *words]
        with open(self.out / f"{file}.said", "w", encoding="utf-8") as said:
            return subprocess.Popen([str(word) for word in command], stdout=subprocess.PIPE, stderr=said, text=True,
                                    preexec_fn=die_with_parent)

    def wait_until_listening(self, file, channels):
        wait_for(f"the recorder of {file} listens to {channels} channels",
                 lambda: f"listens to {channels} of {channels} channels" in (self.out / f"{file}.said").read_text(encoding="utf-8"))

    def access(self):
        return ["--config", self.config, "--registry", self.zookeeper]

    def play(self, file, *words):
        command = [self.bin / "iotcloud", "play", self.out / file, *self.access(), *words]
        return subprocess.run([str(word) for word in command], capture_output=True, text=True)

    def info(self, file):
        done = subprocess.run([self.bin / "iotcloud", "info", "-o", "json", self.out / file], capture_output=True, text=True)
        return json.loads(done.stdout) if done.returncode == 0 else {"messages": 0}

    def messages(self, file):
        """[topic, sequence, log time, publish time, payload] of each."""
        read = subprocess.run([self.bin / "recording_files", "messages", self.out / file],
                              capture_output=True, text=True, check=True)
        return json.loads(read.stdout)

    def end(self, recorder, how=signal.SIGINT):
        recorder.send_signal(how)
        said, _ = recorder.communicate(timeout=120)
        require(how == signal.SIGKILL or recorder.returncode == 0, said)

    def compare(self, file, played, speed):
        done = subprocess.run([self.bin / "recording_files", "compare", self.out / file, self.out / played, str(speed)],
                              capture_output=True, text=True)
        require(done.returncode == 0, done.stderr)
        return json.loads(done.stdout)


def numbers_of(messages):
    """Their sequence numbers, as the load generator wrote them into its payloads."""
    return [int.from_bytes(bytes.fromhex(message[4])[16:24], "little") for message in messages]


def check_kill(system):
    """What a killed recorder has not written, the next one of its group gets: nothing is lost."""
    first = system.record("killed.mcap", "--where", 'driver == "loadgen"', "--group", "judge")
    system.deploy("loadgen.so", "gateway-1", {"rate": RATE, "size": SIZE})
    wait_for("some of it is in the file", lambda: system.info("killed.mcap")["messages"] > 100)
    system.end(first, signal.SIGKILL)
    killed = system.info("killed.mcap")
    require(not killed["whole"] and "no end" in killed["problem"], killed)
    second = system.record("rest.mcap", "--where", 'driver == "loadgen"', "--group", "judge")
    last = max(numbers_of(system.messages("killed.mcap")))
    wait_for("what was sent since is in the file", lambda: system.info("rest.mcap")["messages"] and
             max(numbers_of(system.messages("rest.mcap"))) > last + RATE)
    system.end(second)
    require(system.info("rest.mcap")["whole"], system.info("rest.mcap"))
    recorded = set()
    for file in ("killed.mcap", "rest.mcap"):
        numbers = numbers_of(system.messages(file))
        require(numbers == sorted(numbers), f"{file} is not in order")
        recorded.update(numbers)
    lost = set(range(min(recorded), max(recorded))) - recorded
    require(not lost, f"{len(lost)} messages are in neither file: {sorted(lost)[:10]}")


def check_replay(system):
    """A replay driver sends the recorded messages under the recorded driver's name, in their order and at their pace; a play
    sends them to its channels."""
    recorded = system.messages("killed.mcap")
    recorder = system.record("replayed.mcap", "--where", 'driver == "meter"')
    # It plays in rounds: the recorder may have come too late for the first messages of the first one.
    system.cli("deploy", "replay.so", "--driver", "meter", "--gateway", "gateway-1",
               f"--property=file={system.out / 'killed.mcap'}", "--property=loop=true")
    wait_for("two rounds are recorded", lambda: system.info("replayed.mcap")["messages"] >= 2 * len(recorded))
    system.end(recorder)
    replayed = system.messages("replayed.mcap")
    begin = next(i for i, message in enumerate(replayed) if message[4] == recorded[0][4])
    replayed = replayed[begin:begin + len(recorded)]
    require([m[4] for m in replayed] == [m[4] for m in recorded], "the replay sent other messages, or in another order")
    require([m[3] for m in replayed] == [m[3] for m in recorded], "the replay's messages have other times")


def check_play(system):
    """A play sends the recorded messages to a channel that is there, in their order."""
    recorded = system.messages("killed.mcap")
    answer = system.json("deploy", "loadgen.so", "--driver", "silent", "--gateway", "gateway-1", "--property=count=1")
    instance = answer["outcomes"][0]["instance"]
    recorder = system.record("played.mcap", "--where", 'driver == "silent"')
    system.wait_until_listening("played.mcap", 1)
    known = system.info("killed.mcap")["channels"][0]["instance"]
    done = system.play("killed.mcap", "--speed", "4", "--to", f"{known}={instance}")
    require(done.returncode == 0 and f"{len(recorded)} messages played, {len(recorded)} taken" in done.stdout, done)
    payloads = [message[4] for message in recorded]

    def taken():
        """Those of the play; the one message of the driver itself may be there, too."""
        return [message[4] for message in system.messages("played.mcap") if message[4] in payloads]

    wait_for("the play is recorded", lambda: system.info("played.mcap")["messages"] and len(taken()) == len(recorded))
    system.end(recorder)
    require(taken() == payloads, "the play sent other messages")
    done = system.play("killed.mcap", "--to", f"{known}=nobody")
    require(done.returncode == 1 and "the system has no loadgen" in done.stderr, done)


def most_memory_mb(process):
    """The most that the process and the program that it has become had resident so far."""
    return int(re.search(r"VmHWM:\s+(\d+) kB", Path(f"/proc/{process}/status").read_text())[1]) / 1000


def check_long(system, given):
    """Returns the figures, in the form of a benchmark's results."""
    each = round(given.rate * 60 * given.minutes)
    seconds = 60 * given.minutes

    def wait_for_messages(what, file, least):
        """Until so many are in the file, and nothing comes any more: a broker may hand some over again."""
        before = [-1]

        def is_whole():
            time.sleep(3)  # a recorder writes once a second
            before.append(system.info(file)["messages"])
            return before[-1] >= least and before[-1] == before[-2]

        wait_for(what, is_whole, 600)

    recorder = system.record("long.mcap", "--where", 'driver == "loadgen"')
    began = time.monotonic()
    answer = system.answer("deploy", "loadgen.so", "--gateway", "gateway-1", "--count", given.channels, "--wait", 300,
                           *(f"--property={name}={value}" for name, value in {"rate": given.rate, "count": each, "size": SIZE}.items()),
                           limit=400)
    require(answer["ok"], answer)
    time.sleep(max(0, seconds - (time.monotonic() - began)))  # nothing else takes so long: `info` reads the whole file
    # The recorder may have come too late for the first message of a channel.
    wait_for_messages("all is recorded", "long.mcap", 0.99 * each * given.channels)
    memory_mb = most_memory_mb(recorder.pid)
    system.end(recorder)
    recorded = system.info("long.mcap")
    require(recorded["whole"] and len(recorded["channels"]) == given.channels, f"{len(recorded['channels'])} channels, {recorded['problem']}")

    recorder = system.record("again.mcap", "--where", 'driver == "loadgen"')
    system.wait_until_listening("again.mcap", given.channels)
    done = system.play("long.mcap", "--speed", given.speed)
    require(done.returncode == 0 and f"{recorded['messages']} messages played, {recorded['messages']} taken" in done.stdout, done)
    late_ms = float(re.search(r"the latest was ([\d.]+) ms late", done.stdout)[1])
    wait_for_messages("the play is recorded", "again.mcap", recorded["messages"])
    system.end(recorder)
    same = system.compare("long.mcap", "again.mcap", given.speed)
    total, wrong = same["messages"], len(same["different"])
    require(not same["different"], f"{len(same['different'])} messages are different: {same['different'][:20]}")
    require(same["channels"] == given.channels, same)
    print(f"{total} messages of {given.channels} channels, recorded in {given.minutes:g} min: each came again with its bytes, properties "
          f"and time, in its order; the play was at most {late_ms:.1f} ms late, and arrivals were off by {same['off_p50_ms']:.2f} ms (p50), "
          f"{same['off_p99_ms']:.2f} ms (p99); {same['twice']} were handed over again; the recorder had {memory_mb:.0f} MB")
    name = f"{given.minutes:g} min of {given.channels} channels, {given.rate * given.channels:g}/s"
    return [{"name": f"{name}: messages lost, out of order or other after record, play and record", "value": wrong, "unit": "messages",
             "target": "none", "met": wrong == 0},
            {"name": f"{name}: recorded and played", "value": total, "unit": "messages", "target": None, "met": None},
            {"name": f"{name}: played {given.speed:g} x as fast, the latest", "value": late_ms, "unit": "ms late", "target": None, "met": None},
            {"name": f"{name}: spacing of arrivals off by, p99", "value": same["off_p99_ms"], "unit": "ms", "target": None, "met": None},
            {"name": f"{name}: most memory of the recorder", "value": memory_mb, "unit": "MB", "target": None, "met": None}]


def main():
    options = argparse.ArgumentParser()
    options.add_argument("build", type=Path)
    options.add_argument("--minutes", type=float, help="of the long recording; without it the short checks")
    options.add_argument("--channels", type=int, default=1000)
    options.add_argument("--rate", type=float, default=1, help="messages a second on each channel")
    options.add_argument("--speed", type=float, default=4, help="of the play")
    options.add_argument("--json", type=Path, help="writes the long recording's figures to this file")
    given = options.parse_args()
    begun = figures.begin(ROOT) if given.json else None
    build = given.build.resolve()
    out = build / ("long-recording-test" if given.minutes else "recording-test")
    shutil.rmtree(out, ignore_errors=True)
    with Recordings(out, build / "bin", build / "plugins") as system:
        system.begin()
        if given.minutes:
            results = check_long(system, given)
        else:
            check_kill(system)
            check_replay(system)
            check_play(system)
            system.undeploy_all()
        system.require_alive()
    if given.minutes and given.json:
        figures.write(given.json, "./dev test --long -R ten_minutes_of_a_thousand_channels", begun,
                      {"versions": versions.asked(build, "rabbitmq", "zookeeper")}, results)
    print("recorded and played" if given.minutes else "recorded, killed, replayed and played")


if __name__ == "__main__":
    main()

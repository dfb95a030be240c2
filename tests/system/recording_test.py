#!/usr/bin/python3
"""`iotcloud record`, `info` and `play` with RabbitMQ and ZooKeeper: a recorder that is killed loses no message, a replay driver sends
what was recorded in its order and at its pace, and so does a play.

usage: recording_test.py BUILD_DIR
"""

import json
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "servers"))

from private_cluster import PrivateCluster, require, wait_for  # noqa: E402
from private_server import die_with_parent  # noqa: E402

RATE = 200


class Recordings(PrivateCluster):
    def record(self, file, *words):
        """A recorder that has begun; what it says is in FILE.said."""
        command = [self.bin / "iotcloud", "record", self.out / file, "--registry", self.zookeeper, *words]
        with open(self.out / f"{file}.said", "w", encoding="utf-8") as said:
            return subprocess.Popen([str(word) for word in command], stdout=subprocess.PIPE, stderr=said, text=True,
                                    preexec_fn=die_with_parent)

    def said(self, file):
        return (self.out / f"{file}.said").read_text(encoding="utf-8")

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
        said, _ = recorder.communicate(timeout=60)
        require(how == signal.SIGKILL or recorder.returncode == 0, said)


def numbers_of(messages):
    """Their sequence numbers, as the load generator wrote them into its payloads."""
    return [int.from_bytes(bytes.fromhex(message[4])[16:24], "little") for message in messages]


def check_kill(system):
    """What a killed recorder has not written, the next one of its group gets: nothing is lost."""
    first = system.record("killed.mcap", "--where", 'driver == "loadgen"', "--group", "judge")
    system.deploy("loadgen.so", "gateway-1", {"rate": RATE, "size": 100})
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
    wait_for("the recorder listens", lambda: "listens to 1 of 1 channels" in system.said("played.mcap"))
    known = system.info("killed.mcap")["channels"][0]["instance"]
    played = (system.bin / "iotcloud", "play", system.out / "killed.mcap", "--registry", system.zookeeper, "--speed", "4",
              "--to", f"{known}={instance}")
    done = subprocess.run([str(word) for word in played], capture_output=True, text=True)
    require(done.returncode == 0 and f"{len(recorded)} messages played, {len(recorded)} taken" in done.stdout, done)
    payloads = [message[4] for message in recorded]

    def taken():
        """Those of the play; the one message of the driver itself may be there, too."""
        return [message[4] for message in system.messages("played.mcap") if message[4] in payloads]

    wait_for("the play is recorded", lambda: system.info("played.mcap")["messages"] and len(taken()) == len(recorded))
    system.end(recorder)
    require(taken() == payloads, "the play sent other messages")
    done = subprocess.run([str(word) for word in (*played[:-1], f"{known}=nobody")], capture_output=True, text=True)
    require(done.returncode == 1 and "the system has no loadgen" in done.stderr, done)


def main():
    build = Path(sys.argv[1]).resolve()
    out = build / "recording-test"
    shutil.rmtree(out, ignore_errors=True)
    with Recordings(out, build / "bin", build / "plugins") as system:
        system.start(gateways=1)
        system.wait_until_ready()
        check_kill(system)
        check_replay(system)
        check_play(system)
        system.undeploy_all()
        system.require_alive()
    print("recorded, killed, replayed and played")


if __name__ == "__main__":
    main()

#!/usr/bin/python3
"""An edge node of Sparkplug B with a device, for tests: Debian's paho and protobuf, and nothing of ours but the numbers of the
payload's fields.

    edge_node.py --dir DIR mqtt://127.0.0.1:PORT GROUP NODE

When the broker has it, it prints READY and its name. Then it obeys one command for each line of stdin and answers with one line:

    birth            certificates of the node and its device, with aliases                       OK
    data VALUE       the device's metric Temperature, by its alias alone                         OK
    skip             leaves a number out                                                         OK
    unknown          data of an alias that no certificate named                                  OK
    device-death     the device is gone                                                          OK
    kill             ends without a word: the broker publishes its last will                     KILLED
    start            connects again, as the next session                                         READY ...
    heard            what came as commands since: "NCMD Node Control/Rebirth=True;DCMD ..."      (that text)

It answers a request for birth certificates as the specification wants: with all of them.
"""
import argparse
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import paho.mqtt.client as mqtt

PROTO = Path(__file__).resolve().parents[2] / "drivers/mqtt/sparkplug/payload.proto"
INT64, DOUBLE, BOOLEAN, STRING = 4, 10, 11, 12


def payloads(folder):
    """The module of payloads, which protoc makes of the fields' numbers."""
    subprocess.run(["protoc", f"--python_out={folder}", f"--proto_path={PROTO.parent}", str(PROTO)], check=True)
    sys.path.insert(0, str(folder))
    import payload_pb2
    return payload_pb2


class EdgeNode:
    def __init__(self, folder, url, group, node):
        self.pb = payloads(folder)
        self.host, self.port = url.removeprefix("mqtt://").split(":")
        self.group, self.node = group, node
        self.session, self.number = 0, 0
        self.is_alive = False
        self.lock = threading.Lock()  # whoever has it may wait for the broker, so what the library calls does not take it
        self.heard_lock = threading.Lock()
        self.heard = []
        self.start()

    def topic(self, kind):
        return f"spBv1.0/{self.group}/{kind}/{self.node}" + ("/sensor" if kind.startswith("D") else "")

    def payload(self, numbered=True):
        made = self.pb.Payload(timestamp=int(time.time() * 1000))
        if numbered:
            made.seq = self.number
            self.number = (self.number + 1) % 256
        return made

    @staticmethod
    def add(payload, name, kind, value, alias=None):
        metric = payload.metrics.add(datatype=kind, timestamp=payload.timestamp)
        if name:
            metric.name = name
        if alias is not None:
            metric.alias = alias
        field = {INT64: "long_value", DOUBLE: "double_value", BOOLEAN: "boolean_value", STRING: "string_value"}[kind]
        setattr(metric, field, value)

    def publish(self, kind, payload):
        self.client.publish(self.topic(kind), payload.SerializeToString(), qos=1).wait_for_publish(60)

    def start(self):
        self.session += 1
        will = self.payload(numbered=False)
        self.add(will, "bdSeq", INT64, self.session)
        ready = threading.Event()
        self.client = mqtt.Client(f"edge-{self.node}-{os.getpid()}-{self.session}")
        self.client.will_set(self.topic("NDEATH"), will.SerializeToString(), qos=1)
        self.client.on_connect = lambda client, *_: client.subscribe([(self.topic("NCMD"), 1), (self.topic("DCMD"), 1)])
        self.client.on_subscribe = lambda *_: ready.set()
        self.client.on_message = lambda _client, _data, message: self.commanded(message)
        self.client.connect(self.host, int(self.port))
        self.client.loop_start()
        if not ready.wait(60):
            raise RuntimeError("the broker does not answer")
        self.is_alive = True
        return f"READY {self.group}/{self.node}"

    def commanded(self, message):
        payload = self.pb.Payload.FromString(message.payload)
        for metric in payload.metrics:
            value = getattr(metric, metric.WhichOneof("value"))
            with self.heard_lock:
                self.heard.append(f"{message.topic.split('/')[2]} {metric.name}={value}")
            if metric.name == "Node Control/Rebirth" and value:
                threading.Thread(target=self.answer_rebirth).start()  # the library waits for nothing in its own thread

    def answer_rebirth(self):
        with self.lock:
            if self.is_alive:  # nobody would take it from a client that was killed
                self.tell_birth()

    def birth(self):
        with self.lock:
            self.tell_birth()
        return "OK"

    def tell_birth(self):
        self.number = 0
        node = self.payload()
        self.add(node, "bdSeq", INT64, self.session)
        self.add(node, "Node Control/Rebirth", BOOLEAN, False)
        self.publish("NBIRTH", node)
        device = self.payload()
        self.add(device, "Temperature", DOUBLE, 20.5, alias=7)
        self.add(device, "Setpoint", INT64, 21, alias=8)
        self.add(device, "Properties/Hardware Make", STRING, "Acme")
        self.publish("DBIRTH", device)

    def data(self, value):
        with self.lock:
            made = self.payload()
            metric = made.metrics.add(alias=7, timestamp=made.timestamp)
            metric.double_value = float(value)
            self.publish("DDATA", made)
        return "OK"

    def skip(self):
        with self.lock:
            self.number = (self.number + 1) % 256
        return "OK"

    def unknown(self):
        with self.lock:
            made = self.payload()
            made.metrics.add(alias=99, timestamp=made.timestamp).double_value = 1.0
            self.publish("DDATA", made)
        return "OK"

    def device_death(self):
        with self.lock:
            self.publish("DDEATH", self.payload())
        return "OK"

    def kill(self):
        with self.lock:
            self.is_alive = False
            self.client._sock_close()  # no DISCONNECT, so that the broker publishes the last will
            self.client.loop_stop(force=True)
        return "KILLED"

    def told(self):
        with self.heard_lock:
            return ";".join(self.heard)

    def obey(self, line):
        words = line.split()
        if words[0] == "data":
            return self.data(words[1])
        return {"birth": self.birth, "skip": self.skip, "unknown": self.unknown, "device-death": self.device_death,
                "kill": self.kill, "start": self.start, "heard": self.told}[words[0]]()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--dir", required=True)
    parser.add_argument("url")
    parser.add_argument("group")
    parser.add_argument("node")
    given = parser.parse_args()
    try:
        node = EdgeNode(given.dir, given.url, given.group, given.node)
    except Exception as error:  # pylint: disable=broad-except
        print(f"ERROR {error}", flush=True)
        return
    print(f"READY {given.group}/{given.node}", flush=True)
    for line in sys.stdin:
        try:
            print(node.obey(line), flush=True)
        except Exception as error:  # pylint: disable=broad-except
            print(f"ERROR {error}", flush=True)


if __name__ == "__main__":
    main()

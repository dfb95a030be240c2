#!/usr/bin/python3
"""A private Kafka cluster for tests, on loopback only, that leaves nothing behind.

    kafka_cluster.py --dir DIR [--nodes N]

Runs N nodes (3) as kafka.py runs one, each broker and controller, with a small JVM and a folder of its own below DIR.
Topics have a replica on each node unless their maker says otherwise; a message that is confirmed (acks=all) is on a
majority of them. When all of them take requests and see each other it prints their URLs in one line:

    READY kafka://127.0.0.1:PORT1 kafka://127.0.0.1:PORT2 ...

Then it obeys one command for each line of stdin and answers with one line on stdout. NODE is 1, 2, ...; without it the
command means all nodes (`start`: those that do not run). TOPIC means the node that leads the topic's partition 0.

    kill [NODE]         SIGKILL                          KILLED
    kill-leader TOPIC   SIGKILL                          KILLED
    start [NODE]        again, same port and data        READY kafka://...
    pause [NODE]        SIGSTOP: it hangs                PAUSED
    pause-leader TOPIC  SIGSTOP                          PAUSED
    resume [NODE]       SIGCONT                          RESUMED
    leader TOPIC                                         LEADER NODE
    stop                ends everything                  STOPPED

The end of stdin means `stop`. A command that fails answers `ERROR text`.
"""
import os
import struct
import time

import kafka
import nodes
import private_server

SMALL = ["-Xms64m", "-Xmx256m", *private_server.SMALL_JVM]
LEADER_LIMIT_S = 120


class KafkaCluster(nodes.Nodes):
    def __init__(self, folder, count, partitions):
        folder = os.path.abspath(folder)
        super().__init__([kafka.Kafka(os.path.join(folder, "node%d" % number), 0, partitions, False, SMALL)
                          for number in range(1, count + 1)])
        controllers = {number: node.controller_port for number, node in enumerate(self.nodes, 1)}
        for number, node in enumerate(self.nodes, 1):
            node.configure(number, controllers)

    def start(self, number=None):
        for node in self.launch(number):
            node.peers = sum(peer.runs() for peer in self.nodes)
            node.wait_until_ready()
        return "READY " + self.urls()

    def leader_of(self, topic):
        """The number of the living node that leads the topic's partition 0, once there is one."""
        limit = time.monotonic() + LEADER_LIMIT_S
        while time.monotonic() < limit:
            for node in self.nodes:
                try:
                    number = node.leader_of(topic) if node.runs() else 0
                except (OSError, struct.error):
                    continue
                if number > 0 and self.nodes[number - 1].runs():
                    return str(number)
            time.sleep(0.05)
        raise RuntimeError("no node leads %s after %d s" % (topic, LEADER_LIMIT_S))

    def leader(self, topic):
        return "LEADER " + self.leader_of(topic)

    def kill_leader(self, topic):
        return self.kill(self.leader_of(topic))

    def pause_leader(self, topic):
        return self.pause(self.leader_of(topic))

    def stop(self):
        for node in self.nodes:
            node.stop()
        return "STOPPED"

    def commands(self):
        return {**super().commands(), "kill-leader": self.kill_leader, "pause-leader": self.pause_leader,
                "leader": self.leader}


def main():
    parser = private_server.options("A private Kafka cluster")
    parser.add_argument("--nodes", type=int, default=3)
    parser.add_argument("--partitions", type=int, default=4, help="of a topic that is made by its first use")
    given = parser.parse_args()
    private_server.run(lambda: KafkaCluster(given.dir, given.nodes, given.partitions))


if __name__ == "__main__":
    main()

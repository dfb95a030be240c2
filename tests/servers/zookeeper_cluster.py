#!/usr/bin/python3
"""A private ZooKeeper ensemble for tests, on loopback only, that leaves nothing behind.

    zookeeper_cluster.py --dir DIR [--nodes N]

Runs N servers (3) as zookeeper.py runs one, each with a folder of its own below DIR, and prints the URL of all when
they serve requests and one of them leads:

    READY zookeeper://127.0.0.1:PORT1,127.0.0.1:PORT2,127.0.0.1:PORT3

Then it obeys one command for each line of stdin and answers with one line on stdout. NODE is 1, 2, ...; without it the
command means all nodes (`start`: those that do not run). `leader` in its place means the one that leads now.

    leader                which node leads                 LEADER NODE
    kill [NODE|leader]    SIGKILL                          KILLED
    start [NODE]          again, same port and data        READY zookeeper://...
    pause [NODE|leader]   SIGSTOP: it hangs                PAUSED
    resume [NODE]         SIGCONT                          RESUMED
    stop                  ends everything                  STOPPED

The end of stdin means `stop`. A command that fails answers `ERROR text`. `leader` waits until there is one.
"""
import os
import time

import private_server
import zookeeper

LEADER_LIMIT_S = 60


class ZooKeeperCluster:
    def __init__(self, folder, count):
        folder = os.path.abspath(folder)
        ports = private_server.free_ports(3 * count)
        members = ["server.%d=127.0.0.1:%d:%d" % (number, ports[count + number - 1], ports[2 * count + number - 1])
                   for number in range(1, count + 1)]
        self.nodes = []
        for number in range(1, count + 1):
            node = zookeeper.ZooKeeper(os.path.join(folder, "node%d" % number), ports[number - 1], members)
            node.name = "node %d" % number
            node.write("data/myid", ["%d" % number])
            self.nodes.append(node)

    def url(self):
        return "zookeeper://" + ",".join("127.0.0.1:%d" % node.port for node in self.nodes)

    def leading(self):
        """The one that leads; waits until there is one."""
        limit = time.monotonic() + LEADER_LIMIT_S
        while time.monotonic() < limit:
            for node in self.nodes:
                try:
                    if node.runs() and node.mode() == "leader":
                        return node
                except OSError:
                    continue  # it does not serve now
            time.sleep(0.05)
        raise RuntimeError("no node leads within %d s" % LEADER_LIMIT_S)

    def chosen(self, word):
        if word is None:
            return self.nodes
        if word == "leader":
            return [self.leading()]
        if not word.isdigit() or not 1 <= int(word) <= len(self.nodes):
            raise RuntimeError("there is no node %s; there are 1 to %d" % (word, len(self.nodes)))
        return [self.nodes[int(word) - 1]]

    def start(self, word=None):
        """All at once: each waits for the others."""
        nodes = [node for node in self.chosen(word) if word is not None or not node.runs()]
        for node in nodes:
            node.launch()
        for node in nodes:
            node.wait_until_ready()
        return "READY " + self.url()

    def leader(self):
        return "LEADER %d" % (self.nodes.index(self.leading()) + 1)

    def each(self, word, action):
        answers = [action(node) for node in self.chosen(word) if word is not None or node.runs()]
        if not answers:
            raise RuntimeError("the ensemble does not run")
        return answers[0]

    def kill(self, word=None):
        return self.each(word, zookeeper.ZooKeeper.kill)

    def pause(self, word=None):
        return self.each(word, zookeeper.ZooKeeper.pause)

    def resume(self, word=None):
        return self.each(word, zookeeper.ZooKeeper.resume)

    def stop(self):
        for node in self.nodes:
            if node.runs():
                node.kill()
        return "STOPPED"

    def commands(self):
        return {"leader": self.leader, "kill": self.kill, "start": self.start, "pause": self.pause,
                "resume": self.resume}


def main():
    parser = private_server.options("A private ZooKeeper ensemble")
    parser.add_argument("--nodes", type=int, default=3)
    given = parser.parse_args()
    private_server.run(lambda: ZooKeeperCluster(given.dir, given.nodes))


if __name__ == "__main__":
    main()

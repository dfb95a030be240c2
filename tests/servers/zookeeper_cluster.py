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

import nodes
import private_server
import zookeeper

LEADER_LIMIT_S = 120


class ZooKeeperCluster(nodes.Nodes):
    def __init__(self, folder, count):
        folder = os.path.abspath(folder)
        ports = private_server.free_ports(3 * count)
        members = ["server.%d=127.0.0.1:%d:%d" % (number, ports[count + number - 1], ports[2 * count + number - 1])
                   for number in range(1, count + 1)]
        super().__init__([zookeeper.ZooKeeper(os.path.join(folder, "node%d" % number), ports[number - 1], members)
                          for number in range(1, count + 1)])
        for number, node in enumerate(self.nodes, 1):
            node.write("data/myid", ["%d" % number])

    def url(self):
        return "zookeeper://" + ",".join("127.0.0.1:%d" % node.port for node in self.nodes)

    def leading(self):
        """The leader; waits until there is one."""
        limit = time.monotonic() + LEADER_LIMIT_S
        while time.monotonic() < limit:
            for node in self.nodes:
                try:
                    if node.runs() and node.mode() == "leader":
                        return node
                except OSError:
                    continue  # this node does not serve requests now
            time.sleep(0.05)
        raise RuntimeError("no node leads within %d s" % LEADER_LIMIT_S)

    def chosen(self, number):
        return [self.leading()] if number == "leader" else super().chosen(number)

    def start(self, number=None):
        for node in self.launch(number):
            node.wait_until_ready()
        return "READY " + self.url()

    def leader(self):
        return "LEADER %d" % (self.nodes.index(self.leading()) + 1)

    def stop(self):
        for node in self.nodes:
            if node.runs():
                node.kill()
        return "STOPPED"

    def commands(self):
        return {**super().commands(), "leader": self.leader}


def main():
    parser = private_server.options("A private ZooKeeper ensemble")
    parser.add_argument("--nodes", type=int, default=3)
    given = parser.parse_args()
    private_server.run(lambda: ZooKeeperCluster(given.dir, given.nodes))


if __name__ == "__main__":
    main()

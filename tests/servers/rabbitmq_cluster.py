#!/usr/bin/python3
"""A private RabbitMQ cluster for tests, on loopback only, that leaves nothing behind.

    rabbitmq_cluster.py --dir DIR [--nodes N]

Runs N nodes (3) as rabbitmq.py runs one, each with a folder of its own below DIR, and prints their URLs in one line
when all of them take connections and are one cluster:

    READY amqp://guest:guest@127.0.0.1:PORT1/ amqp://guest:guest@127.0.0.1:PORT2/ ...

Then it obeys one command for each line of stdin and answers with one line on stdout. NODE is 1, 2, ...; without it the
command means all nodes (`start`: those that do not run).

    kill [NODE]    SIGKILL                          KILLED
    start [NODE]   again, same port and data        READY amqp://...
    pause [NODE]   SIGSTOP: it hangs                PAUSED
    resume [NODE]  SIGCONT                          RESUMED
    stop           ends everything                  STOPPED

The end of stdin means `stop`. A command that fails answers `ERROR text`. A minority of nodes takes no clients: it waits
for the others (`pause_minority`), and a node that hung for longer than 8 s is taken for dead. Which queues are
replicated is the client's choice: `x-queue-type: quorum`.
"""
import os

import nodes
import private_server
import rabbitmq


class RabbitMqCluster(nodes.Nodes):
    def __init__(self, folder, count):
        folder = os.path.abspath(folder)
        self.mapper = rabbitmq.PortMapper(folder)
        super().__init__([rabbitmq.RabbitMq(os.path.join(folder, "node%d" % number), mapper=self.mapper, home=folder)
                          for number in range(1, count + 1)])
        for node in self.nodes:
            node.peers = [peer.node_name for peer in self.nodes]

    def start(self, number=None):
        for node in self.launch(number):
            node.wait_until_ready()
        self.nodes[0 if number is None else int(number) - 1].control(
            "await_online_nodes", str(sum(node.runs() for node in self.nodes)))
        return "READY " + self.urls()

    def stop(self):
        """Kills the nodes, because a cluster shut down node by node waits for its members."""
        for node in self.nodes:
            if node.runs():
                node.kill()
        return self.mapper.stop()


def main():
    parser = private_server.options("A private RabbitMQ cluster")
    parser.add_argument("--nodes", type=int, default=3)
    given = parser.parse_args()
    private_server.run(lambda: RabbitMqCluster(given.dir, given.nodes))


if __name__ == "__main__":
    main()

#!/usr/bin/python3
"""RabbitMQ and ZooKeeper on their usual ports of loopback, in the background (background.py), for a person who tries the
programs.

    usual_servers.py --dir DIR [--rabbitmq PORT] [--zookeeper PORT] up|status|down
"""
import os

from background import Background
from rabbitmq import RabbitMq
from zookeeper import ZooKeeper


def make(folder, ports):
    return [RabbitMq(os.path.join(folder, "rabbitmq"), ports["RabbitMQ"]),
            ZooKeeper(os.path.join(folder, "zookeeper"), ports["ZooKeeper"])]


if __name__ == "__main__":
    Background("./dev servers", "RabbitMQ and ZooKeeper on their usual ports of loopback, in the background.",
               {"RabbitMQ": 5672, "ZooKeeper": 2181}, make).run()

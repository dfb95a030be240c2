#!/usr/bin/python3
"""Apache Storm (ZooKeeper, Nimbus, a Supervisor with four slots), with Nimbus on its usual port of loopback, in the background
(background.py), for a person who tries the programs.

    usual_storm.py --dir DIR [--nimbus PORT] up|status|down
"""
from background import Background
from storm import Storm


def make(folder, ports):
    return [Storm(folder, ports["Nimbus"])]


if __name__ == "__main__":
    Background("./dev storm", "Apache Storm with Nimbus on its usual port of loopback, in the background.", {"Nimbus": 6627},
               make).run()

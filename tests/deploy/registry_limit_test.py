#!/usr/bin/python3
"""The rules of the firewall that the page of deploy/fleet has for the registry's machine: one machine gets so many connections and no
more, and another one gets its own all the same. In a network of its own (tests/cluster/network_spaces.py), where loopback has an
address for each machine.

usage: registry_limit_test.py DEPLOY_FOLDER
"""

import contextlib
import re
import shlex
import socket
import sys
import threading
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "cluster"))

import network_spaces  # noqa: E402

PORT = 2281
# By the program that makes the rule: the server's address, the thief's and another machine's.
ADDRESSES = {"iptables": ("127.0.0.1", "127.0.0.2", "127.0.0.3"), "ip6tables": ("fd00::1", "fd00::2", "fd00::3")}


def serve(listener):
    held = []
    with contextlib.suppress(OSError):  # it is closed
        while True:
            held.append(listener.accept()[0])


def connection(open_ones, here, there):
    """One more connection from an address; None: it is refused."""
    try:
        return open_ones.enter_context(socket.create_connection((there, PORT), timeout=60, source_address=(here, 0)))
    except ConnectionRefusedError:
        return None


def check(rule):
    server, thief, other = ADDRESSES[rule[0]]
    most = int(rule[rule.index("--connlimit-above") + 1])
    family = socket.AF_INET6 if ":" in server else socket.AF_INET
    with contextlib.ExitStack() as open_ones:
        listener = open_ones.enter_context(socket.create_server((server, PORT), family=family, backlog=1000))
        threading.Thread(target=serve, args=[listener], daemon=True).start()
        got = 0
        while got <= most and connection(open_ones, thief, server):
            got += 1
        if got != most:
            sys.exit(f"{shlex.join(rule)}: one machine has {got} connections")
        if not connection(open_ones, other, server):
            sys.exit(f"{shlex.join(rule)}: another machine is refused, too")
    print(f"{rule[0]}: a machine has {most} connections at most, and another one its own")


def main():
    network_spaces.in_own_network("one_machine_takes_no_others_connections_to_the_registry")
    page = (Path(sys.argv[1]) / "fleet" / "README.md").read_text(encoding="utf-8")
    rules = [shlex.split(line) for line in re.findall(r"^ip6?tables .*$", page, re.MULTILINE)]
    if [rule[0] for rule in rules] != list(ADDRESSES):
        sys.exit(f"the page has the rules {rules}")
    network_spaces.run("ip", "link", "set", "lo", "up")
    for address in ADDRESSES["ip6tables"]:
        network_spaces.run("ip", "-6", "addr", "add", address, "dev", "lo", "nodad")
    for rule in rules:
        network_spaces.run(*rule)
        check(rule)


if __name__ == "__main__":
    main()

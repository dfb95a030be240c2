#!/usr/bin/python3
"""A fleet of gateways on one machine, of which one is frozen (SIGSTOP). Orders for all of them are followed by the others
as fast as before: compared with orders of the same run, by the times in the drivers' records (printed, and judged with
--judge). The frozen one is `lost` after its session's time-out and `ready` again when it goes on, and follows then what it
missed.

usage: frozen_gateway_test.py BUILD_DIR [--gateways N] [--judge]
"""

import argparse
import json
import shutil
import signal
import statistics
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "servers"))

from fault_cluster import add_judge, judge  # noqa: E402
from private_cluster import PrivateCluster, require, wait_for  # noqa: E402
from private_server import freeze  # noqa: E402

SESSION_S = 16
WAIT_S = 60  # how long orders wait for their outcomes
# How long they wait while a gateway is frozen of which nobody knows yet. An order that waits for it takes so much longer, many
# times its usual time.
FROZEN_WAIT_S = 3


class Fleet(PrivateCluster):
    def gateway_states(self):
        return {gateway["gateway"]: gateway["state"] for gateway in json.loads(self.cli("gateways", "-o", "json"))}

    def drivers(self):
        return {driver["gateway"]: driver for driver in json.loads(self.cli("drivers", "-o", "json"))
                if not driver["metadata"]}

    def ordered(self, verb, state, but=None, wait=WAIT_S):
        """Orders it for all; seconds from the order until the last gateway, of all or of all but one, had followed, and
        the outcome of that one. With a shorter `wait` the others may be too slow for it on a busy machine; they follow all
        the same."""
        instances = [driver["instance"] for driver in self.drivers().values()]
        began = time.time()
        outcomes = self.outcomes(verb, *instances, wait=wait)
        others = {gateway: outcome for gateway, outcome in outcomes.items() if gateway != but}
        require(set(others.values()) <= ({"done"} if wait == WAIT_S else {"done", "unknown"}), f"{verb}: {outcomes}")
        records = {}

        def followed():
            records.update(self.drivers())
            return {records[gateway]["state"] for gateway in others} == {state}

        wait_for(f"{verb}: all are {state}", followed)
        return max(records[gateway]["since_ms"] for gateway in others) / 1000 - began, outcomes.get(but)

    def outcomes(self, *words, wait=WAIT_S):
        """The outcome of an order on each gateway, whatever the CLI's exit status."""
        self.last_answer = self.answer(*words, "--wait", wait)
        return {outcome["gateway"]: outcome["outcome"] for outcome in self.last_answer["outcomes"]}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("build", type=Path)
    parser.add_argument("--gateways", type=int, default=20)
    add_judge(parser)
    given = parser.parse_args()
    build = given.build.resolve()
    work = build / "frozen-gateway"
    shutil.rmtree(work, ignore_errors=True)
    with Fleet(work, build / "bin", build / "tests/gateway/plugins") as fleet:
        # The drivers have no channels.
        fleet.start(given.gateways, ['rabbitmq: {type: rabbitmq, urls: ["amqp://127.0.0.1:1/"]}'],
                    f"registry.session_timeout: {SESSION_S}s")
        wait_for("all gateways are ready", lambda: list(fleet.gateway_states().values()) == ["ready"] * given.gateways)
        fleet.cli("deploy", "probe.so", "--all", "--property", "channels=none")
        both = (("stop", "inactive"), ("start", "active"))
        for order in both:
            fleet.ordered(*order)  # to warm up
        usual = [fleet.ordered(*order)[0] for _ in range(3) for order in both]

        frozen = f"gateway-{given.gateways // 2}"
        process = next(child for name, child in fleet.children if name == frozen)
        began = time.monotonic()
        freeze(process)
        try:
            beside, unknown = [], 0
            while fleet.gateway_states()[frozen] == "ready":
                for order in both:
                    took, of_frozen = fleet.ordered(*order, but=frozen, wait=FROZEN_WAIT_S)
                    beside.append(took)
                    unknown += of_frozen == "unknown"
            lost = time.monotonic() - began
            require("(lost)" in fleet.cli("drivers"), "the frozen gateway's driver is not shown as lost")
            require(fleet.ordered("stop", "inactive", but=frozen)[1] == "pending", fleet.last_answer)
            deployed = fleet.outcomes("deploy", "probe.so", "--all", "--property", "channels=none", "--metadata", "late=yes")
            require(deployed.pop(frozen) == "pending" and set(deployed.values()) == {"done"}, fleet.last_answer)
        finally:
            process.send_signal(signal.SIGCONT)
        returned = time.monotonic()
        wait_for("the frozen gateway is ready again", lambda: fleet.gateway_states()[frozen] == "ready")
        back = time.monotonic() - returned
        wait_for("it follows what it missed: a stop", lambda: fleet.drivers()[frozen]["state"] == "inactive")
        wait_for("it follows what it missed: a deployment", lambda: [
            driver["state"] for driver in json.loads(fleet.cli("drivers", "-o", "json", "--gateway", frozen))
            if driver["metadata"].get("late")] == ["active"])
        followed = time.monotonic() - returned
        fleet.require_alive()
    ratio = statistics.median(beside) / statistics.median(usual)
    print(f"{given.gateways} gateways: the last one followed an order after {1000 * statistics.median(usual):.0f} ms; "
          f"beside a frozen one {1000 * statistics.median(beside):.0f} ms ({ratio:.2f} x; {len(beside)} orders, of which "
          f"{unknown} knew nothing of the frozen one). It was lost after {lost:.1f} s (session's time-out "
          f"{SESSION_S} s), ready {back:.1f} s after it went on, and had followed all after {followed:.1f} s")
    require(unknown > 0, "no order was given while the frozen gateway counted as ready")
    judge(given, "beside_a_frozen_gateway", ratio, "x")


if __name__ == "__main__":
    main()

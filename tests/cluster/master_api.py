"""A master's Thrift API, by a connection that is kept: for questions that are asked often, and for orders whose answers
are fetched later."""

import logging
import subprocess
import sys
from pathlib import Path


def compile_idl(build, room="master"):
    """Makes Python of the masters' or the gateways' IDL, and finds it. Each script has its own: another one that runs
    beside it imports modules when it first needs them."""
    includes = Path(build).resolve() / "include"
    out = Path(build).resolve() / "cluster-tests/thrift" / Path(sys.argv[0]).stem / room
    out.mkdir(parents=True, exist_ok=True)
    subprocess.run(["thrift", "-r", "-gen", "py", "-I", includes, "-out", out, includes / f"iotcloud/{room}/{room}.thrift"],
                   check=True)
    sys.path.insert(0, str(out))
    logging.getLogger("thrift").setLevel(logging.CRITICAL)  # every error comes as an exception too


class MasterApi:
    """Call compile_idl() before. Raises what Thrift raises, or OSError, when the master does not answer in time."""

    def __init__(self, port, limit_s=60.0):
        from master import TMasterAPIService
        from thrift.protocol import TBinaryProtocol
        from thrift.transport import TSocket, TTransport

        self.socket = TSocket.TSocket("127.0.0.1", port)
        self.socket.setTimeout(limit_s * 1000)
        self.transport = TTransport.TFramedTransport(self.socket)
        self.transport.open()
        self.client = TMasterAPIService.Client(TBinaryProtocol.TBinaryProtocol(self.transport))

    def close(self):
        self.transport.close()

    def status(self):
        return self.client.getStatus()

    def orders(self):
        return self.client.listOrders()

    def deploy(self, plugin, gateway, properties):
        """The ids of the deployed instances. Raises RuntimeError when the order failed."""
        from master.ttypes import TDeployRequest

        answer = self.client.deploy(TDeployRequest(gateways=[gateway], plugin=plugin, driver="", properties=properties,
                                                   metadata={}, count=1, waitMs=30_000))
        return self.done(answer)

    def undeploy(self, instances):
        from master.ttypes import TInstanceSelection

        self.done(self.client.undeploy(TInstanceSelection(instances=instances, gateways=[], waitMs=30_000)))

    @staticmethod
    def done(answer):
        if answer.response.state != 0:
            raise RuntimeError(answer.response.statusMessage)
        return [outcome.instance for outcome in answer.outcomes]

    def send_deploy(self, plugin, gateway, purpose, wait_s):
        """Gives the order; answer() returns its outcome."""
        from master.ttypes import TDeployRequest

        self.client.send_deploy(TDeployRequest(
            gateways=[gateway], plugin=plugin, driver="", properties={"rate": "1"}, metadata={"purpose": purpose}, count=1,
            waitMs=int(wait_s * 1000)))

    def answer(self, limit_s):
        """(why it was refused as a whole, the outcome of each instance), in the words of the IDL."""
        from master.ttypes import TOutcome, TRefusal

        self.socket.setTimeout(limit_s * 1000)
        response = self.client.recv_deploy()
        return (TRefusal._VALUES_TO_NAMES[response.refusal],
                [TOutcome._VALUES_TO_NAMES[outcome.outcome] for outcome in response.outcomes or []])

#!/usr/bin/python3
"""The original system's other half, compiled by another language from its own IDL, with our daemons: its gateway registers
with our master and is asked for heartbeats; its client deploys there, lists, stops, starts and undeploys; its master asks
our gateway for heartbeats and deploys on it.

usage: original_system_test.py BUILD_DIR
"""

import json
import shutil
import subprocess
import sys
import threading
from pathlib import Path

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parent / "servers"))

from private_cluster import PrivateCluster, free_port, require, wait_for  # noqa: E402

BUILD = Path(sys.argv[1]).resolve()
GENERATED = BUILD / "original-system" / "thrift"
shutil.rmtree(GENERATED.parent, ignore_errors=True)
GENERATED.mkdir(parents=True)
subprocess.run(["thrift", "-gen", "py", "-out", GENERATED, HERE.parent / "master/originals/original.thrift"], check=True)
sys.path.insert(0, str(GENERATED))

from original import TMasterAPIService, TMasterService, TSensorSiteService  # noqa: E402
from original.ttypes import (TChannel, TDirection, THeartBeatRequest, THeartBeatResponse, TResponse, TResponseState,  # noqa: E402
                             TSensor, TSensorDeployDescriptor, TSensorState, TSite)
from thrift.protocol import TBinaryProtocol  # noqa: E402
from thrift.server import TServer  # noqa: E402
from thrift.transport import TSocket, TTransport  # noqa: E402

SITE = "java1"
# The original's topologies read the channels of a driver with this state.
ACTIVE = TSensorState.DEPLOY


class Client:
    """A connection of the original system, framed and binary: in a `with` block it is the service's client."""

    def __init__(self, service, port):
        self.transport = TTransport.TFramedTransport(TSocket.TSocket("127.0.0.1", port))
        self.service = service

    def __enter__(self):
        self.transport.open()
        return self.service.Client(TBinaryProtocol.TBinaryProtocol(self.transport))

    def __exit__(self, *_):
        self.transport.close()


def succeeds(response):
    require(response.state == TResponseState.SUCCESS, response)
    return response.statusMessage


class OriginalGateway:
    """Answers SUCCESS at once, carries the order out later and tells the master, as the original does."""

    def __init__(self, port_of_master):
        self.port_of_master, self.port = port_of_master, free_port()
        self.heartbeats, self.calls = 0, []
        transport = TSocket.TServerSocket("127.0.0.1", self.port)
        server = TServer.TThreadedServer(TSensorSiteService.Processor(self), transport,
                                         TTransport.TFramedTransportFactory(), TBinaryProtocol.TBinaryProtocolFactory(),
                                         daemon=True)
        threading.Thread(target=server.serve, daemon=True).start()

    def site(self):
        return TSite(siteId=SITE, port=self.port, host="127.0.0.1")

    def sensor(self, number):
        kinect = TChannel(transport="rabbitmq", direction=TDirection.OUT, name="kinect", brokerUrl="amqp://127.0.0.1:5672",
                          properties={}, site=SITE, sensor="turtle", grouped=False, sensorId=number)
        return TSensor(name="turtle", siteId=SITE, state=TSensorState.DEPLOY, metadata=b"", channels=[kinect],
                       sensorId=number)

    def register_sensor(self, number):
        with Client(TMasterService, self.port_of_master) as master:
            succeeds(master.registerSensor(SITE, self.sensor(number)))

    # called by the master
    def hearbeat(self, heartBeat):
        self.heartbeats += 1
        return THeartBeatResponse(totalSensors=0, responsiveSonsor=0)

    def deploySensor(self, deployDescriptor):
        self.calls.append("deploy " + deployDescriptor.filename)
        number = f"original{len(self.calls)}"
        threading.Thread(target=self.register_sensor, args=(number,), daemon=True).start()
        return TResponse(state=TResponseState.SUCCESS, statusMessage="")

    def noted(self, verb, number):
        self.calls.append(f"{verb} {number}")
        return TResponse(state=TResponseState.SUCCESS, statusMessage="")

    def unDeploySensor(self, id):
        return self.noted("undeploy", id)

    def startSensor(self, id):
        return self.noted("start", id)

    def stopSensor(self, id):
        return self.noted("stop", id)


def check_gateway_of_the_original(cluster):
    """An original gateway and an original client, with our master between them."""
    gateway = OriginalGateway(cluster.for_gateways["master"])
    with Client(TMasterService, cluster.for_gateways["master"]) as master:
        wait_for("the master leads and registers it",
                 lambda: master.registerSite(gateway.site()).state == TResponseState.SUCCESS)
        wait_for("the master asks for heartbeats", lambda: gateway.heartbeats > 2)
    with Client(TMasterAPIService, cluster.apis["master"]) as master:
        require(sorted(master.getSites()) == ["gateway-1", SITE], master.getSites())
        details = master.getSite(SITE)
        require((details.state.state, details.details.port) == (TResponseState.SUCCESS, gateway.port), details)
        succeeds(master.deploySensor([SITE], TSensorDeployDescriptor(
            filename="turtle.jar", className="cgl.iotcloud.turtle.TurtleSensor", properties={"source": "simulation"})))
        sensors = master.getSensors(SITE)
        require([(sensor.name, sensor.siteId) for sensor in sensors] == [("turtle", SITE)], sensors)
        require([channel.brokerUrl for channel in sensors[0].channels] == ["amqp://127.0.0.1:5672"], sensors)
        number = sensors[0].sensorId
        succeeds(master.stopSiteSensors([SITE], number))
        require(master.getSensors(SITE)[0].state == TSensorState.DE_ACTIVATE, "it was not stopped")
        succeeds(master.startSensor([SITE], number))
        require(master.getSensors(SITE)[0].state == ACTIVE, "it was not started")
        succeeds(master.unDeploySensor([SITE], number))
        require(master.getSensors(SITE) == [], "it was not undeployed")
    require(gateway.calls == ["deploy turtle.jar"] + [f"{verb} {number}" for verb in ("stop", "start", "undeploy")],
            gateway.calls)
    with Client(TMasterService, cluster.for_gateways["master"]) as master:
        succeeds(master.unRegisterSite(gateway.site()))
    return gateway.heartbeats


def check_our_gateway(cluster):
    """An original client deploys through our master on our gateway, and an original master on the gateway itself."""
    loadgen = TSensorDeployDescriptor(filename="loadgen.so", className="cgl.iotcloud.loadgen.LoadSensor",
                                      properties={"rate": "1"})
    with Client(TMasterAPIService, cluster.apis["master"]) as master:
        succeeds(master.deploySensor(["gateway-1"], loadgen))
        through_master = master.getAllSensors()
        require([(sensor.name, sensor.state) for sensor in through_master] == [("loadgen", ACTIVE)],
                through_master)
        require(sorted(channel.name for channel in through_master[0].channels) == ["data", "echo"], through_master)
        succeeds(master.stopAllSensors(through_master[0].sensorId))
        require(master.getAllSensors()[0].state == TSensorState.DE_ACTIVATE, "it was not stopped")
        succeeds(master.startAllSensor(through_master[0].sensorId))
    with Client(TSensorSiteService, cluster.thrift_ports["gateway-1"]) as gateway:
        answer = gateway.hearbeat(THeartBeatRequest(sensors=1))
        require((answer.totalSensors, answer.responsiveSonsor) == (1, 1), answer)
        number = succeeds(gateway.deploySensor(loadgen))
        answer = gateway.hearbeat(THeartBeatRequest(sensors=2))
        require((answer.totalSensors, answer.responsiveSonsor) == (2, 2), answer)
        succeeds(gateway.stopSensor(number))
        states = {driver["instance"]: driver["state"] for driver in json.loads(cluster.cli("drivers", "-o", "json"))}
        require(states[number] == "inactive", states)
        succeeds(gateway.startSensor(number))
        succeeds(gateway.unDeploySensor(number))
        require(gateway.startSensor(number).state == TResponseState.FAILURE, "what is gone was started")
        require(gateway.hearbeat(THeartBeatRequest(sensors=1)).totalSensors == 1, "it was not undeployed")
    with Client(TMasterAPIService, cluster.apis["master"]) as master:
        succeeds(master.unDeployAllSensor(through_master[0].sensorId))
        require(master.getAllSensors() == [], "a driver is left over")


def main():
    with PrivateCluster(BUILD / "original-system", BUILD / "bin", BUILD / "plugins") as cluster:
        cluster.start(gateways=1)
        wait_for("our gateway is ready", lambda: [
            gateway["state"] for gateway in json.loads(cluster.cli("gateways", "-o", "json"))] == ["ready"])
        heartbeats = check_gateway_of_the_original(cluster)
        check_our_gateway(cluster)
        cluster.require_alive()
    print(f"the original's gateway (Python) with our master: registered, {heartbeats} heartbeats, every order carried out; "
          "the original's client and master with our gateway: heartbeats right, every order carried out")


if __name__ == "__main__":
    main()

"""A client of the original system, compiled from its own IDL: lists, deploys, stops, starts, undeploys.

usage: original_client.py PORT GENERATED_DIR   (exit status 0: the master answered it rightly)
"""

import subprocess
import sys
from pathlib import Path

port, generated = int(sys.argv[1]), Path(sys.argv[2])
generated.mkdir(parents=True, exist_ok=True)
idl = Path(__file__).resolve().parent / "original.thrift"
subprocess.run(["thrift", "-gen", "py", "-out", generated, idl], check=True)
sys.path.insert(0, str(generated))

from original import TMasterAPIService  # noqa: E402
from original.ttypes import TResponseState, TSensorDeployDescriptor, TSensorState  # noqa: E402
from thrift.protocol import TBinaryProtocol  # noqa: E402
from thrift.transport import TSocket, TTransport  # noqa: E402


def succeeds(response):
    assert response.state == TResponseState.SUCCESS, response.statusMessage


def fails(response, *words):
    assert response.state == TResponseState.FAILURE, response
    for word in words:
        assert word in response.statusMessage, response.statusMessage


transport = TTransport.TFramedTransport(TSocket.TSocket("127.0.0.1", port))
transport.open()
master = TMasterAPIService.Client(TBinaryProtocol.TBinaryProtocol(transport))

assert master.getSites() == ["lab1"]
site = master.getSite("lab1")
assert (site.state.state, site.details.siteId, site.details.port) == (TResponseState.SUCCESS, "lab1", 12905), site
assert [broker.name for broker in site.details.brokers] == ["rabbitmq"]
fails(master.getSite("lab9").state, "lab9")

java_class = TSensorDeployDescriptor(filename="turtle.so", className="cgl.iotcloud.turtle.TurtleSensor",
                                     properties={"source": "simulation"})
succeeds(master.deploySensor([], java_class))
fails(master.deploySensor(["lab9"], java_class), "lab9", "lab1")
sensors = master.getAllSensors()
assert len(sensors) == 1, sensors
turtle = sensors[0]
assert (turtle.name, turtle.siteId) == ("turtle", "lab1"), turtle
assert [channel.name for channel in turtle.channels] == ["kinect"], turtle
assert len(master.getSensors("lab1")) == 1 and master.getSensors("lab9") == []

succeeds(master.stopSiteSensors(["lab1"], turtle.sensorId))
assert master.getAllSensors()[0].state == TSensorState.DE_ACTIVATE
succeeds(master.startAllSensor(turtle.sensorId))
succeeds(master.stopAllSensors(turtle.sensorId))
succeeds(master.startSensor([], turtle.sensorId))
fails(master.startSensor([], "nosuch"), "nosuch")
succeeds(master.unDeploySensor(["lab1"], turtle.sensorId))
assert master.getAllSensors() == []

succeeds(master.deploySensor(["lab1"], TSensorDeployDescriptor(filename="turtle.so", className="robot")))
robot = master.getAllSensors()[0]
assert robot.name == "robot", robot
succeeds(master.unDeployAllSensor(robot.sensorId))
transport.close()

// The service of a gateway, framed and binary (port 12905). Methods, names and field ids are those of the original
// system (REFERENCE.md section 1), so that its master can order here; what is new stands below them. Every order goes
// by way of the registry, where the orders of this system's master stand too.
include "iotcloud/discovery/records.thrift"
namespace cpp iotcloud.gateway.wire

struct TPing {
  // The gateway's id.
  1: string gateway
  // Its wall time, milliseconds since 1970 UTC.
  2: i64 timeMs
}

service TSensorSiteService {
  // Spelt so in the original. totalSensors: instances ordered here; responsiveSonsor: those that are active or inactive
  // as ordered.
  records.THeartBeatResponse hearbeat(1: records.THeartBeatRequest heartBeat)
  // filename: the plugin's file name in the gateway's plugin folder. className: the driver's name; empty or a Java
  // class (it has dots): the plugin's own. SUCCESS when the instance is active; statusMessage is then its id.
  // A deployment that fails is taken back.
  records.TResponse deploySensor(1: records.TSensorDeployDescriptor deployDescriptor)
  // SUCCESS when the instance is gone, active, or inactive; FAILURE says why not, or that the outcome is not known.
  records.TResponse unDeploySensor(1: string id)
  records.TResponse startSensor(1: string id)
  records.TResponse stopSensor(1: string id)

  // ---- new
  // Opens the connection where the gateway asks for a token; SUCCESS where it does not.
  records.TResponse authenticate(1: string token)
  // Answers while the gateway serves.
  TPing ping()
}

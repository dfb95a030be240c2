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

// One change of state of one driver instance.
struct TStateChange {
  1: string instance
  2: string driver
  // As DriverState spells it.
  3: string state
  4: string reason
  // Wall time, milliseconds since 1970 UTC.
  5: i64 timeMs
}

struct TLogPart {
  // Whole lines, unless one is longer than what was asked for.
  1: string text
  // Where to go on reading.
  2: string position
}

// A question that cannot be answered.
exception TSiteError {
  1: string reason
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
  // The latest changes of state of one instance, or of all when it is empty, of those that are gone too; the oldest
  // first.
  list<TStateChange> getChanges(1: string instance) throws (1: TSiteError error)
  // What the driver host of the instance logs. position: of an earlier part; empty: the end of the log.
  TLogPart readLog(1: string instance, 2: string position, 3: i32 mostBytes) throws (1: TSiteError error)
}

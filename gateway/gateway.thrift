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

// A plugin that somebody wants to send.
struct TPluginOffer {
  // Plain file name.
  1: string plugin
  // Of all its bytes, 64 hexadecimal digits in lower case.
  2: string sha256
  // Bytes.
  3: i64 size
  // Ed25519, of all its bytes; empty: not signed.
  4: binary signature
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
  // A plugin is sent in pieces, which fit into a message of 1 MB each. The answer is the upload's id; empty: the plugin
  // is here already. An upload that nobody goes on with for a minute ends.
  string offerPlugin(1: TPluginOffer offer) throws (1: TSiteError error)
  // The bytes from `offset` on: all of them, in order. An error ends the upload.
  void sendPlugin(1: string upload, 2: i64 offset, 3: binary bytes) throws (1: TSiteError error)
  // Orders may name the plugin when this has answered.
  void finishPlugin(1: string upload) throws (1: TSiteError error)
}

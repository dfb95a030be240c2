// The service of a gateway: framed transport, binary protocol, port 12905. Methods, names and field ids are those of
// the original system (docs/wire.md#thrift), so that its master can give orders; new methods stand below them. The
// gateway writes each order that comes by this service into the registry, where this system's master writes its orders
// too.
include "iotcloud/discovery/records.thrift"
namespace cpp iotcloud.gateway.wire

struct TPing {
  // The gateway's id.
  1: string gateway
  // The gateway's wall time, milliseconds since 1970 UTC.
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
  // Whole lines, unless a line is longer than `mostBytes`.
  1: string text
  // The position of the next part.
  2: string position
}

// What the drivers of one host process have carried since it began.
struct TCarried {
  // The process's name in the gateway's metrics.
  1: string host
  // So long ago the process told this, in milliseconds.
  2: i64 ageMs
  // Messages of drivers that a broker has confirmed, and messages that were handed to drivers.
  3: i64 sent
  4: i64 received
  // Messages of drivers that were answered, by how long that took: the upper end of a range, in microseconds, and how
  // many are in it.
  5: map<double, i64> roundTrips
}

// A plugin that a client wants to send.
struct TPluginOffer {
  // File name without a path.
  1: string plugin
  // SHA-256 of the plugin's bytes: 64 hexadecimal digits in lower case.
  2: string sha256
  // In bytes.
  3: i64 size
  // Ed25519 signature of the plugin's bytes; empty: not signed.
  4: binary signature
}

// The gateway cannot answer the question.
exception TSiteError {
  1: string reason
}

service TSensorSiteService {
  // The original spells it so. totalSensors: number of instances that are ordered on this gateway; responsiveSonsor:
  // number of those that are in the ordered state, active or inactive.
  records.THeartBeatResponse hearbeat(1: records.THeartBeatRequest heartBeat)
  // filename: the plugin's file name in the gateway's plugin folder. className: the driver's name; if it is empty or a
  // Java class (it has dots), the plugin's own name is used. SUCCESS when the instance is active; statusMessage is then
  // its id. A deployment that fails is undone.
  records.TResponse deploySensor(1: records.TSensorDeployDescriptor deployDescriptor)
  // SUCCESS when the instance is gone, active or inactive, as was ordered. FAILURE: statusMessage says why it is not,
  // or that the outcome is not known.
  records.TResponse unDeploySensor(1: string id)
  records.TResponse startSensor(1: string id)
  records.TResponse stopSensor(1: string id)

  // ---- new
  // Must be the first call on a connection to a gateway that requires a token. A gateway that requires none answers
  // SUCCESS.
  records.TResponse authenticate(1: string token)
  // Answers as long as the gateway serves calls.
  TPing ping()
  // The latest changes of state of an instance; if `instance` is empty, of all instances, also of those that are gone.
  // The oldest is first.
  list<TStateChange> getChanges(1: string instance) throws (1: TSiteError error)
  // A part of the log of the instance's driver host. position: that of an earlier answer; empty: the end of the log.
  TLogPart readLog(1: string instance, 2: string position, 3: i32 mostBytes) throws (1: TSiteError error)
  // Shows what a channel of an instance carries: a sample of its messages, and their number since the look began. A
  // look without a call for 10 s ends. An answer that names a problem is an answer.
  records.TChannelLook lookAtChannel(1: records.TLookRequest request) throws (1: TSiteError error)
  // Hands the instance a message as if it had come on an incoming channel. Answers when the driver has handled it; the
  // answer's `problem` says why it has not.
  records.TChannelLook handMessage(1: records.THandedMessage message) throws (1: TSiteError error)
  // How many messages the gateway's drivers have carried, and how soon their own were answered; of each driver host.
  list<TCarried> getCarried() throws (1: TSiteError error)
  // The plugins that this gateway has, in its plugin folder and among those that were sent: 500 at most.
  list<records.TKnownPlugin> listPlugins() throws (1: TSiteError error)
  // Begins to send a plugin; its pieces must each fit into a message of 1 MB. The answer is the upload's id; empty: the
  // gateway has the plugin already. An upload without a call for a minute ends.
  string offerPlugin(1: TPluginOffer offer) throws (1: TSiteError error)
  // Sends the piece that begins at `offset`. Pieces must come in order, without gaps. An error ends the upload.
  void sendPlugin(1: string upload, 2: i64 offset, 3: binary bytes) throws (1: TSiteError error)
  // Ends the upload. Orders may name the plugin when this call has returned.
  void finishPlugin(1: string upload) throws (1: TSiteError error)
}

// The records of the registry and the structs that the services of gateway and master share (docs/wire.md#thrift).
// Names, ids and requiredness up to id 99 are those of the original system and are never changed: its programs read
// and write these bytes. New fields are optional and have ids from 100 up.
namespace cpp iotcloud.discovery.wire

// Seen from the driver: OUT = from the driver to the broker.
enum TDirection {
  IN = 0,
  OUT = 1
}

enum TSensorState {
  DEPLOY = 0,
  ACTIVE = 1,
  DE_ACTIVATE = 2,
  UN_DEPLOY = 3,
  UPDATE = 4,
  UNKNOWN = 5
}

enum TResponseState {
  SUCCESS = 0,
  FAILURE = 1
}

// One channel of a driver instance: /iot/sensors/<driver>/<instance>/<channel>.
struct TChannel {
  1: string transport
  2: TDirection direction
  3: optional map<string, string> properties
  4: optional string brokerUrl
  5: optional string name
  6: optional string site
  7: optional string sensor
  8: optional bool grouped
  9: optional string sensorId
}

// One driver instance: /iot/sensors/<driver>/<instance>.
struct TSensor {
  1: string name
  2: string siteId
  3: TSensorState state
  4: binary metadata
  5: list<TChannel> channels
  6: optional string sensorId
  // The exact state as DriverState spells it; `state` has the original's nearest state.
  100: optional string exactState
  101: optional string reason
  // Wall time of the last change, milliseconds since 1970 UTC.
  102: optional i64 sinceMs
  // The plugin's file name, the SHA-256 of its bytes, and the trusted key that signed it.
  103: optional string plugin
  104: optional string sha256
  105: optional string signedBy
  // The name under which the instance was deployed, and its number among those of that name on its gateway, from 1 on.
  106: optional string deployment
  107: optional i32 index
  // Of a failed instance: its gateway starts it again by itself.
  108: optional bool startsAgain
  // What made the instance, if no master ordered it: "rule NAME" or "finder NAME" of its gateway's own file.
  109: optional string madeBy
}

struct TBroker {
  1: string name
  2: map<string, string> properties
}

// One gateway: /iot/gateways/<id>.
struct TSite {
  1: required string siteId
  2: required i32 port
  3: required string host
  4: optional binary metadata
  5: optional list<TBroker> brokers
  // Wall time at which the gateway started, milliseconds since 1970 UTC.
  100: optional i64 sinceMs
  // In answers of the master: whether the gateway's process lives. Not set in the registry.
  101: optional bool alive
  // Whether the gateway's Thrift service requires TLS.
  102: optional bool tls
  // In answers of the master: whether the gateway drains (it gets no new instances, and its instances are stopped), and
  // whether it is of the original system (the master calls it, because it does not follow orders in the registry).
  103: optional bool draining
  104: optional bool original
  // In answers of the master: why the gateway follows no orders (the registry was emptied, say); empty: it follows them.
  105: optional string frozen
  // What the gateway's drivers cannot do now (a broker is away, say); empty: nothing is known.
  106: optional string trouble
}

// ---- new: how a person looks at a channel (discovery/channel_look.h says what each field is)

struct TLookRequest {
  1: string instance
  2: string channel
  3: string look
  4: i32 most
  5: i32 bytes
  6: bool last
  7: optional i32 everyMs
}

struct THandedMessage {
  1: string instance
  2: string channel
  3: binary payload
  4: map<string, string> properties
}

struct TSeenMessage {
  1: i64 number
  2: i64 seenMs
  3: i64 timeMs
  4: i64 size
  5: binary payload
  6: map<string, string> properties
  7: optional i64 cameUs
  8: optional i64 beginUs
  9: optional i64 endUs
  10: optional string fate
}

struct TChannelState {
  1: string name
  2: TDirection direction
  3: bool shared
  4: string broker
  5: string url
  6: string brokerState
  7: string brokerProblem
  8: i64 waiting
  9: i64 oldestMs
  10: optional i64 done
  11: optional map<string, i64> lost
}

struct TChannelLook {
  1: string problem
  2: string state
  3: string reason
  4: list<TChannelState> channels
  5: i64 elapsedUs
  6: i64 count
  7: i64 bytes
  8: i64 missed
  9: i64 shortestUs
  10: i64 longestUs
  11: i64 smallest
  12: i64 largest
  13: list<TSeenMessage> messages
  14: optional string host
  15: optional string clock
  16: optional i64 wallUs
}

// A plugin that a gateway has.
struct TKnownPlugin {
  // As orders name it; empty: it was sent, and no instance runs it.
  1: string file
  // SHA-256 of its bytes.
  2: string sha256
  3: i64 size
  // It was sent; false: it is in the gateway's plugin folder.
  4: bool sent
  // The trusted key that signed it; empty: none.
  5: string signedBy
  // The version that the signer gave; 0: none.
  6: i64 signedVersion
  // Why it would not run there; empty: nothing is known.
  7: string problem
  // What it declares of itself: JSON with driver, version, sdk_version, description and properties.
  8: string declaration
}

struct TResponse {
  1: TResponseState state
  2: string statusMessage
}

struct TSiteDetailsResponse {
  1: optional TSite details
  2: required TResponse state
}

struct TSensorDeployDescriptor {
  1: required string filename
  2: required string className
  3: optional map<string, string> properties
}

struct TSensorDeployResponse {
  1: optional list<string> deployedSites
  2: required TResponse response
}

struct THeartBeatRequest {
  1: i32 sensors
}

struct THeartBeatResponse {
  1: i32 totalSensors
  // The original spells it so.
  2: i32 responsiveSonsor
}

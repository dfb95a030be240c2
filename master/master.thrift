// The services of the gateway master: framed transport, binary protocol. Methods, names and field ids up to 99 are
// those of the original system (docs/wire.md#thrift) and are never changed; new methods stand below them in each
// service.
include "iotcloud/discovery/records.thrift"
namespace cpp iotcloud.master.wire

// ---- new: the outcome of an order for each instance

enum TOutcome {
  // The gateway reported the wanted state.
  DONE = 0,
  // The gateway reported a failure, or the order could not be written.
  FAILED = 1,
  // The order is recorded; the gateway is lost, and carries the order out when it comes back.
  PENDING = 2,
  // The gateway did not report in time; it may still carry the order out.
  UNKNOWN = 3
}

struct TInstanceOutcome {
  1: string gateway
  2: string instance
  3: TOutcome outcome
  4: string reason
}

enum TRefusal {
  NONE = 0,
  // Another master leads; `leader` is its address.
  NOT_LEADING = 1,
  UNKNOWN_GATEWAY = 2,
  UNKNOWN_INSTANCE = 3,
  BAD_REQUEST = 4,
  REGISTRY_AWAY = 5,
  // The client must call authenticate() first.
  NOT_AUTHENTICATED = 6,
  UNKNOWN_TOPOLOGY = 7,
  // The role of the client's token does not allow this call.
  NOT_ALLOWED = 8
}

// `response` is SUCCESS only when every outcome is DONE.
struct TOrderResponse {
  1: records.TResponse response
  2: list<TInstanceOutcome> outcomes
  // Why the order was refused as a whole; nothing was written then.
  3: TRefusal refusal
  // host:port of the leading master, if it is another one and known.
  4: optional string leader
}

// What one instance of a deployment has in addition to the deployment's properties.
struct TInstanceProperties {
  // Its number, from 1 on.
  1: i32 index
  2: map<string, string> properties
}

struct TDeployRequest {
  // Ids; empty: all registered gateways.
  1: list<string> gateways
  // File name; of a file in the gateway's plugin folder unless `sha256` is set.
  2: string plugin
  // The driver's name; empty: the plugin's own name is used.
  3: string driver
  4: map<string, string> properties
  5: map<string, string> metadata
  // Number of instances on each gateway.
  6: i32 count = 1
  // How long to wait for the outcomes, in milliseconds; 0: as long as the master's configuration says.
  7: i64 waitMs
  // SHA-256 of a plugin that was sent (offerPlugin); empty: the plugin is in the gateways' folders.
  8: string sha256
  // Name of the deployment. Name, gateway and a number from 1 to `count` identify an instance, which is not deployed
  // twice. Empty: the instances have no names.
  9: string name
  // With a name: the numbers of the instances to deploy, instead of 1 to `count`.
  10: list<i32> indexes
  // The manifest to which the instances belong; empty: a person deploys them.
  11: string manager
  // false: the instances are deployed, but not started.
  12: bool active = true
  // What some instances, on each gateway, have of their own.
  13: list<TInstanceProperties> own
}

// The state that is ordered for an instance.
struct TOrder {
  1: string gateway
  2: string instance
  // The driver's name; empty: the plugin's own name is used.
  3: string driver
  4: string plugin
  5: map<string, string> properties
  6: map<string, string> metadata
  // Whether the instance is to be active while its gateway does not drain.
  7: bool active
  // Name of the deployment, and number in it, from 1 on; empty and 0: the instance has no name.
  8: string name
  9: i32 index
  // The manifest to which the instance belongs; empty: a person deployed it.
  10: string manager
  // SHA-256 of a plugin that was sent; empty: the plugin is in the gateway's folder.
  11: string sha256
  // Keys of properties that look like secrets. `properties` leaves them out unless the client is an admin.
  12: list<string> hidden
}

// A change of what instances were deployed with. They keep their ids; an instance whose properties change is made anew.
struct TDeploymentChange {
  1: list<string> instances
  // All new properties; not set: they stay as they are.
  2: optional map<string, string> properties
  // The manifest to which the instances belong from now on; not set: it stays as it is.
  3: optional string manager
  4: i64 waitMs
}

struct TGatewaySelection {
  1: list<string> gateways
  2: i64 waitMs
}

struct TInstanceSelection {
  1: list<string> instances
  // If not empty, the instances must be on these gateways.
  2: list<string> gateways
  3: i64 waitMs
}

// All properties that an instance is to have.
struct TNewProperties {
  1: string instance
  2: map<string, string> properties
}

struct TUpdateRequest {
  // waitMs is the limit for each step, and for the return to what was before.
  1: TInstanceSelection selection
  // Empty: each instance keeps its own.
  2: string plugin
  // As in TDeployRequest.
  3: string sha256
  // Number of instances in one step; 0: all of one gateway.
  4: i32 atOnce
  // How long the instances of a step must stay in their state before the next step, in milliseconds.
  5: i64 settleMs
  // Instances that are not named keep their properties.
  6: list<TNewProperties> properties
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

// The state of an upload for one gateway.
struct TPluginTarget {
  1: string gateway
  // Why the gateway does not take the plugin; empty: it takes it, or has it.
  2: string problem
  // The gateway has the plugin.
  3: bool has
}

struct TUploadResponse {
  // FAILURE: nothing was sent to any gateway, or there is no such upload.
  1: records.TResponse response
  // The upload's id; empty: no (more) pieces need to be sent.
  2: string upload
  3: TRefusal refusal
  4: optional string leader
  // One for each gateway that the client named.
  5: list<TPluginTarget> targets
}

// A component in a worker.
struct TComponentShape {
  1: i32 parallelism
  2: i32 tasks
}

struct TWorker {
  1: string name
  2: string host
  3: i64 pid
  // host:port of the worker's pages; on its own machine, unless tls is set; empty: none.
  4: string http
  // "active", "inactive" or "draining".
  5: string state
  // Revision of the last order that the worker followed; 0: none.
  6: i64 revision
  // What the worker could not do of that order; empty: it did all.
  7: string error
  8: i64 sinceMs
  9: map<string, TComponentShape> components
  // What the worker cannot do now (a broker is away, say); empty: nothing is known.
  10: optional string trouble
  // Its pages take TLS and a token, so that other machines reach them.
  11: bool tls
}

// A worker place of a topology that was submitted to pools, as the pool that holds it reports it.
struct TPlace {
  1: string topology
  2: i32 place
  3: string pool
  // Of what the worker there runs, or is to run.
  4: i64 version
  // "starting", "running", "stopping" or "failed".
  5: string state
  6: string reason
  // TWorker.name; empty: not known yet.
  7: string worker
  8: i64 sinceMs
}

struct TTopology {
  1: string name
  // Wall time of its start, milliseconds since 1970 UTC.
  2: i64 sinceMs
  3: list<string> spouts
  4: list<string> bolts
  5: list<string> workers
  // The same workers, with their records.
  6: list<TWorker> workerRecords
  // The ordered state: "active", "inactive" or "killed".
  7: string wanted
  // Revision of the last order; 0: none.
  8: i64 revision
  // Of a topology that was submitted to pools: the number of its version, the SHA-256 of what that is, how many workers
  // it is to have, the manifest to which it belongs, and its places. 0 and empty: it was not.
  9: i64 version
  10: string digest
  11: i32 wantedWorkers
  12: string manager
  13: list<TPlace> places
}

// What was ordered for a submitted topology, and what became of it.
struct TTopologyEvent {
  // Wall time, milliseconds since 1970 UTC.
  1: i64 timeMs
  // "submit", "update", "rollback" or "kill".
  2: string order
  // The number of the version that it led to, and the SHA-256 of what that is.
  3: i64 version
  4: string digest
  5: i32 workers
  6: string outcome
}

// A pool of workers.
struct TPool {
  1: string pool
  // Of its Thrift service.
  2: string host
  3: i32 port
  4: bool tls
  // 0: no limit.
  5: i32 mostWorkers
  // Start of its process, wall time in milliseconds since 1970 UTC.
  6: i64 sinceMs
  // SHA-256 of the component libraries that it keeps.
  7: list<string> files
  8: list<TPlace> places
  // What it cannot do now; empty: nothing is known.
  9: string trouble
  // The random id of its state folder.
  10: string stateId
}

enum TTopologyChange {
  ACTIVATE = 0,
  DEACTIVATE = 1,
  REBALANCE = 2,
  KILL = 3
}

struct TTopologyRequest {
  1: string topology
  2: TTopologyChange change
  // For REBALANCE: the parallelism in each worker, by component.
  3: map<string, i32> parallelism
  // For KILL: how long workers wait at most for tuples under way, in milliseconds.
  4: i64 drainMs
  5: i64 waitMs
}

struct TWorkerOutcome {
  1: string worker
  2: string host
  3: TOutcome outcome
  4: string reason
}

// `response` is SUCCESS only when every outcome is DONE.
struct TTopologyResponse {
  1: records.TResponse response
  // One for each worker that ran.
  2: list<TWorkerOutcome> outcomes
  3: TRefusal refusal
  4: optional string leader
  // A text for the user, in addition to the outcomes.
  5: string text
}

// One change of state of one driver instance.
struct TDriverChange {
  1: string gateway
  2: string instance
  3: string driver
  // As in TSensor.exactState.
  4: string state
  5: string reason
  // Wall time, milliseconds since 1970 UTC.
  6: i64 timeMs
}

struct TDriverHistory {
  // The oldest first.
  1: list<TDriverChange> changes
  // By id of a gateway that could not be asked: the reason.
  2: map<string, string> silent
}

struct TGatewayPlugin {
  1: string gateway
  2: records.TKnownPlugin plugin
}

struct TGatewayPlugins {
  1: list<TGatewayPlugin> plugins
  // By id of a gateway that could not be asked: the reason.
  2: map<string, string> silent
}

struct TLogPart {
  // Whole lines, unless a line is longer than `mostBytes`.
  1: string text
  // The position of the next part.
  2: string position
}

struct TMasterStatus {
  1: string id
  2: bool leading
  // Epoch of this master's leadership, which is in its orders; 0: it does not lead.
  3: i64 epoch
  // host:port of the leading master; empty: none leads, or it is not known.
  4: string leader
  5: bool registryAway
}

// The master cannot answer the question now.
exception TMasterError {
  1: string reason
}

// For the CLI and other clients; port 12904.
service TMasterAPIService {
  // An empty list of sites means all. SUCCESS only when every gateway has done it.
  list<string> getSites()
  records.TSiteDetailsResponse getSite(1: string siteId)
  // filename: the plugin's file name. className: the driver's name; if it is empty or a Java class, the plugin's own is
  // used.
  records.TResponse deploySensor(1: list<string> sites, 2: records.TSensorDeployDescriptor deployDescriptor)
  records.TResponse unDeploySensor(1: list<string> sites, 2: string id)
  records.TResponse unDeployAllSensor(1: string id)
  records.TResponse startSensor(1: list<string> sites, 2: string id)
  records.TResponse startAllSensor(1: string id)
  records.TResponse stopSiteSensors(1: list<string> sites, 2: string id)
  records.TResponse stopAllSensors(1: string id)
  list<records.TSensor> getSensors(1: string siteId)
  list<records.TSensor> getAllSensors()

  // ---- new
  // Must be the first call on a connection to a master that requires a token. A master that requires none answers
  // SUCCESS.
  records.TResponse authenticate(1: string token)
  TMasterStatus getStatus() throws (1: TMasterError error)
  // All gateways; `alive` is set.
  list<records.TSite> listGateways() throws (1: TMasterError error)
  // All instances; exactState, reason and sinceMs are set.
  list<records.TSensor> listDrivers() throws (1: TMasterError error)
  list<TTopology> listTopologies() throws (1: TMasterError error)
  // The pools of workers that live.
  list<TPool> listPools() throws (1: TMasterError error)
  // The latest changes of state that the gateways have recorded since their start. instances: ids, or beginnings of
  // ids; empty: all. gateways: empty: all. most: how many changes at most; 0, and more than 10000, mean 10000.
  TDriverHistory getHistory(1: list<string> instances, 2: list<string> gateways, 3: i32 most)
    throws (1: TMasterError error)
  // A part of the log of an instance's driver host. position: that of an earlier answer; empty: the end of the log.
  TLogPart readLog(1: string gateway, 2: string instance, 3: string position, 4: i32 mostBytes)
    throws (1: TMasterError error)
  // The plugins that gateways have. gateways: empty: all.
  TGatewayPlugins listPlugins(1: list<string> gateways) throws (1: TMasterError error)
  // What was ordered for a topology, the oldest first; also for one that was killed.
  list<TTopologyEvent> getTopologyHistory(1: string topology) throws (1: TMasterError error)
  // A part of the log of the workers at a place of a submitted topology, as readLog().
  TLogPart readWorkerLog(1: string topology, 2: i32 place, 3: string position, 4: i32 mostBytes)
    throws (1: TMasterError error)
  // A page of a topology's worker, which the master reads. target: "/topology", or "/tap?..." as the worker takes it.
  string readWorkerPage(1: string topology, 2: string worker, 3: string target) throws (1: TMasterError error)
  // The gateway's lookAtChannel() and handMessage(), which the master passes on.
  records.TChannelLook lookAtChannel(1: string gateway, 2: records.TLookRequest request)
    throws (1: TMasterError error)
  records.TChannelLook handMessage(1: string gateway, 2: records.THandedMessage message)
    throws (1: TMasterError error)
  TOrderResponse deploy(1: TDeployRequest request)
  TOrderResponse undeploy(1: TInstanceSelection selection)
  TOrderResponse start(1: TInstanceSelection selection)
  TOrderResponse stop(1: TInstanceSelection selection)
  // A key with an empty value is removed.
  TOrderResponse updateMetadata(1: TInstanceSelection selection, 2: map<string, string> changes)
  TOrderResponse changeDeployment(1: TDeploymentChange change)
  // The orders for all instances, except those on gateways of the original system.
  list<TOrder> listOrders() throws (1: TMasterError error)
  // Everything that is ordered, with secrets: JSON, for the order "import" (orders/backup_file.h).
  string exportOrders() throws (1: TMasterError error)
  // While a gateway drains, nothing is deployed on it and its instances are stopped; undrain() starts them again.
  TOrderResponse drain(1: TGatewaySelection selection)
  TOrderResponse undrain(1: TGatewaySelection selection)
  // Gives any order to driver instances. order: the name of its kind, which is that of its method here if it has one.
  // json: the order as JSON, with the fields of its struct in orders/orders.h.
  TOrderResponse giveOrder(1: string order, 2: string json)
  TTopologyResponse orderTopology(1: TTopologyRequest request)
  // Begins to send a plugin to gateways. The pieces, half a megabyte each at most, must go one after the other to the
  // same master, which passes them on. An upload without a call for a minute ends. gateways: empty: all.
  TUploadResponse offerPlugin(1: TPluginOffer offer, 2: list<string> gateways)
  // The same for a component library, to all pools of workers; its pieces are sent in the same way.
  TUploadResponse offerLibrary(1: TPluginOffer offer)
  TUploadResponse sendPlugin(1: string upload, 2: i64 offset, 3: binary bytes)
  TUploadResponse finishPlugin(1: string upload)
  // Gives instances another plugin, other properties, or both. They keep id and metadata. If one does not reach its
  // state, all instances that were updated return to what they had.
  TOrderResponse update(1: TUpdateRequest request)
}

// For gateways of the original system; port 12903. Gateways of this system write to the registry themselves.
service TMasterService {
  records.TResponse registerSite(1: records.TSite site)
  records.TResponse unRegisterSite(1: records.TSite site)
  records.TResponse registerSensor(1: string siteId, 2: records.TSensor sensor)
  records.TResponse unRegisterSensor(1: string siteId, 2: string id)
  records.TResponse updateSensor(1: string siteId, 2: records.TSensor sensor)
}

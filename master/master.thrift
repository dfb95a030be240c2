// The services of the gateway master, framed and binary. Methods, names and field ids up to 99 are those of the
// original system (REFERENCE.md section 1) and are never changed; what is new stands below them in each service.
include "iotcloud/discovery/records.thrift"
namespace cpp iotcloud.master.wire

// ---- new: an order's outcome for each instance

enum TOutcome {
  // The gateway reported the wanted state.
  DONE = 0,
  // The gateway reported a failure, or the order could not be written.
  FAILED = 1,
  // Recorded; the gateway is lost and follows when it comes back.
  PENDING = 2,
  // Nothing was heard in time: it may still happen.
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
  // Another master leads: `leader`.
  NOT_LEADING = 1,
  UNKNOWN_GATEWAY = 2,
  UNKNOWN_INSTANCE = 3,
  BAD_REQUEST = 4,
  REGISTRY_AWAY = 5,
  // authenticate() first.
  NOT_AUTHENTICATED = 6,
  UNKNOWN_TOPOLOGY = 7,
  // The role of the token that was shown may not do this.
  NOT_ALLOWED = 8
}

// SUCCESS only when every outcome is DONE.
struct TOrderResponse {
  1: records.TResponse response
  2: list<TInstanceOutcome> outcomes
  // When the order was refused as a whole: nothing was written.
  3: TRefusal refusal
  // host:port of the master that leads, when this one does not and knows it.
  4: optional string leader
}

struct TDeployRequest {
  // Empty: all that are registered.
  1: list<string> gateways
  // File name, in the gateway's plugin folder unless `sha256` is given.
  2: string plugin
  // The driver's name; empty: the plugin's own.
  3: string driver
  4: map<string, string> properties
  5: map<string, string> metadata
  // Instances on each gateway.
  6: i32 count = 1
  // How long to wait for the outcomes, milliseconds; 0: as long as the master thinks fit.
  7: i64 waitMs
  // Of a plugin that was sent with offerPlugin and so on; empty: of the gateways' folders.
  8: string sha256
  // Of the deployment. With the gateway and a number from 1 to `count` it names an instance, which is not deployed twice.
  // Empty: the instances have no names.
  9: string name
  // With a name: these numbers, not 1 to `count`.
  10: list<i32> indexes
  // The manifest that the instances belong to; empty: a person deploys.
  11: string manager
  // false: they are deployed, and wait to be started.
  12: bool active = true
}

// What is wanted of one instance.
struct TOrder {
  1: string gateway
  2: string instance
  // Empty: the plugin's own.
  3: string driver
  4: string plugin
  5: map<string, string> properties
  6: map<string, string> metadata
  // Active, once its gateway does not drain.
  7: bool active
  // Its name and its number, from 1 on; empty and 0: it has none.
  8: string name
  9: i32 index
  // The manifest that it belongs to; empty: a person deployed it.
  10: string manager
  // Of a plugin that was sent; empty: of the gateway's folder.
  11: string sha256
  // Keys of properties that look like secrets, which only an admin is told; they do not stand in `properties`.
  12: list<string> hidden
}

// What instances were deployed with, to be changed. They keep their ids; those whose properties change are made anew.
struct TDeploymentChange {
  1: list<string> instances
  // All of them. Not set: as they are.
  2: optional map<string, string> properties
  // The manifest that they belong to from now on. Not set: as it is.
  3: optional string manager
  4: i64 waitMs
}

struct TGatewaySelection {
  1: list<string> gateways
  2: i64 waitMs
}

struct TInstanceSelection {
  1: list<string> instances
  // When not empty, the instances must be on one of these.
  2: list<string> gateways
  3: i64 waitMs
}

struct TUpdateRequest {
  // waitMs: for each step, and as long again to go back.
  1: TInstanceSelection selection
  2: string plugin
  // As in TDeployRequest.
  3: string sha256
  // Instances in one step; 0: all of one gateway.
  4: i32 atOnce
  // How long those of a step must stay up before the next one, milliseconds.
  5: i64 settleMs
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

// What became of the sending, for one gateway.
struct TPluginTarget {
  1: string gateway
  // Why it does not take the plugin; empty: it does, or has it.
  2: string problem
  // The plugin is there.
  3: bool has
}

struct TUploadResponse {
  // FAILURE: nothing was sent to any gateway, or there is no such upload.
  1: records.TResponse response
  // Empty: there is nothing (more) to be sent.
  2: string upload
  3: TRefusal refusal
  4: optional string leader
  // All gateways that were named.
  5: list<TPluginTarget> targets
}

// Of one worker.
struct TComponentShape {
  1: i32 parallelism
  2: i32 tasks
}

struct TWorker {
  1: string name
  2: string host
  3: i64 pid
  // host:port of its pages, on its own machine; empty: none.
  4: string http
  // active, inactive, draining
  5: string state
  // Of the last order that it followed; 0: none.
  6: i64 revision
  // What of that order it could not do; empty: it did all.
  7: string error
  8: i64 sinceMs
  9: map<string, TComponentShape> components
}

struct TTopology {
  1: string name
  // Wall time of its start, milliseconds since 1970 UTC.
  2: i64 sinceMs
  3: list<string> spouts
  4: list<string> bolts
  5: list<string> workers
  // The same with what they say of themselves.
  6: list<TWorker> workerRecords
  // What is ordered: active, inactive, killed.
  7: string wanted
  // Of the last order; 0: none.
  8: i64 revision
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
  // REBALANCE: in each worker, by component.
  3: map<string, i32> parallelism
  // KILL: what is under way is waited for so long at most, milliseconds.
  4: i64 drainMs
  5: i64 waitMs
}

struct TWorkerOutcome {
  1: string worker
  2: string host
  3: TOutcome outcome
  4: string reason
}

// SUCCESS only when every outcome is DONE.
struct TTopologyResponse {
  1: records.TResponse response
  // Of each worker that ran.
  2: list<TWorkerOutcome> outcomes
  3: TRefusal refusal
  4: optional string leader
  // To be said besides the outcomes, for people.
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
  // Gateways that could not be asked, and why.
  2: map<string, string> silent
}

struct TLogPart {
  // Whole lines, unless one is longer than what was asked for.
  1: string text
  // Where to go on reading.
  2: string position
}

struct TMasterStatus {
  1: string id
  2: bool leading
  // Of this master's orders; 0 while it does not lead.
  3: i64 epoch
  // host:port of the master that leads; empty: none, or not known.
  4: string leader
  5: bool registryAway
}

// A question that cannot be answered now.
exception TMasterError {
  1: string reason
}

// For people's programs; port 12904.
service TMasterAPIService {
  // An empty list of sites means all. SUCCESS only when every gateway has done it.
  list<string> getSites()
  records.TSiteDetailsResponse getSite(1: string siteId)
  // filename: the plugin's file name. className: the driver's name; empty or a Java class: the plugin's own.
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
  // Opens the connection where the master asks for a token; SUCCESS where it does not.
  records.TResponse authenticate(1: string token)
  TMasterStatus getStatus() throws (1: TMasterError error)
  // With `alive`.
  list<records.TSite> listGateways() throws (1: TMasterError error)
  // With exactState, reason and sinceMs.
  list<records.TSensor> listDrivers() throws (1: TMasterError error)
  list<TTopology> listTopologies() throws (1: TMasterError error)
  // The latest changes of state, as the gateways remember them since their start. instances: ids, or how they begin;
  // empty for all. gateways: empty for all. most: so many of the latest; 0, and more than 10000: 10000.
  TDriverHistory getHistory(1: list<string> instances, 2: list<string> gateways, 3: i32 most)
    throws (1: TMasterError error)
  // What the driver host of an instance logs. position: of an earlier part; empty: the end of the log.
  TLogPart readLog(1: string gateway, 2: string instance, 3: string position, 4: i32 mostBytes)
    throws (1: TMasterError error)
  TOrderResponse deploy(1: TDeployRequest request)
  TOrderResponse undeploy(1: TInstanceSelection selection)
  TOrderResponse start(1: TInstanceSelection selection)
  TOrderResponse stop(1: TInstanceSelection selection)
  // An empty value takes the key away.
  TOrderResponse updateMetadata(1: TInstanceSelection selection, 2: map<string, string> changes)
  TOrderResponse changeDeployment(1: TDeploymentChange change)
  // What is wanted of every instance. Not of those on gateways of the original system.
  list<TOrder> listOrders() throws (1: TMasterError error)
  // Nothing is deployed on a gateway that drains, and its instances are stopped; undrain starts those again.
  TOrderResponse drain(1: TGatewaySelection selection)
  TOrderResponse undrain(1: TGatewaySelection selection)
  TTopologyResponse orderTopology(1: TTopologyRequest request)
  // A plugin is sent to gateways in pieces of half a megabyte at most, one after the other, by way of one master. It
  // passes them on; an upload that nobody goes on with for a minute ends. gateways: empty for all.
  TUploadResponse offerPlugin(1: TPluginOffer offer, 2: list<string> gateways)
  TUploadResponse sendPlugin(1: string upload, 2: i64 offset, 3: binary bytes)
  TUploadResponse finishPlugin(1: string upload)
  // Instances keep id, properties and metadata. All that were updated go back when one does not come to its state.
  TOrderResponse update(1: TUpdateRequest request)
}

// For gateways of the original system; port 12903. Gateways of this one write to the registry themselves.
service TMasterService {
  records.TResponse registerSite(1: records.TSite site)
  records.TResponse unRegisterSite(1: records.TSite site)
  records.TResponse registerSensor(1: string siteId, 2: records.TSensor sensor)
  records.TResponse unRegisterSensor(1: string siteId, 2: string id)
  records.TResponse updateSensor(1: string siteId, 2: records.TSensor sensor)
}

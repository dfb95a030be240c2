// The API as clients of the original system were compiled with it (docs/wire.md#thrift): no new method, no new
// field. It is a copy that does not include our files, so that tests with it notice a change of ours that breaks old
// clients.
enum TDirection { IN = 0, OUT = 1 }
enum TSensorState { DEPLOY = 0, ACTIVE = 1, DE_ACTIVATE = 2, UN_DEPLOY = 3, UPDATE = 4, UNKNOWN = 5 }
enum TResponseState { SUCCESS = 0, FAILURE = 1 }

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

struct TSensor {
  1: string name
  2: string siteId
  3: TSensorState state
  4: binary metadata
  5: list<TChannel> channels
  6: optional string sensorId
}

struct TBroker { 1: string name, 2: map<string, string> properties }

struct TSite {
  1: required string siteId
  2: required i32 port
  3: required string host
  4: optional binary metadata
  5: optional list<TBroker> brokers
}

struct TResponse { 1: TResponseState state, 2: string statusMessage }
struct TSiteDetailsResponse { 1: optional TSite details, 2: required TResponse state }
struct TSensorDeployDescriptor {
  1: required string filename
  2: required string className
  3: optional map<string, string> properties
}

service TMasterAPIService {
  list<string> getSites()
  TSiteDetailsResponse getSite(1: string siteId)
  TResponse deploySensor(1: list<string> sites, 2: TSensorDeployDescriptor sensor)
  TResponse unDeploySensor(1: list<string> sites, 2: string id)
  TResponse unDeployAllSensor(1: string id)
  TResponse startSensor(1: list<string> sites, 2: string id)
  TResponse startAllSensor(1: string id)
  TResponse stopSiteSensors(1: list<string> sites, 2: string id)
  TResponse stopAllSensors(1: string id)
  list<TSensor> getSensors(1: string siteId)
  list<TSensor> getAllSensors()
}

service TMasterService {
  TResponse registerSite(1: TSite site)
  TResponse unRegisterSite(1: TSite site)
  TResponse registerSensor(1: string siteId, 2: TSensor sensor)
  TResponse unRegisterSensor(1: string siteId, 2: string id)
  TResponse updateSensor(1: string siteId, 2: TSensor sensor)
}

struct THeartBeatRequest { 1: i32 sensors }
struct THeartBeatResponse { 1: i32 totalSensors, 2: i32 responsiveSonsor }

service TSensorSiteService {
  THeartBeatResponse hearbeat(1: THeartBeatRequest heartBeat)
  TResponse deploySensor(1: TSensorDeployDescriptor deployDescriptor)
  TResponse unDeploySensor(1: string id)
  TResponse startSensor(1: string id)
  TResponse stopSensor(1: string id)
}

// What this project uses of Apache Storm 2.8's storm.thrift: the names of fields are free, their numbers are Storm's.
namespace cpp iotcloud.topology.storm.idl

union JavaObjectArg {
  1: i32 int_arg
  2: i64 long_arg
  3: string string_arg
  4: bool bool_arg
  5: binary binary_arg
  6: double double_arg
}
struct JavaObject {
  1: required string full_class_name
  2: required list<JavaObjectArg> args_list
}
struct ShellComponent {
  1: string execution_command
  2: string script
}
union ComponentObject {
  1: binary serialized_java
  2: ShellComponent shell
  3: JavaObject java_object
}
struct NullStruct {
}
union Grouping {
  1: list<string> fields // empty: global
  2: NullStruct shuffle
  3: NullStruct all
  4: NullStruct none
  5: NullStruct direct
  6: JavaObject custom_object
  7: binary custom_serialized
  8: NullStruct local_or_shuffle
}
struct GlobalStreamId {
  1: required string componentId
  2: required string streamId
}
struct StreamInfo {
  1: required list<string> output_fields
  2: required bool direct
}
struct ComponentCommon {
  1: required map<GlobalStreamId, Grouping> inputs
  2: required map<string, StreamInfo> streams
  3: optional i32 parallelism_hint
  4: optional string json_conf
}
struct SpoutSpec {
  1: required ComponentObject spout_object
  2: required ComponentCommon common
}
struct Bolt {
  1: required ComponentObject bolt_object
  2: required ComponentCommon common
}
struct StateSpoutSpec {
  1: required ComponentObject state_spout_object
  2: required ComponentCommon common
}
struct StormTopology {
  1: required map<string, SpoutSpec> spouts
  2: required map<string, Bolt> bolts
  3: required map<string, StateSpoutSpec> state_spouts
}

enum TopologyInitialStatus {
  ACTIVE = 1
  INACTIVE = 2
}
struct SubmitOptions {
  1: required TopologyInitialStatus initial_status
}
struct KillOptions {
  1: optional i32 wait_secs
}
struct RebalanceOptions {
  1: optional i32 wait_secs
  2: optional i32 num_workers
  3: optional map<string, i32> num_executors
}

struct NimbusSummary {
  1: required string host
  2: required i32 port
  4: required bool isLeader
  5: required string version
}
struct TopologySummary {
  1: required string id
  2: required string name
  3: required i32 num_tasks
  4: required i32 num_executors
  5: required i32 num_workers
  6: required i32 uptime_secs
  7: required string status
  513: optional string sched_status
}
struct ErrorInfo {
  1: required string error
  2: required i32 error_time_secs
  3: optional string host
  4: optional i32 port
}
struct ExecutorInfo {
  1: required i32 task_start
  2: required i32 task_end
}
struct ExecutorStats {
  4: required double rate
}
struct ExecutorSummary {
  1: required ExecutorInfo executor_info
  2: required string component_id
  3: required string host
  4: required i32 port
  5: required i32 uptime_secs
  7: optional ExecutorStats stats
}
struct TopologyInfo {
  1: required string id
  2: required string name
  3: required i32 uptime_secs
  4: required list<ExecutorSummary> executors
  5: required string status
  6: required map<string, list<ErrorInfo>> errors
  513: optional string sched_status
}
struct CommonAggregateStats {
  1: optional i32 num_executors
  2: optional i32 num_tasks
  3: optional i64 emitted
  4: optional i64 transferred
  5: optional i64 acked
  6: optional i64 failed
}
struct SpoutAggregateStats {
  1: optional double complete_latency_ms
}
struct BoltAggregateStats {
  1: optional double execute_latency_ms
  2: optional double process_latency_ms
  3: optional i64 executed
  4: optional double capacity
}
union SpecificAggregateStats {
  1: BoltAggregateStats bolt
  2: SpoutAggregateStats spout
}
struct ComponentAggregateStats {
  2: optional CommonAggregateStats common_stats
  3: optional SpecificAggregateStats specific_stats
  4: optional ErrorInfo last_error
}
struct TopologyPageInfo {
  1: required string id
  9: optional map<string, ComponentAggregateStats> id_to_spout_agg_stats
  10: optional map<string, ComponentAggregateStats> id_to_bolt_agg_stats
}

enum LogLevelAction {
  UNCHANGED = 1, UPDATE = 2, REMOVE = 3
}
struct LogLevel {
  1: required LogLevelAction action
  2: optional string target_log_level
  3: optional i32 reset_log_level_timeout_secs
}
struct LogConfig {
  2: optional map<string, LogLevel> named_logger_level
}

exception AlreadyAliveException {
  1: required string msg
}
exception NotAliveException {
  1: required string msg
}
exception InvalidTopologyException {
  1: required string msg
}
exception AuthorizationException {
  1: required string msg
}

service Nimbus {
  void submitTopologyWithOpts(1: string name, 2: string uploadedJarLocation, 3: string jsonConf,
                              4: StormTopology topology, 5: SubmitOptions options)
    throws (1: AlreadyAliveException e, 2: InvalidTopologyException ite, 3: AuthorizationException aze)
  void killTopologyWithOpts(1: string name, 2: KillOptions options)
    throws (1: NotAliveException e, 2: AuthorizationException aze)
  void activate(1: string name) throws (1: NotAliveException e, 2: AuthorizationException aze)
  void deactivate(1: string name) throws (1: NotAliveException e, 2: AuthorizationException aze)
  void rebalance(1: string name, 2: RebalanceOptions options)
    throws (1: NotAliveException e, 2: InvalidTopologyException ite, 3: AuthorizationException aze)
  void setLogConfig(1: string id, 2: LogConfig config)
  string beginFileUpload() throws (1: AuthorizationException aze)
  void uploadChunk(1: string location, 2: binary chunk) throws (1: AuthorizationException aze)
  void finishFileUpload(1: string location) throws (1: AuthorizationException aze)
  NimbusSummary getLeader() throws (1: AuthorizationException aze)
  list<TopologySummary> getTopologySummaries() throws (1: AuthorizationException aze)
  TopologyInfo getTopologyInfoByName(1: string name)
    throws (1: NotAliveException e, 2: AuthorizationException aze)
  TopologyPageInfo getTopologyPageInfo(1: string id, 2: string window, 3: bool is_include_sys)
    throws (1: NotAliveException e, 2: AuthorizationException aze)
}

#pragma once

namespace iotcloud::brokers::kafka {

/// How the members of a group share its partitions. Cooperative, so that partitions which stay with their reader are
/// read without interruption, if the library can do that safely. Before 2.3.0 the group's leader ends its process
/// (`Assertion 'assignor_state' failed`, librdkafka issue 4312) when the group's server stands still after the leader
/// was away for longer than its session. Before 2.6.0 it may compute for ever when members read different topics (issue
/// 4783). Otherwise eager: all members stop reading for a moment whenever the group changes. Among the eager ones
/// `range` would give topics with one partition to the same member always. \param library_version as rd_kafka_version()
/// returns it, 0xMMmmrrff: that of the library in use, not of its headers
constexpr bool is_cooperative(int library_version) {
  constexpr int safe_version = 0x020600ff;
  return library_version >= safe_version;
}

/// The value of `partition.assignment.strategy`.
constexpr const char* assignment_strategy(int library_version) {
  return is_cooperative(library_version) ? "cooperative-sticky" : "roundrobin";
}

}  // namespace iotcloud::brokers::kafka

#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

/// Sparkplug B: what edge nodes say over MQTT about themselves, their devices and their metrics.
namespace iotcloud::drivers::mqtt::sparkplug {

enum class Kind {
  node_birth,
  node_data,
  node_death,
  node_command,
  device_birth,
  device_data,
  device_death,
  device_command
};

/// A topic: spBv1.0/GROUP/KIND/NODE[/DEVICE].
struct Topic {
  std::string group, node;
  std::string device;  ///< empty: the node itself
  Kind kind = Kind::node_data;
  std::string text() const;
};
/// nullopt: it is no topic of Sparkplug B, or one of its host applications.
std::optional<Topic> parse_topic(std::string_view topic);

/// The numbers of data types that have a meaning here.
enum class Type : std::uint32_t {
  unknown = 0,
  int8 = 1,
  int16,
  int32,
  int64,
  uint8,
  uint16,
  uint32,
  uint64,
  floating,
  real,
  boolean,
  string,
  date_time,
  text,
  uuid,
  data_set,
  bytes,
  file,
  structure
};
/// "Int8"; "Unknown" for another number.
std::string name_of(Type type);

using Value = std::variant<std::monostate, bool, std::int64_t, std::uint64_t, float, double, std::string>;

struct Metric {
  std::string name;  ///< empty: only its alias is told
  std::optional<std::uint64_t> alias;
  std::optional<std::uint64_t> timestamp_ms;
  std::optional<Type> type;  ///< birth certificates tell it
  bool is_historical = false;
  Value value;  ///< monostate: null
  /// What came, of a data set or a template; the value has its bytes.
  bool is_opaque = false;
};

struct Payload {
  std::optional<std::uint64_t> timestamp_ms;
  std::optional<std::uint64_t> seq;
  std::vector<Metric> metrics;
};

inline constexpr std::size_t most_metrics = 20'000;  ///< of a payload

/// The payload in these bytes; nullopt: they are none, or it has more than most_metrics.
std::optional<Payload> decode(std::string_view bytes);
std::string encode(const Payload& payload);

/// Reads a value of a type from text, as people and topologies give it. \throws std::invalid_argument that says what
/// the type takes
Value value_of(Type type, const std::string& text);

/// Milliseconds since 1970 UTC, for time stamps.
std::uint64_t wall_time_ms();
/// The payload that asks a node for all its birth certificates.
Payload rebirth_request(std::uint64_t now_ms);

/// What is known of one edge node: its sequence of messages, and the metrics that its birth certificates named.
class Node {
 public:
  enum class Heard {
    in_order,  ///< what it says is valid
    gap,       ///< a message is missing, or there was no birth certificate yet: ask for them
    stale,     ///< a death of an earlier session: nothing follows of it
    too_much,  ///< a birth certificate that would make bytes() more than most_bytes: it is passed over
  };
  static constexpr std::size_t most_bytes = std::size_t{16} << 20;
  /// The memory, about, that the birth certificates take which it keeps.
  std::size_t bytes() const { return bytes_; }

  /// Takes a message of the node, or of one of its devices, and completes its metrics: their names and types by their
  /// aliases.
  Heard take(const Topic& topic, Payload& payload);
  bool is_alive() const { return alive_; }
  bool is_alive(const std::string& device) const { return metrics_.contains(device); }
  /// The type of a metric of a device (empty: of the node) by its birth certificate; nullopt: it named none so
  std::optional<Type> type_of(const std::string& device, const std::string& metric) const;
  /// The connection to the broker was lost: what it missed is not known.
  void lose_track() { expected_.reset(); }

 private:
  struct Known {
    std::map<std::string, Type, std::less<>> types;
    std::map<std::uint64_t, std::string> names;  ///< by alias
    std::size_t bytes = 0;
  };
  bool complete(const std::string& device, Payload& payload) const;
  bool learn(const std::string& device, const Payload& payload);
  void forget(const std::string& device);
  void forget_all();

  bool alive_ = false;
  std::optional<std::uint64_t> session_;   ///< bdSeq of the birth certificate
  std::optional<std::uint64_t> expected_;  ///< the number of the next message; nullopt: not known
  std::map<std::string, Known> metrics_;   ///< by device; of those that are alive
  std::size_t bytes_ = 0;
};

}  // namespace iotcloud::drivers::mqtt::sparkplug

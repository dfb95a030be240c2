#pragma once

#include <chrono>
#include <compare>
#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <unordered_map>
#include <utility>
#include <vector>

#include <iotcloud/brokers/message.h>
#include <iotcloud/recording/error.h>
#include <iotcloud/recording/mcap/reader.h>
#include <iotcloud/recording/mcap/writer.h>

/// Recordings of channels (docs/wire.md#recordings).
namespace iotcloud::recording {

/// A channel of one driver instance, as it was recorded.
struct RecordedChannel {
  std::string driver;    ///< the driver's name ("meter")
  std::string instance;  ///< its id; empty in a recording of another program
  std::string alias;     ///< its name for people ("meter/2"); may be empty
  std::string gateway;
  std::string name;  ///< the channel's
  bool out = true;   ///< from the driver to the cloud
  bool shared = false;
  std::map<std::string, std::string> metadata{};  ///< of the instance, when the channel was first recorded
  friend auto operator<=>(const RecordedChannel&, const RecordedChannel&) = default;
};

/// Time since 1970 UTC, never negative.
using Instant = std::chrono::nanoseconds;

/// A message, and when it was recorded.
struct RecordedMessage {
  std::size_t channel = 0;  ///< index in RecordingReader::channels()
  Instant at{0};
  brokers::Message message{};
};

/// Writes a recording: an MCAP file. Not thread safe.
class RecordingWriter {
 public:
  struct Options {
    mcap::Compression compression = mcap::Compression::zstd;
    std::size_t chunk_bytes = 1 << 20;
  };
  /// \throws RecordingError when the file is there already or cannot be made.
  RecordingWriter(std::string path, Options options);

  /// A channel that messages will be added to. Nothing is written until the first one.
  std::size_t add_channel(RecordedChannel channel);
  /// Adds a message. `at` must not be less than that of the message before, or is raised to it.
  /// \throws RecordingError when the file cannot be written, or has no room for another sender's channel.
  void add(std::size_t channel, const brokers::Message& message, Instant at);
  /// Writes what has been added, so that it survives the process.
  void flush() { writer_.flush(true); }
  /// Writes the end. Nothing may be added afterwards.
  void close() { writer_.close(); }

  std::uint64_t messages() const { return messages_; }
  std::uint32_t chunks() const { return writer_.statistics().chunks; }  ///< that are in the file
  std::uint64_t written() const { return writer_.written(); }

 private:
  /// What the messages of one sender on one channel are written to.
  struct Stream {
    std::uint16_t channel = 0;
    std::optional<std::uint16_t> properties{};
    std::uint32_t sequence = 0;
    std::string topic{};
  };
  Stream& stream_of(std::size_t channel, const brokers::Message& message);

  mcap::Writer writer_;
  std::vector<RecordedChannel> channels_;
  /// By channel, driver id and gateway id of the message.
  std::map<std::tuple<std::size_t, std::string, std::string>, Stream> streams_;
  std::set<std::string> topics_;
  std::uint64_t last_ = 0;
  std::uint64_t messages_ = 0;
  std::string properties_bytes_;
};

/// Reads a recording, or an MCAP file of another program, whose topics become channels. Not thread safe.
class RecordingReader {
 public:
  /// \throws RecordingError.
  explicit RecordingReader(std::string path, mcap::Limits limits = {});

  const std::vector<RecordedChannel>& channels() const { return channels_; }
  /// How many messages of each channel there are.
  const std::vector<std::uint64_t>& counts() const { return counts_; }
  const mcap::Reader& file() const { return reader_; }
  Instant start() const { return instant_of(reader_.statistics().start_time); }
  Instant end() const { return instant_of(reader_.statistics().end_time); }

  /// The next message, in the order in which they were recorded; nullopt: there are no more. \throws RecordingError.
  std::optional<RecordedMessage> next();
  void rewind();
  void check() { reader_.check(); }

 private:
  /// A channel of the file.
  struct Source {
    std::size_t channel = 0;  ///< index in channels_
    std::string driver_id{}, gateway_id{};
    std::optional<std::uint16_t> properties_of{};  ///< its messages are properties of those of this one
  };
  struct Waiting {
    std::uint32_t sequence = 0;
    std::size_t bytes = 0;  ///< in the file
    brokers::Properties properties{};
    std::optional<std::int64_t> time_ms{};
  };
  /// A time of the file; one that Instant cannot hold is its last.
  static Instant instant_of(std::uint64_t nanoseconds);
  void read_channels();
  void keep_properties(const Source& source, const mcap::Message& record);

  mcap::Reader reader_;
  std::vector<RecordedChannel> channels_;
  std::vector<std::uint64_t> counts_;
  std::unordered_map<std::uint16_t, Source> sources_;
  std::unordered_map<std::uint16_t, Waiting> waiting_;  ///< by the channel whose next message they are of
  std::size_t waiting_bytes_ = 0;                       ///< of all of them
};

/// Whether a word names the instance of a channel: its id, the id's beginning (4 characters or more), or its alias.
bool names_instance(const RecordedChannel& channel, std::string_view word);

}  // namespace iotcloud::recording

#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include <iotcloud/recording/mcap/compression.h>
#include <iotcloud/recording/mcap/records.h>

namespace iotcloud::recording::mcap {

/// Writes an MCAP file: channels, chunks of messages each with its message indexes, and at the end the summary. What a
/// chunk has been written with survives the process, whatever becomes of it: channels stand before the chunks that need
/// them. Memory is bounded by a chunk, the largest message and the descriptions of the channels; what the summary says
/// of chunks waits in a file without a name. Not thread safe.
class Writer {
 public:
  struct Options {
    std::string profile{}, library = "iotcloud";
    Compression compression = Compression::zstd;
    std::size_t chunk_bytes = 1 << 20;  ///< a chunk that has so many is written
  };
  /// Makes the file, which must not be there. \throws RecordingError.
  Writer(std::string path, Options options);
  /// Leaves the file without a summary, as if the process had been killed, unless close() was called.
  ~Writer();
  Writer(const Writer&) = delete;
  Writer& operator=(const Writer&) = delete;

  // Each of these throws RecordingError when the file cannot be written; what was written by then stays readable.
  std::uint16_t add_schema(std::string_view name, std::string_view encoding, std::string_view data);
  /// \param schema 0: none. \throws RecordingError for more than 65535 channels, too.
  std::uint16_t add_channel(std::uint16_t schema, std::string_view topic, std::string_view message_encoding,
                            Map metadata);
  /// Adds a message to the open chunk. \throws RecordingError for a channel that was not added, too.
  void add(const Message& message);
  void add(const Metadata& metadata);
  /// Writes the open chunk if it has `chunk_bytes` or, with `whatever_it_has`, a message.
  void flush(bool whatever_it_has);
  /// Writes the last chunk and the summary, and syncs the file. Nothing may be added afterwards.
  void close();

  const Statistics& statistics() const { return statistics_; }
  std::uint64_t written() const { return written_; }  ///< bytes of the file

 private:
  using Entries = std::vector<std::pair<std::uint64_t, std::uint64_t>>;
  void write(std::string_view bytes);
  void write_chunk();
  [[noreturn]] void fail(const std::string& what) const;

  const std::string path_;
  const Options options_;
  int file_ = -1, spill_ = -1;  ///< spill_: ChunkIndex records, in order
  std::uint64_t written_ = 0, spilled_ = 0;
  std::uint32_t crc_ = 0;                        ///< of all that was written
  std::string schemas_, channels_;               ///< records, for the summary
  std::string metadata_indexes_;                 ///< records
  std::string records_;                          ///< the open chunk's
  std::map<std::uint16_t, Entries> entries_;     ///< of the open chunk, by channel
  std::uint64_t start_time_ = 0, end_time_ = 0;  ///< of the open chunk
  std::vector<std::uint64_t> counts_;            ///< of messages, by channel
  Statistics statistics_;
};

}  // namespace iotcloud::recording::mcap

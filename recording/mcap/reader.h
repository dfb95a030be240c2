#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <queue>
#include <set>
#include <string>
#include <vector>

#include <iotcloud/recording/mcap/records.h>

namespace iotcloud::recording::mcap {

/// What a reader takes at most: a file may come from anybody.
struct Limits {
  std::uint64_t chunk = std::uint64_t{256} << 20;        ///< bytes of a chunk, before and after decompression
  std::uint64_t open_chunks = std::uint64_t{512} << 20;  ///< of all chunks together whose times overlap
  std::uint64_t descriptions = std::uint64_t{64} << 20;  ///< of all schemas, channels and metadata together
  std::uint64_t chunks = 16'000'000;                     ///< number of chunks
};

/// Reads an MCAP file of any program: by its summary, or without one (the writer was killed, or the end of the file is
/// lost) as far as its records are whole. Memory is bounded by Limits. Not thread safe.
class Reader {
 public:
  /// Reads the summary, or else all records once. \throws RecordingError for a file that is no MCAP or beyond a limit.
  explicit Reader(std::string path, Limits limits = {});
  ~Reader();
  Reader(const Reader&) = delete;
  Reader& operator=(const Reader&) = delete;

  const Header& header() const { return header_; }
  const std::map<std::uint16_t, Schema>& schemas() const { return schemas_; }
  const std::map<std::uint16_t, Channel>& channels() const { return channels_; }
  /// Of the summary, or counted.
  const Statistics& statistics() const { return statistics_; }
  const std::vector<Metadata>& metadata() const { return metadata_; }
  /// How the chunks are compressed: "", "lz4", "zstd".
  const std::set<std::string>& compressions() const { return compressions_; }
  std::uint64_t size() const { return size_; }  ///< of the file, in bytes
  /// Whether the file has its end; false: it was read up to the last whole record.
  bool whole() const { return problem_.empty(); }
  /// What is wrong with it, for people; empty: nothing.
  const std::string& problem() const { return problem_; }

  /// The next message by log time; messages of one time in the file's order. nullopt: there are no more.
  /// Its data are valid until the next call. \throws RecordingError for a damaged chunk, or messages of an unknown
  /// channel.
  std::optional<Message> next();
  /// next() begins again.
  void rewind();
  /// Reads every chunk, and compares all checksums that there are, that of the whole data too.
  /// \throws RecordingError that says what is damaged, and where.
  void check();

 private:
  class File;
  /// A chunk, or a run of messages outside of chunks.
  struct Piece {
    std::uint64_t start_time = 0, end_time = 0;
    std::uint64_t offset = 0;  ///< of the record, or of the first one
    std::uint64_t length = 0;  ///< with the record's head
    bool chunk = true;
  };
  /// A piece that is being read: its messages in order of time.
  struct Open {
    std::string records;
    std::vector<std::pair<std::uint64_t, std::uint64_t>> messages{};  ///< log time, offset in `records`
    std::size_t next = 0;
  };
  /// The first message that an open piece still has.
  struct Head {
    std::uint64_t time;
    std::size_t piece;  ///< pieces are in order of time, then of place
    bool operator>(const Head& other) const { return time != other.time ? time > other.time : piece > other.piece; }
  };

  [[noreturn]] void refuse(std::uint64_t offset, const std::string& what) const;
  bool read_summary();
  void read_all_records();
  void walk(std::uint64_t from, std::uint64_t to, bool chunks_too);
  void describe(Opcode opcode, std::string_view content);
  void add_piece(Piece piece);
  void add_loose(std::uint64_t offset, std::uint64_t length, std::uint64_t time);
  std::string chunk_records(const Piece& piece) const;
  /// Calls `each(opcode, content, offset)` for the records of a chunk or a run.
  template <typename Each>
  void for_each_record(const std::string& records, std::uint64_t place, const Each& each) const;
  void open_piece(std::size_t number);
  void find_order();

  const std::string path_;
  const Limits limits_;
  std::unique_ptr<File> file_;
  std::uint64_t size_ = 0;
  Header header_;
  std::map<std::uint16_t, Schema> schemas_;
  std::map<std::uint16_t, Channel> channels_;
  std::uint64_t described_ = 0;  ///< bytes of descriptions
  std::vector<Metadata> metadata_;
  Statistics statistics_;
  std::map<std::uint16_t, std::uint64_t> counted_;  ///< messages by channel, when there is no summary
  std::set<std::string> compressions_;
  std::string problem_;
  std::uint64_t data_end_ = 0;             ///< offset of the DataEnd record; 0: there is none
  std::optional<std::uint32_t> data_crc_;  ///< what it says
  std::vector<Piece> pieces_;              ///< in order of start time, then of place

  std::size_t unopened_ = 0;  ///< the first of pieces_ that was not opened yet
  std::map<std::size_t, Open> open_;
  std::uint64_t open_bytes_ = 0;
  std::priority_queue<Head, std::vector<Head>, std::greater<>> heads_;
  std::optional<std::size_t> current_;  ///< the piece whose message next() gave last
};

}  // namespace iotcloud::recording::mcap

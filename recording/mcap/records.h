#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

/// The records of MCAP, a public format for recordings (https://mcap.dev/spec), version 0: little endian, each record
/// an opcode, the length of its content in 8 bytes, and the content.
namespace iotcloud::recording::mcap {

inline constexpr std::string_view magic{"\x89MCAP0\r\n", 8};

/// What kind of record it is.
enum class Opcode : std::uint8_t {
  header = 0x01,
  footer = 0x02,
  schema = 0x03,
  channel = 0x04,
  message = 0x05,
  chunk = 0x06,
  message_index = 0x07,
  chunk_index = 0x08,
  attachment = 0x09,
  attachment_index = 0x0A,
  statistics = 0x0B,
  metadata = 0x0C,
  metadata_index = 0x0D,
  summary_offset = 0x0E,
  data_end = 0x0F,
};

/// What stands before a record's content: the opcode, and the content's length.
inline constexpr std::uint64_t head_size = 9;
/// The whole footer record.
inline constexpr std::uint64_t footer_size = head_size + 8 + 8 + 4;

/// Texts by name, in their order. A name may stand twice in a hostile file.
using Map = std::vector<std::pair<std::string, std::string>>;
/// The value of a key; empty: there is none.
std::string_view value_of(const Map& map, std::string_view key);

/// How the file was made.
struct Header {
  std::string profile, library;
};
/// Where the summary is, and its checksum.
struct Footer {
  std::uint64_t summary_start = 0, summary_offset_start = 0;
  std::uint32_t summary_crc = 0;
};
/// What the messages of channels look like; its encoding says in which language.
struct Schema {
  std::uint16_t id = 0;
  std::string name, encoding, data;
};
/// What messages have in common.
struct Channel {
  std::uint16_t id = 0;
  std::uint16_t schema = 0;  ///< 0: none
  std::string topic, message_encoding;
  Map metadata{};
};
/// One message.
struct Message {
  std::uint16_t channel = 0;
  std::uint32_t sequence = 0;
  std::uint64_t log_time = 0, publish_time = 0;  ///< nanoseconds since 1970 UTC
  std::string_view data{};                       ///< lies in the bytes that were decoded
};
/// A chunk's head; `records` lie behind it, compressed.
struct Chunk {
  std::uint64_t start_time = 0, end_time = 0;
  std::uint64_t uncompressed_size = 0;
  std::uint32_t uncompressed_crc = 0;  ///< 0: none
  std::string compression;             ///< "", "lz4" or "zstd"
  std::string_view records{};
};
/// What the summary says of a chunk.
struct ChunkIndex {
  std::uint64_t start_time = 0, end_time = 0;
  std::uint64_t offset = 0, length = 0;  ///< of the chunk's record
  std::vector<std::pair<std::uint16_t, std::uint64_t>> message_indexes{};
  std::uint64_t message_index_length = 0;
  std::string compression{};
  std::uint64_t compressed_size = 0, uncompressed_size = 0;
};
/// Counts of the whole file.
struct Statistics {
  std::uint64_t messages = 0;
  std::uint16_t schemas = 0;
  std::uint32_t channels = 0, attachments = 0, metadata = 0, chunks = 0;
  std::uint64_t start_time = 0, end_time = 0;
  std::vector<std::pair<std::uint16_t, std::uint64_t>> channel_messages{};
};
/// Texts about the file, under a name.
struct Metadata {
  std::string name;
  Map entries{};
};

/// Reads the content of one record. \throws RecordingError when it ends too early.
class Content {
 public:
  explicit Content(std::string_view bytes) : rest_(bytes) {}
  std::uint8_t u8() { return static_cast<std::uint8_t>(number(1)); }
  std::uint16_t u16() { return static_cast<std::uint16_t>(number(2)); }
  std::uint32_t u32() { return static_cast<std::uint32_t>(number(4)); }
  std::uint64_t u64() { return number(8); }
  std::string_view bytes(std::uint64_t count);
  std::string_view text() { return bytes(u32()); }
  Map map();
  std::string_view rest() const { return rest_; }

 private:
  std::uint64_t number(std::size_t bytes);
  std::string_view rest_;
};

/// Reads a record's content, as the others below. \throws RecordingError when it is too short for what it says.
Header read_header(std::string_view content);
/// Reads a footer.
Footer read_footer(std::string_view content);
/// Reads a schema.
Schema read_schema(std::string_view content);
/// Reads a channel.
Channel read_channel(std::string_view content);
/// Reads a message; its data lie in `content`.
Message read_message(std::string_view content);
/// Reads a chunk. \param records false: the content may end behind the head, and `records` stays empty.
Chunk read_chunk(std::string_view content, bool records = true);
/// Reads what the summary says of a chunk.
ChunkIndex read_chunk_index(std::string_view content);
/// Reads the counts.
Statistics read_statistics(std::string_view content);
/// Reads metadata.
Metadata read_metadata(std::string_view content);

/// Appends a whole record, as the others below.
void append(std::string& out, const Header& header);
/// Appends a footer.
void append(std::string& out, const Footer& footer);
/// Appends a schema.
void append(std::string& out, const Schema& schema);
/// Appends a channel.
void append(std::string& out, const Channel& channel);
/// Appends a message.
void append(std::string& out, const Message& message);
/// Appends a chunk.
void append(std::string& out, const Chunk& chunk);
/// Appends what the summary says of a chunk.
void append(std::string& out, const ChunkIndex& index);
/// Appends the counts.
void append(std::string& out, const Statistics& statistics);
/// Appends metadata.
void append(std::string& out, const Metadata& metadata);
/// Appends where a channel's messages are in the chunk before. \param entries log time of each, and its offset in the
/// uncompressed chunk.
void append_message_index(std::string& out, std::uint16_t channel,
                          const std::vector<std::pair<std::uint64_t, std::uint64_t>>& entries);
/// Appends where metadata are.
void append_metadata_index(std::string& out, std::uint64_t offset, std::uint64_t length, std::string_view name);
/// Appends where the summary's records of a kind are.
void append_summary_offset(std::string& out, Opcode group, std::uint64_t start, std::uint64_t length);
/// Appends the end of the data. \param crc of all bytes before it
void append_data_end(std::string& out, std::uint32_t crc);

/// A map as records have it: also what the data of a channel of properties are (docs/wire.md#recordings).
void append(std::string& out, const Map& map);

/// Continues a checksum (CRC-32, as zip files have it). It begins with 0.
std::uint32_t crc32(std::uint32_t before, std::string_view bytes);

}  // namespace iotcloud::recording::mcap

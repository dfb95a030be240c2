#include <limits>

#include <zlib.h>

#include <iotcloud/recording/error.h>
#include <iotcloud/recording/mcap/records.h>

namespace iotcloud::recording::mcap {

namespace {

template <typename Number>
void put(std::string& out, Number number) {
  for (std::size_t i = 0; i < sizeof number; ++i)
    out.push_back(static_cast<char>(static_cast<std::uint64_t>(number) >> (8 * i) & 0xFFU));
}
void put_text(std::string& out, std::string_view text) {
  put(out, static_cast<std::uint32_t>(text.size()));
  out.append(text);
}

/// Writes a record's head, and at the end of its life the content's length into it.
class Record {
 public:
  Record(std::string& out, Opcode opcode) : out_(out) {
    put(out_, static_cast<std::uint8_t>(opcode));
    put(out_, std::uint64_t{0});
    begin_ = out_.size();
  }
  ~Record() {
    const std::uint64_t length = out_.size() - begin_;
    for (std::size_t i = 0; i < sizeof length; ++i)
      out_[begin_ - sizeof length + i] = static_cast<char>(length >> (8 * i) & 0xFFU);
  }
  Record(const Record&) = delete;
  Record& operator=(const Record&) = delete;

 private:
  std::string& out_;
  std::size_t begin_ = 0;
};

}  // namespace

std::string_view value_of(const Map& map, std::string_view key) {
  for (const auto& [name, value] : map) {
    if (name == key) return value;
  }
  return {};
}

std::uint64_t Content::number(std::size_t bytes) {
  const std::string_view taken = this->bytes(bytes);
  std::uint64_t value = 0;
  for (std::size_t i = 0; i < bytes; ++i)
    value |= static_cast<std::uint64_t>(static_cast<unsigned char>(taken[i])) << (8 * i);
  return value;
}

std::string_view Content::bytes(std::uint64_t count) {
  if (count > rest_.size())
    throw RecordingError("a record ends " + std::to_string(count - rest_.size()) + " bytes before a field's end");
  const std::string_view taken = rest_.substr(0, static_cast<std::size_t>(count));
  rest_.remove_prefix(static_cast<std::size_t>(count));
  return taken;
}

Map Content::map() {
  Content inner(bytes(u32()));
  Map map;
  while (!inner.rest().empty()) {
    const std::string_view key = inner.text();
    map.emplace_back(key, inner.text());
  }
  return map;
}

Header read_header(std::string_view content) {
  Content in(content);
  Header header;
  header.profile = in.text();
  header.library = in.text();
  return header;
}

Footer read_footer(std::string_view content) {
  Content in(content);
  Footer footer;
  footer.summary_start = in.u64();
  footer.summary_offset_start = in.u64();
  footer.summary_crc = in.u32();
  return footer;
}

Schema read_schema(std::string_view content) {
  Content in(content);
  Schema schema;
  schema.id = in.u16();
  schema.name = in.text();
  schema.encoding = in.text();
  schema.data = in.text();
  return schema;
}

Channel read_channel(std::string_view content) {
  Content in(content);
  Channel channel;
  channel.id = in.u16();
  channel.schema = in.u16();
  channel.topic = in.text();
  channel.message_encoding = in.text();
  channel.metadata = in.map();
  return channel;
}

Message read_message(std::string_view content) {
  Content in(content);
  Message message;
  message.channel = in.u16();
  message.sequence = in.u32();
  message.log_time = in.u64();
  message.publish_time = in.u64();
  message.data = in.rest();
  return message;
}

Chunk read_chunk(std::string_view content, bool records) {
  Content in(content);
  Chunk chunk;
  chunk.start_time = in.u64();
  chunk.end_time = in.u64();
  chunk.uncompressed_size = in.u64();
  chunk.uncompressed_crc = in.u32();
  chunk.compression = in.text();
  const std::uint64_t length = in.u64();
  if (records) chunk.records = in.bytes(length);
  return chunk;
}

ChunkIndex read_chunk_index(std::string_view content) {
  Content in(content);
  ChunkIndex index;
  index.start_time = in.u64();
  index.end_time = in.u64();
  index.offset = in.u64();
  index.length = in.u64();
  Content offsets(in.bytes(in.u32()));
  while (!offsets.rest().empty()) {
    const std::uint16_t channel = offsets.u16();
    index.message_indexes.emplace_back(channel, offsets.u64());
  }
  index.message_index_length = in.u64();
  index.compression = in.text();
  index.compressed_size = in.u64();
  index.uncompressed_size = in.u64();
  return index;
}

Statistics read_statistics(std::string_view content) {
  Content in(content);
  Statistics statistics;
  statistics.messages = in.u64();
  statistics.schemas = in.u16();
  statistics.channels = in.u32();
  statistics.attachments = in.u32();
  statistics.metadata = in.u32();
  statistics.chunks = in.u32();
  statistics.start_time = in.u64();
  statistics.end_time = in.u64();
  Content counts(in.bytes(in.u32()));
  while (!counts.rest().empty()) {
    const std::uint16_t channel = counts.u16();
    statistics.channel_messages.emplace_back(channel, counts.u64());
  }
  return statistics;
}

Metadata read_metadata(std::string_view content) {
  Content in(content);
  Metadata metadata;
  metadata.name = in.text();
  metadata.entries = in.map();
  return metadata;
}

void append(std::string& out, const Map& map) {
  std::uint64_t size = 0;
  for (const auto& [key, value] : map) size += 8 + key.size() + value.size();
  if (size > std::numeric_limits<std::uint32_t>::max()) throw RecordingError("texts of more than 4 GiB in one record");
  put(out, static_cast<std::uint32_t>(size));
  for (const auto& [key, value] : map) {
    put_text(out, key);
    put_text(out, value);
  }
}

void append(std::string& out, const Header& header) {
  const Record record(out, Opcode::header);
  put_text(out, header.profile);
  put_text(out, header.library);
}

void append(std::string& out, const Footer& footer) {
  const Record record(out, Opcode::footer);
  put(out, footer.summary_start);
  put(out, footer.summary_offset_start);
  put(out, footer.summary_crc);
}

void append(std::string& out, const Schema& schema) {
  const Record record(out, Opcode::schema);
  put(out, schema.id);
  put_text(out, schema.name);
  put_text(out, schema.encoding);
  put_text(out, schema.data);
}

void append(std::string& out, const Channel& channel) {
  const Record record(out, Opcode::channel);
  put(out, channel.id);
  put(out, channel.schema);
  put_text(out, channel.topic);
  put_text(out, channel.message_encoding);
  append(out, channel.metadata);
}

void append(std::string& out, const Message& message) {
  const Record record(out, Opcode::message);
  put(out, message.channel);
  put(out, message.sequence);
  put(out, message.log_time);
  put(out, message.publish_time);
  out.append(message.data);
}

void append(std::string& out, const Chunk& chunk) {
  const Record record(out, Opcode::chunk);
  put(out, chunk.start_time);
  put(out, chunk.end_time);
  put(out, chunk.uncompressed_size);
  put(out, chunk.uncompressed_crc);
  put_text(out, chunk.compression);
  put(out, static_cast<std::uint64_t>(chunk.records.size()));
  out.append(chunk.records);
}

void append(std::string& out, const ChunkIndex& index) {
  const Record record(out, Opcode::chunk_index);
  put(out, index.start_time);
  put(out, index.end_time);
  put(out, index.offset);
  put(out, index.length);
  put(out, static_cast<std::uint32_t>(index.message_indexes.size() * 10));
  for (const auto& [channel, offset] : index.message_indexes) {
    put(out, channel);
    put(out, offset);
  }
  put(out, index.message_index_length);
  put_text(out, index.compression);
  put(out, index.compressed_size);
  put(out, index.uncompressed_size);
}

void append(std::string& out, const Statistics& statistics) {
  const Record record(out, Opcode::statistics);
  put(out, statistics.messages);
  put(out, statistics.schemas);
  put(out, statistics.channels);
  put(out, statistics.attachments);
  put(out, statistics.metadata);
  put(out, statistics.chunks);
  put(out, statistics.start_time);
  put(out, statistics.end_time);
  put(out, static_cast<std::uint32_t>(statistics.channel_messages.size() * 10));
  for (const auto& [channel, count] : statistics.channel_messages) {
    put(out, channel);
    put(out, count);
  }
}

void append(std::string& out, const Metadata& metadata) {
  const Record record(out, Opcode::metadata);
  put_text(out, metadata.name);
  append(out, metadata.entries);
}

void append_message_index(std::string& out, std::uint16_t channel,
                          const std::vector<std::pair<std::uint64_t, std::uint64_t>>& entries) {
  const Record record(out, Opcode::message_index);
  put(out, channel);
  put(out, static_cast<std::uint32_t>(entries.size() * 16));
  for (const auto& [time, offset] : entries) {
    put(out, time);
    put(out, offset);
  }
}

void append_metadata_index(std::string& out, std::uint64_t offset, std::uint64_t length, std::string_view name) {
  const Record record(out, Opcode::metadata_index);
  put(out, offset);
  put(out, length);
  put_text(out, name);
}

void append_summary_offset(std::string& out, Opcode group, std::uint64_t start, std::uint64_t length) {
  const Record record(out, Opcode::summary_offset);
  put(out, static_cast<std::uint8_t>(group));
  put(out, start);
  put(out, length);
}

void append_data_end(std::string& out, std::uint32_t crc) {
  const Record record(out, Opcode::data_end);
  put(out, crc);
}

std::uint32_t crc32(std::uint32_t before, std::string_view bytes) {
  return static_cast<std::uint32_t>(crc32_z(before, reinterpret_cast<const Bytef*>(bytes.data()), bytes.size()));
}

}  // namespace iotcloud::recording::mcap

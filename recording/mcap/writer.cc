#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <limits>
#include <memory>

#include <fcntl.h>
#include <unistd.h>

#include <iotcloud/recording/error.h>
#include <iotcloud/recording/mcap/writer.h>

namespace iotcloud::recording::mcap {

namespace {

/// Descriptions of all channels together: they stay in memory until the summary is written.
constexpr std::size_t most_descriptions = 64 << 20;

std::string folder_of(const std::string& path) {
  const auto slash = path.rfind('/');
  return slash == std::string::npos ? "." : slash == 0 ? "/" : path.substr(0, slash);
}

/// A file that nobody else finds, which is gone with the process.
int open_nameless(const std::string& folder) {
  const int file = open(folder.c_str(), O_TMPFILE | O_RDWR | O_CLOEXEC, 0600);
  if (file >= 0) return file;
  std::string name = folder + "/.recording-XXXXXX";  // a file system without O_TMPFILE
  const int named = mkostemp(name.data(), O_CLOEXEC);
  if (named >= 0) unlink(name.c_str());
  return named;
}

/// \return whether all bytes were written at that place; errno says why not.
bool write_all(int file, std::string_view bytes, std::uint64_t at) {
  while (!bytes.empty()) {
    const ssize_t done = ::pwrite(file, bytes.data(), bytes.size(), static_cast<off_t>(at));
    if (done < 0 && errno == EINTR) continue;
    if (done < 0) return false;
    bytes.remove_prefix(static_cast<std::size_t>(done));
    at += static_cast<std::uint64_t>(done);
  }
  return true;
}

}  // namespace

Writer::Writer(std::string path, Options options) : path_(std::move(path)), options_(std::move(options)) {
  file_ = open(path_.c_str(), O_WRONLY | O_CREAT | O_EXCL | O_CLOEXEC, 0666);
  if (file_ < 0 && errno == EEXIST) throw RecordingError(path_ + " is there already: name another file, or remove it");
  if (file_ < 0) fail("cannot be made");
  spill_ = open_nameless(folder_of(path_));
  if (spill_ < 0) {
    const int why = errno;
    ::close(std::exchange(file_, -1));
    unlink(path_.c_str());
    errno = why;
    fail("no file for its index can be made beside it");
  }
  std::string head(magic);
  append(head, Header{options_.profile, options_.library});
  try {
    write(head);
  } catch (const RecordingError&) {
    ::close(file_);
    ::close(spill_);
    throw;
  }
}

Writer::~Writer() {
  if (file_ >= 0) ::close(file_);
  if (spill_ >= 0) ::close(spill_);
}

void Writer::fail(const std::string& what) const {
  throw RecordingError(path_ + " " + what + ": " + std::strerror(errno));
}

/// Appends to the file. What could not be written whole is cut off again, so that the file ends with a whole record.
void Writer::write(std::string_view bytes) {
  if (file_ < 0) throw RecordingError(path_ + " is closed");
  if (!write_all(file_, bytes, written_)) {
    const int why = errno;
    const bool cut = ftruncate(file_, static_cast<off_t>(written_)) == 0;
    errno = why;
    fail(cut ? "cannot be written; what it has can be read" : "cannot be written; its last record may be unfinished");
  }
  written_ += bytes.size();
  crc_ = crc32(crc_, bytes);
}

std::uint16_t Writer::add_schema(std::string_view name, std::string_view encoding, std::string_view data) {
  if (statistics_.schemas == std::numeric_limits<std::uint16_t>::max())
    throw RecordingError(path_ + " has 65535 schemas, and no room for another one");
  std::string record;
  const auto id = static_cast<std::uint16_t>(statistics_.schemas + 1);
  append(record, Schema{id, std::string(name), std::string(encoding), std::string(data)});
  write(record);
  schemas_ += record;
  ++statistics_.schemas;
  return id;
}

std::uint16_t Writer::add_channel(std::uint16_t schema, std::string_view topic, std::string_view message_encoding,
                                  Map metadata) {
  if (statistics_.channels > std::numeric_limits<std::uint16_t>::max())
    throw RecordingError(path_ + " has 65536 channels, and no room for another one");
  std::string record;
  const auto id = static_cast<std::uint16_t>(statistics_.channels);
  append(record, Channel{id, schema, std::string(topic), std::string(message_encoding), std::move(metadata)});
  if (channels_.size() + record.size() > most_descriptions)
    throw RecordingError(path_ + " has 64 MiB of descriptions of channels, and no room for another one");
  write(record);
  channels_ += record;
  counts_.push_back(0);
  ++statistics_.channels;
  return id;
}

void Writer::add(const Message& message) {
  if (file_ < 0) throw RecordingError(path_ + " is closed");
  if (message.channel >= counts_.size())
    throw RecordingError(path_ + " has no channel " + std::to_string(message.channel));
  const bool first = records_.empty();
  entries_[message.channel].emplace_back(message.log_time, records_.size());
  append(records_, message);
  start_time_ = first ? message.log_time : std::min(start_time_, message.log_time);
  end_time_ = first ? message.log_time : std::max(end_time_, message.log_time);
}

void Writer::add(const Metadata& metadata) {
  flush(true);
  std::string record;
  append(record, metadata);
  append_metadata_index(metadata_indexes_, written_, record.size(), metadata.name);
  write(record);
  ++statistics_.metadata;
}

void Writer::flush(bool whatever_it_has) {
  if (records_.empty() || (!whatever_it_has && records_.size() < options_.chunk_bytes)) return;
  write_chunk();
}

/// Writes the chunk and its message indexes with one call, and what the summary will say of them.
void Writer::write_chunk() {
  const std::string compressed = compress(options_.compression, records_);
  ChunkIndex index;
  index.start_time = start_time_;
  index.end_time = end_time_;
  index.offset = written_;
  index.compression = word_of(options_.compression);
  index.compressed_size = compressed.size();
  index.uncompressed_size = records_.size();
  std::string out;
  append(out, Chunk{start_time_, end_time_, records_.size(), crc32(0, records_), index.compression, compressed});
  index.length = out.size();
  std::uint64_t messages = 0;
  for (const auto& [channel, entries] : entries_) {
    index.message_indexes.emplace_back(channel, written_ + out.size());
    append_message_index(out, channel, entries);
    messages += entries.size();
  }
  index.message_index_length = out.size() - index.length;
  std::string spilled;
  append(spilled, index);
  // First, and counted last: a chunk that cannot be written whole may be tried again.
  if (!write_all(spill_, spilled, spilled_)) fail("cannot keep the index of its chunks");
  write(out);
  spilled_ += spilled.size();
  for (const auto& [channel, entries] : entries_) counts_[channel] += entries.size();
  const bool first = statistics_.messages == 0;
  statistics_.start_time = first ? start_time_ : std::min(statistics_.start_time, start_time_);
  statistics_.end_time = first ? end_time_ : std::max(statistics_.end_time, end_time_);
  statistics_.messages += messages;
  ++statistics_.chunks;
  records_.clear();
  entries_.clear();
}

void Writer::close() {
  flush(true);
  std::string end;
  append_data_end(end, crc_);
  write(end);
  const std::uint64_t summary = written_;
  std::uint32_t crc = 0;
  std::string offsets;
  const auto put = [&](std::string_view bytes) {
    write(bytes);
    crc = crc32(crc, bytes);
  };
  const auto put_group = [&](Opcode opcode, std::string_view records) {
    if (records.empty()) return;
    append_summary_offset(offsets, opcode, written_, records.size());
    put(records);
  };
  put_group(Opcode::schema, schemas_);
  put_group(Opcode::channel, channels_);
  statistics_.channel_messages.clear();
  for (std::size_t i = 0; i < counts_.size(); ++i) {
    if (counts_[i] > 0) statistics_.channel_messages.emplace_back(static_cast<std::uint16_t>(i), counts_[i]);
  }
  std::string statistics;
  append(statistics, statistics_);
  put_group(Opcode::statistics, statistics);
  if (spilled_ > 0) append_summary_offset(offsets, Opcode::chunk_index, written_, spilled_);
  std::array<char, 64 << 10> buffer{};
  for (std::uint64_t at = 0; at < spilled_;) {
    const ssize_t got = pread(spill_, buffer.data(), buffer.size(), static_cast<off_t>(at));
    if (got < 0 && errno == EINTR) continue;
    if (got <= 0) fail("has lost the index of its chunks");
    put({buffer.data(), static_cast<std::size_t>(got)});
    at += static_cast<std::uint64_t>(got);
  }
  put_group(Opcode::metadata_index, metadata_indexes_);
  const std::uint64_t summary_offsets = written_;
  put(offsets);
  std::string footer;
  append(footer, Footer{summary, summary_offsets, 0});
  // The checksum covers the footer, too, but for itself.
  crc = crc32(crc, std::string_view(footer).substr(0, footer.size() - 4));
  footer.clear();
  append(footer, Footer{summary, summary_offsets, crc});
  footer += magic;
  write(footer);
  if (fsync(file_) != 0 && errno != EINVAL && errno != EROFS) fail("cannot be synced");
  if (::close(std::exchange(file_, -1)) != 0) fail("cannot be closed");
}

}  // namespace iotcloud::recording::mcap

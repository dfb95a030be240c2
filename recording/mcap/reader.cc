#include <algorithm>
#include <cerrno>
#include <cstring>
#include <limits>
#include <tuple>

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <iotcloud/recording/error.h>
#include <iotcloud/recording/mcap/compression.h>
#include <iotcloud/recording/mcap/reader.h>

namespace iotcloud::recording::mcap {

namespace {

constexpr std::size_t longest_compression = 32;  ///< of the word for it
/// A record of a chunk's head takes at most so much: its fields, and the longest word for a compression.
constexpr std::uint64_t chunk_head = 8 + 8 + 8 + 4 + 4 + longest_compression + 8;
/// Messages outside of chunks are read in runs of about so many bytes.
constexpr std::uint64_t run_bytes = 4 << 20;

struct RecordHead {
  Opcode opcode;
  std::uint64_t length;  ///< of the content
};

}  // namespace

/// The file, read at any place through a window.
class Reader::File {
 public:
  explicit File(const std::string& path) : path_(path), descriptor_(open(path.c_str(), O_RDONLY | O_CLOEXEC)) {
    struct stat about {};
    if (descriptor_ < 0 || fstat(descriptor_, &about) != 0 || !S_ISREG(about.st_mode)) {
      const std::string why = descriptor_ < 0 ? std::strerror(errno) : "it is no file";
      if (descriptor_ >= 0) close(descriptor_);
      throw RecordingError(path + " cannot be read: " + why);
    }
    size_ = static_cast<std::uint64_t>(about.st_size);
  }
  ~File() { close(descriptor_); }
  File(const File&) = delete;
  File& operator=(const File&) = delete;

  std::uint64_t size() const { return size_; }

  /// \pre offset + length <= size(). \throws RecordingError when the file became shorter.
  std::string read(std::uint64_t offset, std::uint64_t length) const {
    std::string bytes(static_cast<std::size_t>(length), '\0');
    fill(offset, bytes.data(), bytes.size());
    return bytes;
  }

  /// The head of the record at `offset`; nullopt: the file ends within it or before the record's end.
  std::optional<RecordHead> head(std::uint64_t offset, std::uint64_t end) {
    if (offset > end || end - offset < head_size) return std::nullopt;
    Content content(window(offset, head_size));
    const auto opcode = static_cast<Opcode>(content.u8());
    const std::uint64_t length = content.u64();
    if (length > end - offset - head_size) return std::nullopt;
    return RecordHead{opcode, length};
  }

  /// A view that is valid until the next call. \pre as read(), and length is at most that of the window.
  std::string_view window(std::uint64_t offset, std::uint64_t length) {
    if (offset < window_at_ || offset + length > window_at_ + window_.size()) {
      window_.resize(static_cast<std::size_t>(std::min<std::uint64_t>(window_size, size_ - offset)));
      fill(offset, window_.data(), window_.size());
      window_at_ = offset;
    }
    return std::string_view(window_).substr(static_cast<std::size_t>(offset - window_at_),
                                            static_cast<std::size_t>(length));
  }

 private:
  static constexpr std::uint64_t window_size = 16 << 10;

  void fill(std::uint64_t offset, char* to, std::size_t length) const {
    while (length > 0) {
      const ssize_t got = pread(descriptor_, to, length, static_cast<off_t>(offset));
      if (got < 0 && errno == EINTR) continue;
      if (got <= 0) throw RecordingError(path_ + " became shorter while it was read");
      to += got;
      offset += static_cast<std::uint64_t>(got);
      length -= static_cast<std::size_t>(got);
    }
  }

  const std::string path_;
  const int descriptor_;
  std::uint64_t size_ = 0;
  std::string window_;
  std::uint64_t window_at_ = 0;
};

Reader::Reader(std::string path, Limits limits)
    : path_(std::move(path)), limits_(limits), file_(std::make_unique<File>(path_)), size_(file_->size()) {
  if (size_ < magic.size() || file_->read(0, magic.size()) != magic)
    throw RecordingError(path_ + " is no MCAP file: it does not begin as one");
  const auto head = file_->head(magic.size(), size_);
  if (!head || head->opcode != Opcode::header || head->length > limits_.descriptions)
    throw RecordingError(path_ + " is no MCAP file, or nothing was recorded: it has no whole header");
  header_ = read_header(file_->read(magic.size() + head_size, head->length));
  if (!read_summary()) read_all_records();
  find_order();
}

Reader::~Reader() = default;

void Reader::refuse(std::uint64_t offset, const std::string& what) const {
  throw RecordingError(path_ + ", at byte " + std::to_string(offset) + ": " + what);
}

/// Takes over a schema, a channel or metadata.
void Reader::describe(Opcode opcode, std::string_view content) {
  described_ += content.size();
  if (described_ > limits_.descriptions)
    throw RecordingError(path_ + " has more than " + std::to_string(limits_.descriptions >> 20) +
                         " MiB of descriptions of channels");
  if (opcode == Opcode::schema) {
    auto schema = read_schema(content);
    if (schema.id != 0) schemas_.insert_or_assign(schema.id, std::move(schema));
  } else if (opcode == Opcode::channel) {
    auto channel = read_channel(content);
    channels_.insert_or_assign(channel.id, std::move(channel));
  } else if (opcode == Opcode::metadata) {
    metadata_.push_back(read_metadata(content));
  }
}

/// \return false: there is no summary that can be used; everything is as it was, but for `problem_`.
bool Reader::read_summary() {
  const std::uint64_t least = magic.size() + footer_size + magic.size();
  if (size_ < least + head_size) {
    problem_ = "it has no end: its writer was killed, or it is being written";
    return false;
  }
  const std::uint64_t footer_at = size_ - magic.size() - footer_size;
  const auto head = file_->head(footer_at, size_ - magic.size());
  if (file_->read(size_ - magic.size(), magic.size()) != magic || !head || head->opcode != Opcode::footer ||
      head->length != footer_size - head_size) {
    problem_ = "it has no end: its writer was killed, or it is being written";
    return false;
  }
  const Footer footer = read_footer(file_->read(footer_at + head_size, head->length));
  if (footer.summary_start == 0) return false;  // its writer makes none
  try {
    if (footer.summary_start < magic.size() || footer.summary_start > footer_at)
      throw RecordingError("its footer points to no summary");
    std::uint32_t crc = 0;
    bool statistics = false;
    constexpr std::uint64_t step = 1 << 20;
    if (footer.summary_crc != 0) {
      const std::uint64_t end = footer_at + footer_size - 4;
      for (std::uint64_t at = footer.summary_start; at < end; at += step)
        crc = crc32(crc, file_->read(at, std::min(step, end - at)));
      if (crc != footer.summary_crc) throw RecordingError("its summary is damaged: the checksum is wrong");
    }
    for (std::uint64_t at = footer.summary_start; at < footer_at;) {
      const auto record = file_->head(at, footer_at);
      if (!record) throw RecordingError("its summary is damaged");
      const auto content = [&] {
        if (record->length > limits_.descriptions) throw RecordingError("a record of its summary is too long");
        return file_->read(at + head_size, record->length);
      };
      switch (record->opcode) {
        case Opcode::schema:
        case Opcode::channel:
          describe(record->opcode, content());
          break;
        case Opcode::statistics:
          statistics_ = read_statistics(content());
          statistics = true;
          break;
        case Opcode::chunk_index: {
          auto index = read_chunk_index(content());
          if (index.length < head_size || index.offset < magic.size() || index.offset > footer.summary_start ||
              index.length > footer.summary_start - index.offset)
            throw RecordingError("its summary names a chunk that is not in the file");
          if (index.compression.size() > longest_compression)
            throw RecordingError("its summary names no compression that can be read");
          compressions_.insert(index.compression);
          add_piece({index.start_time, index.end_time, index.offset, index.length, true});
          break;
        }
        default:
          break;
      }
      at += head_size + record->length;
    }
    if (!statistics || statistics_.chunks != pieces_.size() || statistics_.channels != channels_.size())
      throw RecordingError("its summary leaves things out");
    // Between the chunks: metadata, and messages outside of chunks.
    std::sort(pieces_.begin(), pieces_.end(), [](const Piece& a, const Piece& b) { return a.offset < b.offset; });
    const auto chunks = pieces_;
    std::uint64_t at = magic.size();
    for (const auto& chunk : chunks) {
      if (chunk.offset < at) throw RecordingError("its summary has chunks within each other");
      walk(at, chunk.offset, false);
      at = chunk.offset + chunk.length;
    }
    walk(at, footer.summary_start, false);
    if (data_end_ == 0) throw RecordingError("its data have no end");
    problem_.clear();
    return true;
  } catch (const RecordingError& error) {
    const std::string problem = error.what();
    if (problem.starts_with(path_)) throw;  // a limit
    problem_ = problem + "; all records were read instead";
  }
  schemas_.clear();
  channels_.clear();
  metadata_.clear();
  pieces_.clear();
  compressions_.clear();
  statistics_ = {};
  described_ = 0;
  data_end_ = 0;
  data_crc_.reset();
  return false;
}

void Reader::add_piece(Piece piece) {
  if (pieces_.size() >= limits_.chunks)
    throw RecordingError(path_ + " has more than " + std::to_string(limits_.chunks) + " chunks");
  pieces_.push_back(piece);
}

/// A message outside of chunks: it joins the run before it if that ends here.
void Reader::add_loose(std::uint64_t offset, std::uint64_t length, std::uint64_t time) {
  if (!pieces_.empty()) {
    Piece& last = pieces_.back();
    if (!last.chunk && last.offset + last.length == offset && last.length < run_bytes) {
      last.length += length;
      last.start_time = std::min(last.start_time, time);
      last.end_time = std::max(last.end_time, time);
      return;
    }
  }
  if (length > limits_.chunk) refuse(offset, "a message is too long");
  add_piece({time, time, offset, length, false});
}

/// Goes through the records from one offset to another, up to the first that is not whole.
/// \param chunks_too reads the chunks: there is no summary. False: it passes them over.
void Reader::walk(std::uint64_t from, std::uint64_t to, bool chunks_too) {
  std::uint64_t at = from;
  while (at < to) {
    const auto record = file_->head(at, to);
    if (!record) {
      if (!chunks_too) throw RecordingError("its records do not fit its summary");
      if (problem_.empty()) problem_ = "it has no end";
      problem_ += "; " + std::to_string(to - at) + " bytes of an unfinished record at its end are passed over";
      return;
    }
    const auto content = [&] {
      if (record->length > limits_.descriptions) refuse(at, "a record is too long");
      return file_->read(at + head_size, record->length);
    };
    const std::uint64_t whole = head_size + record->length;
    switch (record->opcode) {
      case Opcode::schema:
      case Opcode::channel:
      case Opcode::metadata:
        if (chunks_too || record->opcode == Opcode::metadata) describe(record->opcode, content());
        if (chunks_too && record->opcode == Opcode::metadata) ++statistics_.metadata;
        break;
      case Opcode::attachment:
        if (chunks_too) ++statistics_.attachments;
        break;
      case Opcode::message: {
        constexpr std::uint64_t message_head = 2 + 4 + 8 + 8;
        if (record->length < message_head) refuse(at, "a message is too short");
        const auto message = read_message(file_->window(at + head_size, message_head));
        add_loose(at, whole, message.log_time);
        if (chunks_too) ++counted_[message.channel];
        break;
      }
      case Opcode::chunk: {
        if (!chunks_too) throw RecordingError("its summary leaves a chunk out");
        Piece piece{0, 0, at, whole, true};
        try {
          bool first = true;
          std::map<std::uint16_t, std::uint64_t> counted;
          for_each_record(chunk_records(piece), at, [&](Opcode opcode, std::string_view inner, std::uint64_t) {
            if (opcode == Opcode::schema || opcode == Opcode::channel) describe(opcode, inner);
            if (opcode != Opcode::message) return;
            const auto message = read_message(inner);
            piece.start_time = first ? message.log_time : std::min(piece.start_time, message.log_time);
            piece.end_time = first ? message.log_time : std::max(piece.end_time, message.log_time);
            first = false;
            ++counted[message.channel];
          });
          add_piece(piece);
          for (const auto& [channel, count] : counted) counted_[channel] += count;
          const auto head = file_->read(at + head_size, std::min(record->length, chunk_head));
          compressions_.insert(read_chunk(head, false).compression);
          ++statistics_.chunks;
        } catch (const RecordingError& error) {
          problem_ += (problem_.empty() ? "" : "; ") + std::string("a chunk is left out: ") + error.what();
        }
        break;
      }
      case Opcode::data_end:
        data_end_ = at;
        if (record->length >= 4) data_crc_ = Content(file_->window(at + head_size, 4)).u32();
        return;
      default:
        break;
    }
    at += whole;
  }
}

void Reader::read_all_records() {
  walk(magic.size(), size_, true);
  for (const auto& [channel, count] : counted_) {
    statistics_.channel_messages.emplace_back(channel, count);
    statistics_.messages += count;
  }
  statistics_.channels = static_cast<std::uint32_t>(channels_.size());
  statistics_.schemas = static_cast<std::uint16_t>(schemas_.size());
  bool first = true;
  for (const auto& piece : pieces_) {
    if (piece.start_time == 0 && piece.end_time == 0) continue;
    statistics_.start_time = first ? piece.start_time : std::min(statistics_.start_time, piece.start_time);
    statistics_.end_time = first ? piece.end_time : std::max(statistics_.end_time, piece.end_time);
    first = false;
  }
}

void Reader::find_order() {
  std::sort(pieces_.begin(), pieces_.end(), [](const Piece& a, const Piece& b) {
    return std::tie(a.start_time, a.offset) < std::tie(b.start_time, b.offset);
  });
}

/// A chunk's records, decompressed and compared with its checksum; or a run's, as they are.
std::string Reader::chunk_records(const Piece& piece) const {
  if (piece.length > limits_.chunk + chunk_head)
    refuse(piece.offset, "a chunk of " + std::to_string(piece.length) + " bytes is too long");
  if (!piece.chunk) return file_->read(piece.offset, piece.length);
  const auto head = file_->head(piece.offset, piece.offset + piece.length);
  if (!head || head->opcode != Opcode::chunk || head->length != piece.length - head_size)
    refuse(piece.offset, "there is no chunk, and the summary says so");
  try {
    const std::string content = file_->read(piece.offset + head_size, head->length);
    const Chunk chunk = read_chunk(content);
    if (chunk.uncompressed_size > limits_.chunk)
      throw RecordingError("a chunk of " + std::to_string(chunk.uncompressed_size) + " bytes is too long");
    std::string records = decompress(compression_of(chunk.compression), chunk.records, chunk.uncompressed_size);
    if (chunk.uncompressed_crc != 0 && crc32(0, records) != chunk.uncompressed_crc)
      throw RecordingError("a chunk is damaged: its checksum is wrong");
    return records;
  } catch (const RecordingError& error) {
    refuse(piece.offset, error.what());
  }
}

template <typename Each>
void Reader::for_each_record(const std::string& records, std::uint64_t place, const Each& each) const {
  std::size_t at = 0;
  while (at < records.size()) {
    const std::string_view rest = std::string_view(records).substr(at);
    if (rest.size() < head_size) refuse(place, "a chunk ends within a record");
    Content content(rest);
    const auto opcode = static_cast<Opcode>(content.u8());
    const std::uint64_t length = content.u64();
    if (length > rest.size() - head_size) refuse(place, "a chunk ends within a record");
    each(opcode, rest.substr(head_size, static_cast<std::size_t>(length)), at + head_size);
    at += head_size + static_cast<std::size_t>(length);
  }
}

void Reader::open_piece(std::size_t number) {
  const Piece& piece = pieces_[number];
  Open open{chunk_records(piece)};
  open_bytes_ += open.records.size();
  if (open_bytes_ > limits_.open_chunks)
    refuse(piece.offset, "the times of too many chunks overlap: they do not fit into " +
                             std::to_string(limits_.open_chunks >> 20) + " MiB");
  for_each_record(open.records, piece.offset, [&](Opcode opcode, std::string_view content, std::uint64_t at) {
    if (opcode != Opcode::message) return;
    const auto message = read_message(content);
    if (!channels_.contains(message.channel))
      refuse(piece.offset, "a message of the channel " + std::to_string(message.channel) + ", which nothing describes");
    open.messages.emplace_back(message.log_time, at);
  });
  if (open.messages.empty()) {
    open_bytes_ -= open.records.size();
    return;
  }
  std::stable_sort(open.messages.begin(), open.messages.end(),
                   [](const auto& a, const auto& b) { return a.first < b.first; });
  heads_.push({open.messages.front().first, number});
  open_.emplace(number, std::move(open));
}

std::optional<Message> Reader::next() {
  if (current_) {
    const auto spent = open_.find(*current_);
    if (spent->second.next == spent->second.messages.size()) {
      open_bytes_ -= spent->second.records.size();
      open_.erase(spent);
    }
    current_.reset();
  }
  while (unopened_ < pieces_.size() && (heads_.empty() || pieces_[unopened_].start_time <= heads_.top().time))
    open_piece(unopened_++);
  if (heads_.empty()) return std::nullopt;
  const Head head = heads_.top();
  heads_.pop();
  Open& open = open_.at(head.piece);
  const auto at = static_cast<std::size_t>(open.messages[open.next++].second);
  if (open.next < open.messages.size()) heads_.push({open.messages[open.next].first, head.piece});
  current_ = head.piece;
  Content length(std::string_view(open.records).substr(at - 8, 8));
  return read_message(std::string_view(open.records).substr(at, static_cast<std::size_t>(length.u64())));
}

void Reader::rewind() {
  current_.reset();
  open_.clear();
  open_bytes_ = 0;
  heads_ = {};
  unopened_ = 0;
}

void Reader::check() {
  std::map<std::uint16_t, std::uint64_t> counts;
  for (const auto& piece : pieces_) {
    for_each_record(chunk_records(piece), piece.offset, [&](Opcode opcode, std::string_view content, std::uint64_t) {
      if (opcode != Opcode::message) return;
      const auto message = read_message(content);
      if (message.log_time < piece.start_time || message.log_time > piece.end_time)
        refuse(piece.offset, "a message's time is not within that of its chunk");
      ++counts[message.channel];
    });
  }
  for (const auto& [channel, count] : statistics_.channel_messages) {
    if (counts[channel] != count)
      throw RecordingError(path_ + " has " + std::to_string(counts[channel]) + " messages of the channel " +
                           std::to_string(channel) + ", and says " + std::to_string(count));
  }
  if (!data_crc_ || *data_crc_ == 0) return;
  std::uint32_t crc = 0;
  constexpr std::uint64_t step = 1 << 20;
  for (std::uint64_t at = 0; at < data_end_; at += step)
    crc = crc32(crc, file_->read(at, std::min(step, data_end_ - at)));
  if (crc != *data_crc_) throw RecordingError(path_ + " is damaged: the checksum of its data is wrong");
}

}  // namespace iotcloud::recording::mcap

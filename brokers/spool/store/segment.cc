#include "iotcloud/brokers/spool/store/segment.h"

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <span>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/stat.h>
#include <unistd.h>

#include "iotcloud/brokers/spool/store/bytes.h"
#include <iotcloud/config/error.h>
#include <iotcloud/config/number.h>

namespace iotcloud::brokers::spool {
namespace {

constexpr std::string_view magic = "IOTSPOOL";
constexpr std::uint32_t version = 1;
constexpr std::string_view suffix = ".segment";
constexpr std::size_t digits = 20;
constexpr std::size_t read_ahead = std::size_t{256} << 10;

std::string path_of(const std::string& folder, std::uint64_t first) {
  return fmt::format("{}/{:0{}}{}", folder, first, digits, suffix);
}

std::string start_of_file() {
  std::string start(magic);
  put_number(start, version);
  put_number(start, checksum(std::as_bytes(std::span(start))));
  return start;
}

/// Accepts a damaged file start: the records after it may be good.
void check_version(int descriptor, const std::string& path) {
  std::byte start[Segment::file_start];
  if (::pread(descriptor, start, sizeof start, 0) != sizeof start) return;
  const std::span<const std::byte> bytes(start);
  const bool whole = get_number<std::uint32_t>(bytes.subspan(12)) == checksum(bytes.first(12));
  if (!whole || get_number<std::uint32_t>(bytes.subspan(8)) <= version) return;
  throw config::Error(fmt::format(
      "{} was written by a later version of this program: run that one until the spool is empty, or move the folder "
      "away to begin without what is in it",
      path));
}

}  // namespace

Segment::Segment(std::string path, std::uint64_t first, int descriptor, Disk& disk)
    : path_(std::move(path)), first_(first), descriptor_(descriptor), disk_(disk) {}

Segment::~Segment() {
  ::close(descriptor_);
}

std::shared_ptr<Segment> Segment::create(const std::string& folder, std::uint64_t first, Disk& disk) {
  std::string path = path_of(folder, first);
  const int descriptor = ::open(path.c_str(), O_RDWR | O_CREAT | O_TRUNC | O_CLOEXEC, 0600);
  if (descriptor < 0) return nullptr;
  std::shared_ptr<Segment> segment(new Segment(std::move(path), first, descriptor, disk));
  std::string start = start_of_file();
  if (const int error = segment->append(start, {})) {
    ::unlink(segment->path_.c_str());
    errno = error;
    return nullptr;
  }
  return segment;
}

std::shared_ptr<Segment> Segment::open(const std::string& folder, std::uint64_t first, Disk& disk) {
  std::string path = path_of(folder, first);
  const int descriptor = ::open(path.c_str(), O_RDWR | O_CLOEXEC);
  if (descriptor < 0) {
    throw config::Error(fmt::format("the spool's file {} cannot be opened: {}", path, std::strerror(errno)));
  }
  std::shared_ptr<Segment> segment(new Segment(std::move(path), first, descriptor, disk));
  check_version(descriptor, segment->path_);
  struct stat status {};
  ::fstat(descriptor, &status);
  segment->size_ = static_cast<std::uint64_t>(status.st_size);
  return segment;
}

std::optional<std::uint64_t> Segment::first_of(std::string_view file_name) {
  if (file_name.size() != digits + suffix.size() || !file_name.ends_with(suffix)) return std::nullopt;
  return config::parse_number<std::uint64_t>(file_name.substr(0, digits));
}

int Segment::append(std::string& head, const Payload& payload) {
  iovec parts[2] = {{head.data(), head.size()}, {const_cast<std::byte*>(payload.data()), payload.size()}};
  const std::uint64_t before = size();
  const int error = disk_.write(descriptor_, parts, payload.empty() ? 1 : 2, before);
  if (error != 0) {
    cut(before);
    return error;
  }
  size_.store(before + head.size() + payload.size(), std::memory_order_release);
  return 0;
}

int Segment::cut(std::uint64_t size) {
  size_.store(std::min(size, this->size()), std::memory_order_release);
  return ::ftruncate(descriptor_, static_cast<off_t>(size)) == 0 ? 0 : errno;
}

std::string Segment::remove() {
  if (!damaged_) {
    ::unlink(path_.c_str());
    return "";
  }
  std::string aside = path_ + ".damaged";
  for (int i = 2; ::access(aside.c_str(), F_OK) == 0; ++i) aside = fmt::format("{}.damaged-{}", path_, i);
  return std::rename(path_.c_str(), aside.c_str()) == 0 ? aside : path_;
}

SegmentReader::SegmentReader(std::shared_ptr<Segment> segment, std::uint64_t offset)
    : segment_(std::move(segment)), offset_(std::max<std::uint64_t>(offset, Segment::file_start)), good_end_(offset_) {}

bool SegmentReader::fill(std::size_t wanted) {
  if (view().size() >= wanted) return true;
  const std::uint64_t end = segment_->size();
  if (offset_ + wanted > end) return false;
  buffer_.erase(buffer_.begin(), buffer_.begin() + static_cast<std::ptrdiff_t>(begin_));
  begin_ = 0;
  std::size_t have = buffer_.size();
  buffer_.resize(std::min<std::uint64_t>(std::max(wanted, read_ahead), end - offset_));
  while (have < buffer_.size()) {
    const ssize_t got = ::pread(segment_->descriptor(), buffer_.data() + have, buffer_.size() - have,
                                static_cast<off_t>(offset_ + have));
    if (got < 0 && errno == EINTR) continue;
    if (got <= 0) break;  // an unreadable disk counts as damage
    have += static_cast<std::size_t>(got);
  }
  buffer_.resize(have);
  return have >= wanted;
}

bool SegmentReader::tail_is_torn() {
  fill(std::min<std::uint64_t>(bad_tail(), record_start));
  return decode_record(view()).kind == Decoded::Kind::incomplete;
}

std::optional<Record> SegmentReader::next() {
  std::uint64_t from = offset_;
  // Damaged bytes without a good record behind them are examined again in the next call, because they may be the
  // beginning of a record that is being appended.
  const std::uint64_t resume = offset_;
  while (fill(record_start)) {
    Decoded decoded = decode_record(view());
    while (decoded.kind == Decoded::Kind::incomplete && fill(decoded.size)) decoded = decode_record(view());
    if (decoded.kind == Decoded::Kind::record) {
      skipped_ += offset_ - from;
      if (offset_ > from) segment_->note_damage();
      offset_ += decoded.size;
      begin_ += decoded.size;
      good_end_ = offset_;
      return std::move(decoded.record);
    }
    const std::size_t step = find_record(view(), 1);
    offset_ += step;
    begin_ += step;
  }
  if (offset_ != resume) {
    buffer_.clear();
    begin_ = 0;
    offset_ = resume;
  }
  return std::nullopt;
}

}  // namespace iotcloud::brokers::spool

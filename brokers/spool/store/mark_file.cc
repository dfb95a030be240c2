#include "iotcloud/brokers/spool/store/mark_file.h"

#include <cerrno>
#include <cstring>
#include <span>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>
#include <unistd.h>

#include "iotcloud/brokers/spool/store/bytes.h"
#include "iotcloud/brokers/spool/store/record.h"
#include <iotcloud/config/error.h>

namespace iotcloud::brokers::spool {
namespace {

constexpr std::size_t place_size = 12;  // mark, checksum
constexpr int places = 2;
constexpr std::uint64_t distance = 512;  // one sector for each place

}  // namespace

MarkFile::MarkFile(std::string path, Disk& disk) : path_(std::move(path)), disk_(disk) {
  descriptor_ = ::open(path_.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600);
  if (descriptor_ < 0) {
    throw config::Error(fmt::format("the spool's file {} cannot be opened: {}", path_, std::strerror(errno)));
  }
  bool any = false;
  for (int place = 0; place < places; ++place) {
    std::byte content[place_size];
    const ssize_t got = ::pread(descriptor_, content, place_size, static_cast<off_t>(distance) * place);
    if (got > 0) any = true;
    if (got != place_size) continue;
    const std::span<const std::byte> bytes(content);
    if (get_number<std::uint32_t>(bytes.subspan(8)) != checksum(bytes.first(8))) continue;
    const auto mark = get_number<std::uint64_t>(bytes);
    if (mark < mark_ || mark > std::uint64_t{1} << 62) continue;
    mark_ = mark;
    next_place_ = (place + 1) % places;
  }
  damaged_ = any && mark_ == 0;
}

MarkFile::~MarkFile() {
  ::close(descriptor_);
}

int MarkFile::raise(std::uint64_t mark) {
  if (mark <= mark_) return 0;
  std::string content;
  put_number(content, mark);
  put_number(content, checksum(std::as_bytes(std::span(content))));
  iovec part{content.data(), content.size()};
  if (const int error = disk_.write(descriptor_, &part, 1, distance * static_cast<std::uint64_t>(next_place_))) {
    return error;
  }
  mark_ = mark;
  next_place_ = (next_place_ + 1) % places;
  return 0;
}

}  // namespace iotcloud::brokers::spool

#include "iotcloud/brokers/spool/store/spool_store.h"

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <cstring>
#include <filesystem>
#include <thread>
#include <utility>
#include <vector>

#include <fcntl.h>
#include <fmt/format.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/log.h>

namespace iotcloud::brokers::spool {
namespace {

const config::Logger logger{"brokers.spool"};

// A spool is given back to the disk, and dropped when it is full, in so many parts, more or less.
constexpr std::uint64_t parts = 16;
constexpr std::uint64_t largest_segment = std::uint64_t{16} << 20;

std::uint64_t bytes_of(const Segment& segment) {
  return segment.size();
}

}  // namespace

SpoolStore::SpoolStore(Options options)
    : options_(std::move(options)),
      disk_(options_.disk != nullptr ? *options_.disk : system_disk()),
      segment_bytes_(std::min(options_.max_bytes / parts, largest_segment)) {
  try {
    lock_folder();
    mark_.emplace(options_.folder + "/mark", disk_);
    find_segments();
    repair_last();
  } catch (...) {
    if (lock_ >= 0) ::close(lock_);
    if (folder_descriptor_ >= 0) ::close(folder_descriptor_);
    throw;
  }
  found_.mark_lost = mark_->damaged();
  next_ = std::max<std::uint64_t>({next_, mark_->mark(), 1});
  own_from_ = next_;
  const std::uint64_t first = segments_.empty() ? own_from_ : segments_.front()->first();
  if (mark_->mark() > 0 && first > mark_->mark()) found_.missing_messages = first - mark_->mark();
  mark_->raise(first);
  release();
  found_.messages = own_from_ - mark_->mark();
}

SpoolStore::~SpoolStore() {
  if (mark_->mark() >= next_) {
    for (const auto& segment : std::exchange(segments_, {})) remove(segment);
    ::unlink(mark_->path().c_str());
    ::unlink((options_.folder + "/lock").c_str());
    ::rmdir(options_.folder.c_str());  // fails when something is kept aside
  }
  ::close(folder_descriptor_);
  ::close(lock_);
}

void SpoolStore::lock_folder() {
  const std::string& folder = options_.folder;
  const std::string lock_file = folder + "/lock";
  const auto give_up = std::chrono::steady_clock::now() + options_.lock_limit;
  for (;;) {
    std::error_code error;
    std::filesystem::create_directories(folder, error);
    if (error) throw config::Error(fmt::format("the spool's folder {} cannot be made: {}", folder, error.message()));
    lock_ = ::open(lock_file.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600);
    if (lock_ < 0 && errno == ENOENT) continue;  // an owner that had nothing left has just removed it
    if (lock_ < 0) {
      throw config::Error(
          fmt::format("the spool's folder {} cannot be used: {}: {}", folder, lock_file, std::strerror(errno)));
    }
    while (::flock(lock_, LOCK_EX | LOCK_NB) != 0 && std::chrono::steady_clock::now() < give_up) {
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    if (::flock(lock_, LOCK_EX | LOCK_NB) != 0) {
      throw config::Error(fmt::format(
          "the spool's folder {} is in use by another publisher (this process's or another's); only one at a time may "
          "have it: close that one, or give this one a folder of its own",
          folder));
    }
    struct stat mine {};
    struct stat there {};
    if (::fstat(lock_, &mine) == 0 && ::stat(lock_file.c_str(), &there) == 0 && mine.st_ino == there.st_ino) break;
    ::close(std::exchange(lock_, -1));
  }
  folder_descriptor_ = ::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
}

void SpoolStore::find_segments() {
  std::vector<std::uint64_t> firsts;
  std::error_code error;
  for (const auto& file : std::filesystem::directory_iterator(options_.folder, error)) {
    if (const auto first = Segment::first_of(file.path().filename().string())) firsts.push_back(*first);
  }
  if (error)
    throw config::Error(fmt::format("the spool's folder {} cannot be read: {}", options_.folder, error.message()));
  std::sort(firsts.begin(), firsts.end());
  for (const std::uint64_t first : firsts) {
    segments_.push_back(Segment::open(options_.folder, first, disk_));
    bytes_ += bytes_of(*segments_.back());
  }
}

void SpoolStore::repair_last() {
  if (segments_.empty()) return;
  const std::shared_ptr<Segment> last = segments_.back();
  SegmentReader reader(last, 0);
  next_ = last->first();
  while (const auto record = reader.next()) next_ = record->sequence + 1;
  const std::uint64_t bad = reader.bad_tail();
  if (bad > 0) {
    (reader.tail_is_torn() ? found_.torn_bytes : found_.damaged_bytes) = bad;
    std::error_code ignored;
    if (found_.damaged_bytes > 0) std::filesystem::copy_file(last->path(), last->path() + ".damaged", ignored);
    bytes_ -= bad;
    if (const int error = last->cut(reader.offset())) {
      throw config::Error(fmt::format("the spool's file {} ends in {} bytes that are no record and cannot be cut: {}",
                                      last->path(), bad, std::strerror(error)));
    }
  }
  if (next_ > last->first()) return;
  segments_.pop_back();  // nothing in it
  remove(last);
}

std::uint64_t SpoolStore::mark() const {
  const std::lock_guard lock(mutex_);
  return mark_->mark();
}

std::shared_ptr<Segment> SpoolStore::last() const {
  const std::lock_guard lock(mutex_);
  return segments_.empty() ? nullptr : segments_.back();
}

bool SpoolStore::start_segment() {
  const auto complete = last();
  auto segment = Segment::create(options_.folder, next_, disk_);
  if (!segment) {
    problem_ = fmt::format("no file can be made in {}: {}", options_.folder, std::strerror(errno));
    return false;
  }
  if (options_.sync != Sync::never) disk_.sync(folder_descriptor_);
  bytes_ += bytes_of(*segment);
  const std::lock_guard lock(mutex_);
  segments_.push_back(std::move(segment));
  if (complete && options_.sync == Sync::interval) unsynced_.push_back(complete);
  return true;
}

SpoolStore::Append SpoolStore::append(std::int64_t accepted_ms, const Message& message, Position& where) {
  encode_head(next_, accepted_ms, message, head_);
  size_ = head_.size() + message.payload.size();
  if (size_ + Segment::file_start > options_.max_bytes) return Append::too_large;
  if (!make_room(size_ + Segment::file_start)) return Append::full;
  std::shared_ptr<Segment> segment = last();
  // A file that an earlier process wrote takes no more, nor one that is large enough.
  if (!segment || segment->first() < own_from_ ||
      (segment->size() > Segment::file_start && segment->size() + size_ > segment_bytes_)) {
    if (!start_segment()) return Append::failed;
    segment = last();
  }
  const std::uint64_t before = segment->size();
  int error = segment->append(head_, message.payload);
  if (error == 0 && options_.sync == Sync::always) {
    error = segment->sync();
    if (error != 0) segment->cut(before);
  }
  if (error != 0) {
    problem_ = fmt::format("{} cannot be written: {}", segment->path(), std::strerror(error));
    return Append::failed;
  }
  bytes_ += size_;
  where = {segment->first(), before};
  ++next_;
  return Append::stored;
}

/// Removes what is done with when there is no room. \return whether there is then.
bool SpoolStore::make_room(std::uint64_t size) {
  if (bytes() + size <= options_.max_bytes) return true;
  release();
  if (bytes() + size > options_.max_bytes && mark() >= next_) drop_oldest();  // the file being written is all there is
  return bytes() + size <= options_.max_bytes;
}

std::uint64_t SpoolStore::drop_oldest() {
  std::unique_lock lock(mutex_);
  if (segments_.empty()) return next_;
  const std::shared_ptr<Segment> oldest = segments_.front();
  segments_.pop_front();
  const std::uint64_t kept = segments_.empty() ? next_.load() : segments_.front()->first();
  lock.unlock();
  raise_mark(kept);  // first, so that what is missing then is not taken for damage
  remove(oldest);
  return kept;
}

void SpoolStore::raise_mark(std::uint64_t mark) {
  const std::lock_guard lock(mutex_);
  const int error = mark_->raise(mark);
  if (error != 0 && !std::exchange(mark_failed_, true)) {
    logger.error("{} cannot be written: {}; after a restart messages that arrived are sent again", mark_->path(),
                 std::strerror(error));
  }
}

bool SpoolStore::has_room(std::uint64_t size) const {
  return bytes() + size + Segment::file_start <= options_.max_bytes || mark() >= next_;
}

bool SpoolStore::releasable() const {
  const std::lock_guard lock(mutex_);
  return segments_.size() > 1 && segments_[1]->first() <= mark_->mark();
}

void SpoolStore::release() {
  for (;;) {
    std::unique_lock lock(mutex_);
    if (segments_.size() < 2 || segments_[1]->first() > mark_->mark()) return;
    const std::shared_ptr<Segment> done = segments_.front();
    segments_.pop_front();
    lock.unlock();
    remove(done);
  }
}

void SpoolStore::remove(const std::shared_ptr<Segment>& segment) {
  bytes_ -= bytes_of(*segment);
  const std::string aside = segment->remove();
  if (!aside.empty()) {
    logger.error("a damaged file of the spool is kept for you to look at: {}; delete it when you have", aside);
  }
}

int SpoolStore::sync() {
  std::vector<std::shared_ptr<Segment>> segments;
  {
    const std::lock_guard lock(mutex_);
    segments.swap(unsynced_);
    if (segments_.empty() || mark_->mark() >= next_) return 0;
    const std::uint64_t first = segments_.front()->first();
    std::erase_if(segments, [&](const auto& segment) { return segment->first() < first; });  // they are gone
    segments.push_back(segments_.back());
  }
  int error = 0;
  for (const auto& segment : segments) {
    if (const int problem = segment->sync()) error = problem;
  }
  return error;
}

std::shared_ptr<Segment> SpoolStore::segment_at(std::uint64_t sequence) const {
  const std::lock_guard lock(mutex_);
  auto found = std::upper_bound(segments_.begin(), segments_.end(), sequence,
                                [](std::uint64_t s, const auto& segment) { return s < segment->first(); });
  if (found != segments_.begin()) --found;
  return found == segments_.end() ? nullptr : *found;
}

std::shared_ptr<Segment> SpoolStore::segment_after(std::uint64_t first) const {
  const std::lock_guard lock(mutex_);
  const auto found = std::upper_bound(segments_.begin(), segments_.end(), first,
                                      [](std::uint64_t s, const auto& segment) { return s < segment->first(); });
  return found == segments_.end() ? nullptr : *found;
}

}  // namespace iotcloud::brokers::spool

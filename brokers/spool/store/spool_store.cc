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

#include <iotcloud/brokers/spool/logger.h>
#include <iotcloud/config/durable_write.h>
#include <iotcloud/config/error.h>

namespace iotcloud::brokers::spool {
namespace {

// A spool has about this many segments. A segment is the unit in which space is freed, and messages are dropped.
constexpr std::uint64_t parts = 16;
constexpr std::uint64_t largest_segment = std::uint64_t{16} << 20;

bool is_full(int error) {
  return error == ENOSPC || error == EDQUOT;
}

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
    mark_file_.emplace(options_.folder + "/mark", disk_);
    mark_ = mark_file_->mark();
    find_segments();
    repair_last();
  } catch (...) {
    if (lock_ >= 0) ::close(lock_);
    if (folder_descriptor_ >= 0) ::close(folder_descriptor_);
    throw;
  }
  found_.mark_lost = mark_file_->damaged();
  next_ = std::max<std::uint64_t>({next_, mark(), 1});
  own_from_ = next_;
  const std::uint64_t first = segments_.empty() ? own_from_ : segments_.front()->first();
  if (mark() > 0 && first > mark()) found_.missing_messages = first - mark();
  raise_mark(first);
  release();
  found_.messages = own_from_ - mark();
}

SpoolStore::~SpoolStore() {
  if (mark() >= next_) {
    for (const auto& segment : std::exchange(segments_, {})) remove(segment);
    ::unlink(mark_file_->path().c_str());
    ::unlink((options_.folder + "/lock").c_str());
    ::rmdir(options_.folder.c_str());  // fails if a file is kept aside
  }
  ::close(folder_descriptor_);
  ::close(lock_);
}

void SpoolStore::lock_folder() {
  const std::string& folder = options_.folder;
  const std::string lock_file = folder + "/lock";
  const auto give_up = std::chrono::steady_clock::now() + options_.lock_limit;
  for (;;) {
    for (std::filesystem::path level(folder); options_.synced && !level.empty() && !std::filesystem::exists(level);
         level = level.parent_path()) {
      new_names_in_.insert(level.has_parent_path() ? level.parent_path().string() : ".");
    }
    std::error_code error;
    std::filesystem::create_directories(folder, error);
    if (error) throw config::Error(fmt::format("the spool's folder {} cannot be made: {}", folder, error.message()));
    lock_ = ::open(lock_file.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600);
    if (lock_ < 0 && errno == ENOENT) continue;  // an owner with nothing left has just removed the folder
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

int SpoolStore::sync_new_names() {
  try {
    for (; !new_names_in_.empty(); new_names_in_.erase(new_names_in_.begin())) {
      config::sync_folder(*new_names_in_.begin());
    }
    return 0;
  } catch (const config::Error&) {
    return EIO;
  }
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
  segments_.pop_back();  // it is empty
  remove(last);
}

std::shared_ptr<Segment> SpoolStore::last() const {
  const config::MutexLock lock(mutex_);
  return segments_.empty() ? nullptr : segments_.back();
}

int SpoolStore::start_segment() {
  const auto complete = last();
  auto segment = Segment::create(options_.folder, next_, disk_);
  if (!segment) {
    const int error = errno;
    problem_ = fmt::format("no file can be made in {}: {}", options_.folder, std::strerror(error));
    return error;
  }
  bytes_ += bytes_of(*segment);
  const config::MutexLock lock(mutex_);
  segments_.push_back(std::move(segment));
  folder_unsynced_ = options_.synced;
  if (complete && options_.synced) unsynced_.push_back(complete);
  return 0;
}

SpoolStore::Append SpoolStore::append(std::int64_t accepted_ms, const Message& message, Position& where) {
  appender_.assert_held();
  encode_head(next_, accepted_ms, message, head_);
  size_ = head_.size() + message.payload.size();
  if (size_ + Segment::file_start > options_.max_bytes) return Append::too_large;
  if (!make_room(size_ + Segment::file_start)) return Append::full;
  std::shared_ptr<Segment> segment = last();
  // A large segment, and one of an earlier process, takes no more records.
  if (!segment || segment->first() < own_from_ ||
      (segment->size() > Segment::file_start && segment->size() + size_ > segment_bytes_)) {
    if (const int error = start_segment()) return is_full(error) ? Append::disk_full : Append::failed;
    segment = last();
  }
  const std::uint64_t before = segment->size();
  if (const int error = segment->append(head_, message.payload)) {
    problem_ = fmt::format("{} cannot be written: {}", segment->path(), std::strerror(error));
    return is_full(error) ? Append::disk_full : Append::failed;
  }
  bytes_ += size_;
  where = {segment->first(), before};
  ++next_;
  return Append::stored;
}

/// Removes finished segments if there is no room. \return whether there is room then.
bool SpoolStore::make_room(std::uint64_t size) {
  if (bytes() + size <= options_.max_bytes) return true;
  release();
  if (bytes() + size > options_.max_bytes && mark() >= next_) drop_oldest();  // there is only the current segment
  return bytes() + size <= options_.max_bytes;
}

std::uint64_t SpoolStore::drop_oldest() {
  std::shared_ptr<Segment> oldest;
  std::uint64_t kept = 0;
  {
    const config::MutexLock lock(mutex_);
    if (segments_.empty()) return next_;
    oldest = segments_.front();
    segments_.pop_front();
    kept = segments_.empty() ? next_.load() : segments_.front()->first();
  }
  raise_mark(kept);  // raised first, so that the missing records do not count as damage
  remove(oldest);
  return kept;
}

void SpoolStore::raise_mark(std::uint64_t mark) {
  const config::MutexLock lock(mark_mutex_);
  const int error = mark_file_->raise(mark);
  mark_.store(mark_file_->mark(), std::memory_order_release);
  if (error != 0 && !std::exchange(mark_failed_, true)) {
    logger.error("{} cannot be written: {}; after a restart, messages that the broker has confirmed are sent again",
                 mark_file_->path(), std::strerror(error));
  }
}

bool SpoolStore::has_room(std::uint64_t size) const {
  return bytes() + size + Segment::file_start <= options_.max_bytes || mark() >= next_;
}

bool SpoolStore::releasable() const {
  const config::MutexLock lock(mutex_);
  return segments_.size() > 1 && segments_[1]->first() <= mark();
}

void SpoolStore::release() {
  for (;;) {
    std::shared_ptr<Segment> done;
    {
      const config::MutexLock lock(mutex_);
      if (segments_.size() < 2 || segments_[1]->first() > mark()) return;
      done = segments_.front();
      segments_.pop_front();
    }
    remove(done);
  }
}

void SpoolStore::remove(const std::shared_ptr<Segment>& segment) {
  bytes_ -= bytes_of(*segment);
  const std::string aside = segment->remove();
  if (!aside.empty()) {
    logger.error("a damaged file of the spool is kept: {}; delete it when you do not need it any more", aside);
  }
}

int SpoolStore::sync() {
  std::vector<std::shared_ptr<Segment>> segments;
  bool folder = false;
  {
    const config::MutexLock lock(mutex_);
    segments.swap(unsynced_);
    if (segments_.empty() || mark() >= next_) return 0;
    folder = std::exchange(folder_unsynced_, false);
    const std::uint64_t first = segments_.front()->first();
    std::erase_if(segments, [&](const auto& segment) { return segment->first() < first; });  // released meanwhile
    segments.push_back(segments_.back());
  }
  int error = 0;
  for (const auto& segment : segments) {
    if (const int problem = segment->sync()) error = problem;
  }
  if (folder) {
    if (const int problem = disk_.sync(folder_descriptor_)) error = problem;
  }
  if (const int problem = sync_new_names()) error = problem;
  if (error != 0) {
    segments.pop_back();
    const config::MutexLock lock(mutex_);
    unsynced_.insert(unsynced_.begin(), segments.begin(), segments.end());
    folder_unsynced_ = folder_unsynced_ || folder;
  }
  return error;
}

std::shared_ptr<Segment> SpoolStore::segment_at(std::uint64_t sequence) const {
  const config::MutexLock lock(mutex_);
  auto found = std::upper_bound(segments_.begin(), segments_.end(), sequence,
                                [](std::uint64_t s, const auto& segment) { return s < segment->first(); });
  if (found != segments_.begin()) --found;
  return found == segments_.end() ? nullptr : *found;
}

std::shared_ptr<Segment> SpoolStore::segment_after(std::uint64_t first) const {
  const config::MutexLock lock(mutex_);
  const auto found = std::upper_bound(segments_.begin(), segments_.end(), first,
                                      [](std::uint64_t s, const auto& segment) { return s < segment->first(); });
  return found == segments_.end() ? nullptr : *found;
}

}  // namespace iotcloud::brokers::spool

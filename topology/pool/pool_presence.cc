#include <utility>

#include <fmt/format.h>

#include <iotcloud/topology/pool/logger.h>
#include <iotcloud/topology/pool/pool_presence.h>

namespace iotcloud::topology {

using discovery::RegistryError;
using discovery::RegistryErrorCode;
using discovery::SessionState;

namespace {

constexpr std::chrono::milliseconds try_pause{100};
/// What changes together is written once.
constexpr std::chrono::milliseconds report_pause{10};

}  // namespace

PoolPresence::PoolPresence(discovery::Registry& registry, discovery::Paths paths, discovery::PoolRecord record)
    : registry_(registry), path_(paths.pool(record.id)), record_(std::move(record)) {}

PoolPresence::~PoolPresence() {
  leave();
}

void PoolPresence::join(std::chrono::milliseconds patience, const std::stop_token& stop) {
  const auto deadline = std::chrono::steady_clock::now() + patience;
  for (bool told = false; !stop.stop_requested();) {
    if (take()) break;
    if (std::chrono::steady_clock::now() >= deadline) {
      const config::MutexLock lock(mutex_);
      throw config::Error(fmt::format("another pool with the id {} lives: give this one another id", record_.id));
    }
    if (!std::exchange(told, true)) {
      pool_logger.warn("another pool has the node {}; this one waits up to {} ms, in which that of a dead pool goes",
                       path_, patience.count());
    }
    const config::MutexLock lock(mutex_);
    changed_.wait_for(mutex_, stop, try_pause, [] { return false; });
  }
  sessions_ = registry_.on_session([this](SessionState state) {
    if (state != SessionState::connected) return;
    const config::MutexLock lock(mutex_);
    due_ = true;  // the last report may not have arrived
    changed_.notify_all();
  });
  thread_ = std::jthread([this](const std::stop_token& end) { run(end); });
}

/// \return false if another pool's node stands there.
bool PoolPresence::take() {
  const auto record = [this] {
    const config::MutexLock lock(mutex_);
    return record_;
  }();
  const auto joined = [this](const std::string& /*path*/) {
    const config::MutexLock lock(mutex_);
    joined_ = due_ = true;
    changed_.notify_all();
  };
  try {
    if (const auto there = registry_.get(path_)) {
      if (discovery::decode_pool(there->data, path_).state_id != record.state_id) return false;
      registry_.remove(path_);  // of a dead run of this pool, whose state folder this one has locked
    }
    node_ = registry_.hold(path_, discovery::encode(record), false, joined);
    return true;
  } catch (const RegistryError& error) {
    if (error.code() == RegistryErrorCode::exists) return false;
    pool_logger.warn("the pool joins when the registry permits it: {}", error.what());
  } catch (const config::Error& error) {
    pool_logger.warn("{}", error.what());
    return false;
  }
  node_ = registry_.hold_eventually(path_, discovery::encode(record), false, joined);
  return true;
}

void PoolPresence::show(std::vector<discovery::PlaceStatus> places, std::vector<std::string> files,
                        std::string trouble) {
  const config::MutexLock lock(mutex_);
  if (record_.places == places && record_.files == files && record_.trouble == trouble) return;
  record_.places = std::move(places);
  record_.files = std::move(files);
  record_.trouble = std::move(trouble);
  due_ = true;
  changed_.notify_all();
}

std::string PoolPresence::trouble() const {
  const config::MutexLock lock(mutex_);
  return joined_ ? "" : "the registry does not show this pool yet";
}

void PoolPresence::run(const std::stop_token& stop) {
  while (!stop.stop_requested()) {
    {
      const config::MutexLock lock(mutex_);
      changed_.wait(mutex_, stop, [this]() IOTCLOUD_REQUIRES(mutex_) { return due_ && joined_; });
      if (stop.stop_requested()) return;
      changed_.wait_for(mutex_, stop, report_pause, [] { return false; });
      due_ = false;
    }
    report();
  }
}

void PoolPresence::report() {
  const std::string bytes = [this] {
    const config::MutexLock lock(mutex_);
    return discovery::encode(record_);
  }();
  try {
    registry_.set(path_, bytes);
  } catch (const RegistryError& error) {
    // A missing node or registry is no fault: the report is repeated when the node is made or the registry is back.
    if (error.code() != RegistryErrorCode::no_node && error.code() != RegistryErrorCode::away)
      pool_logger.warn("the pool's record could not be written: {}", error.what());
  }
}

void PoolPresence::leave() {
  thread_ = {};
  sessions_.reset();
  node_.reset();
}

}  // namespace iotcloud::topology

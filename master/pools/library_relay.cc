#include <algorithm>
#include <optional>
#include <vector>

#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/master/logger.h>
#include <iotcloud/master/master.h>
#include <iotcloud/master/pools/library_relay.h>

namespace iotcloud::master {

using discovery::PoolRecord;
using discovery::SentLibrary;

LibraryRelay::LibraryRelay(const Master& master, discovery::Registry& registry, Options options)
    : master_(master),
      registry_(registry),
      options_(std::move(options)),
      thread_([this](const std::stop_token& stop) { run(stop); }) {
  names_ = registry_.watch_children(options_.paths.pools, [this](const auto& names) { on_pools(names); });
}

LibraryRelay::~LibraryRelay() {
  names_.reset();  // from now on nobody else uses pools_
  pools_.clear();
}

void LibraryRelay::on_pools(const std::optional<std::vector<std::string>>& names) {
  const auto now = names.value_or(std::vector<std::string>());
  std::erase_if(pools_, [&](const auto& one) { return std::find(now.begin(), now.end(), one.first) == now.end(); });
  for (const auto& name : now) {
    auto& guard = pools_[name];
    if (!guard) guard = registry_.watch_node(options_.paths.pools + "/" + name, [this](const auto&) { look(); });
  }
  look();
}

void LibraryRelay::look() {
  const config::MutexLock lock(mutex_);
  due_ = true;
  changed_.notify_all();
}

void LibraryRelay::run(const std::stop_token& stop) {
  while (!stop.stop_requested()) {
    {
      const config::MutexLock lock(mutex_);
      const auto due = [this]() IOTCLOUD_REQUIRES(mutex_) { return due_; };
      if (failed_.empty()) {
        changed_.wait(mutex_, stop, due);
      } else {
        changed_.wait_for(mutex_, stop, options_.retry_pause, due);
      }
      due_ = false;
    }
    if (stop.stop_requested() || !master_.status().leading) continue;
    try {
      pass_all(stop);
    } catch (const config::Error& error) {
      logger.debug("what pools lack is looked for later: {}", error.what());
    }
  }
}

void LibraryRelay::pass_all(const std::stop_token& stop) {
  const auto pools = discovery::list_pools(registry_, options_.paths);
  if (pools.size() < 2) return failed_.clear();
  std::vector<SentLibrary> needed;
  for (const auto& [name, standing] : discovery::list_submissions(registry_, options_.paths)) {
    const auto& of_version = standing.submission.version.libraries;
    needed.insert(needed.end(), of_version.begin(), of_version.end());
    if (!standing.submission.previous) continue;
    const auto& before = standing.submission.previous->libraries;
    needed.insert(needed.end(), before.begin(), before.end());
  }
  const auto now = std::chrono::steady_clock::now();
  for (const auto& pool : pools) {
    for (const auto& library : needed) {
      if (stop.stop_requested()) return;
      const Errand errand{pool.id, library.sha256};
      if (std::find(pool.files.begin(), pool.files.end(), library.sha256) != pool.files.end()) {
        failed_.erase(errand);
        continue;
      }
      if (const auto last = failed_.find(errand); last != failed_.end() && now - last->second < options_.retry_pause)
        continue;
      failed_[errand] = now;
      pass(pool, library, pools);
    }
  }
}

/// Passes a library on from the first pool that has it and answers.
void LibraryRelay::pass(const PoolRecord& taker, const SentLibrary& library, const std::vector<PoolRecord>& pools) {
  for (const auto& giver : pools) {
    if (std::find(giver.files.begin(), giver.files.end(), library.sha256) == giver.files.end()) continue;
    try {
      pass_library(address_of(giver, options_.access), giver.id, address_of(taker, options_.access), taker.id,
                   library.file, library.sha256, options_.answer_limit);
      logger.info("pool {} got the library {} from pool {}", taker.id, library.file, giver.id);
      return;
    } catch (const config::Error& error) {
      logger.warn("the library {} does not get from pool {} to pool {}: {}", library.file, giver.id, taker.id,
                  error.what());
    }
  }
}

}  // namespace iotcloud::master

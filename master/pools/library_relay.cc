#include <algorithm>
#include <optional>
#include <set>
#include <vector>

#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/master/logger.h>
#include <iotcloud/master/master.h>
#include <iotcloud/master/pools/library_relay.h>

namespace iotcloud::master {

using discovery::PoolRecord;
using discovery::SentLibrary;
using Steady = std::chrono::steady_clock;

namespace {

bool keeps(const PoolRecord& pool, const SentLibrary& library) {
  return std::find(pool.files.begin(), pool.files.end(), library.sha256) != pool.files.end();
}

}  // namespace

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
  forget_others(pools);
  if (pools.size() < 2) return failed_.clear();
  std::vector<SentLibrary> needed;
  for (const auto& [name, standing] : discovery::list_submissions(registry_, options_.paths)) {
    const auto& of_version = standing.submission.version.libraries;
    needed.insert(needed.end(), of_version.begin(), of_version.end());
    if (!standing.submission.previous) continue;
    const auto& before = standing.submission.previous->libraries;
    needed.insert(needed.end(), before.begin(), before.end());
  }
  const auto waits = [](const auto& until_of, const auto& key) {
    const auto until = until_of.find(key);
    return until != until_of.end() && Steady::now() < until->second;
  };
  for (const auto& pool : pools) {
    const auto again_at = [&](const SentLibrary& library) {
      const auto at = failed_.find({pool.id, library.sha256});
      return at == failed_.end() ? Steady::time_point::min() : at->second;
    };
    // What was tried longest ago comes first: a library that never comes keeps no other one from coming.
    std::stable_sort(needed.begin(), needed.end(),
                     [&](const auto& a, const auto& b) { return again_at(a) < again_at(b); });
    for (const auto& library : needed) {
      if (stop.stop_requested()) return;
      const Errand errand{pool.id, library.sha256};
      if (keeps(pool, library)) {
        failed_.erase(errand);
        continue;
      }
      if (waits(failed_, errand) || waits(slow_, pool.id)) continue;
      const auto begin = Steady::now();
      const bool passed = pass(pool, library, pools, stop);
      const auto end = Steady::now();
      failed_[errand] = end + options_.retry_pause;
      if (!passed && end - begin > options_.retry_pause) slow_[pool.id] = end + (end - begin);
    }
  }
}

/// Passes a library on from the first pool that has it and answers.
bool LibraryRelay::pass(const PoolRecord& taker, const SentLibrary& library, const std::vector<PoolRecord>& pools,
                        const std::stop_token& stop) {
  std::vector<const PoolRecord*> givers;
  for (const auto& pool : pools) {
    if (keeps(pool, library)) givers.push_back(&pool);
  }
  const auto failed_at = [&](const PoolRecord* giver) {
    const auto at = unwilling_.find(giver->id);
    return at == unwilling_.end() ? Steady::time_point::min() : at->second;
  };
  std::stable_sort(givers.begin(), givers.end(),
                   [&](const auto* a, const auto* b) { return failed_at(a) < failed_at(b); });
  for (const auto* giver : givers) {
    if (stop.stop_requested()) return false;
    try {
      pass_library(address_of(*giver, options_.access), giver->id, address_of(taker, options_.access), taker.id,
                   library.file, library.sha256, options_.limits, stop);
      logger.info("pool {} got the library {} from pool {}", taker.id, library.file, giver->id);
      return true;
    } catch (const config::Error& error) {
      unwilling_[giver->id] = Steady::now();
      logger.warn("the library {} does not get from pool {} to pool {}: {}", library.file, giver->id, taker.id,
                  error.what());
    }
  }
  return false;
}

/// Forgets what was remembered of pools that are gone.
void LibraryRelay::forget_others(const std::vector<PoolRecord>& pools) {
  std::set<discovery::PoolId> there;
  for (const auto& pool : pools) there.insert(pool.id);
  std::erase_if(failed_, [&](const auto& one) { return !there.contains(one.first.first); });
  std::erase_if(slow_, [&](const auto& one) { return !there.contains(one.first); });
  std::erase_if(unwilling_, [&](const auto& one) { return !there.contains(one.first); });
}

}  // namespace iotcloud::master

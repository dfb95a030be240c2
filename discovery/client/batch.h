#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/client/connection.h>

namespace iotcloud::discovery {

/// Reads that run at the same time: together they take little longer than one.
class Batch {
 public:
  using Read = std::function<void(RegistryConnection&, const std::string& path, Done)>;
  /// As many reads as a server handles at once without making its clients wait.
  static constexpr std::size_t size = 500;

  /// Starts one read for each path. Calls `done` once, after the last answer: with `away` if any answer was `away`,
  /// otherwise with `ok`, whatever the answers say.
  static std::shared_ptr<Batch> start(RegistryConnection& connection, std::span<const std::string> paths,
                                      const Read& read, Done done);

  /// In the order of the paths. Call it after `done` only.
  std::vector<Reply>& replies() {
    mutex_.assert_held();  // after the last answer no other thread touches the replies
    return replies_;
  }

 private:
  Batch(std::size_t count, Done done) : done_(std::move(done)), replies_(count), missing_(count) {}
  void answered(std::size_t place, Reply reply);

  const Done done_;
  config::Mutex mutex_;
  std::vector<Reply> replies_ IOTCLOUD_GUARDED_BY(mutex_);
  std::size_t missing_ IOTCLOUD_GUARDED_BY(mutex_);
  bool away_ IOTCLOUD_GUARDED_BY(mutex_) = false;
};

}  // namespace iotcloud::discovery

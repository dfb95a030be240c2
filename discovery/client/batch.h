#pragma once

#include <cstddef>
#include <functional>
#include <memory>
#include <mutex>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include <iotcloud/discovery/client/connection.h>

namespace iotcloud::discovery {

/// Reads that are under way together: they take little more time than one of them.
class Batch {
 public:
  using Read = std::function<void(Connection&, const std::string& path, Done)>;
  /// As many as a server works on without telling its clients to wait.
  static constexpr std::size_t size = 500;

  /// Starts one read for each path. `done` is called once, when the last is answered: `away` when one of them was,
  /// `ok` otherwise, whatever else they say.
  static std::shared_ptr<Batch> start(Connection& connection, std::span<const std::string> paths, const Read& read,
                                      Done done);

  /// In the order of the paths. Only after `done`.
  std::vector<Reply>& replies() { return replies_; }

 private:
  Batch(std::size_t count, Done done) : done_(std::move(done)), replies_(count), missing_(count) {}
  void answered(std::size_t place, Reply reply);

  const Done done_;
  std::mutex mutex_;
  std::vector<Reply> replies_;  ///< guarded by mutex_ until the last is there
  std::size_t missing_;         ///< guarded by mutex_
  bool away_ = false;           ///< guarded by mutex_
};

}  // namespace iotcloud::discovery

#pragma once

#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <map>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>

namespace iotcloud::master {

/// Lists all driver instances. Few are read, one by one; of many their nodes are watched from the first time on, so
/// that what did not change is not read again. Then a change that nobody ordered here may be seen some milliseconds
/// late. Thread safe; one lists at a time.
class DriverView {
 public:
  struct Options {
    std::size_t few = 256;                          ///< as many are read anew each time
    std::chrono::milliseconds first_limit{10'000};  ///< for the first look at many
  };
  /// The references outlive the view.
  DriverView(discovery::Registry& registry, const discovery::Paths& paths, Options options);
  DriverView(discovery::Registry& registry, const discovery::Paths& paths) : DriverView(registry, paths, Options()) {}
  ~DriverView();
  DriverView(const DriverView&) = delete;
  DriverView& operator=(const DriverView&) = delete;

  /// With their channels. \throws discovery::RegistryError.
  std::vector<discovery::DriverRecord> list();
  /// What became of an order for it is known: it is read anew by the next list().
  void ordered(const std::string& instance);

 private:
  struct Entry {
    bool read = false;
    std::int64_t created = 0, version = -1;
    std::optional<discovery::DriverRecord> record;
    discovery::GuardPtr watch;  ///< of the one who lists
  };
  void watch_all(const std::vector<std::string>& instances);
  void read_ordered(const std::vector<std::string>& instances);
  void wait_until_read();
  void take(const std::string& path, const std::optional<discovery::Node>& node);
  void forget(std::map<std::string, Entry> gone);

  discovery::Registry& registry_;
  const discovery::Paths& paths_;
  const Options options_;
  std::mutex listing_;  ///< taken before mutex_; never by a callback

  std::mutex mutex_;
  std::condition_variable all_read_;
  std::map<std::string, Entry> entries_;  ///< by path; guarded by mutex_
  std::size_t unread_ = 0;                ///< guarded by mutex_
  std::set<std::string> ordered_;         ///< instances; guarded by mutex_
};

}  // namespace iotcloud::master

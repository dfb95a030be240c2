#pragma once

#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>

namespace iotcloud::gateway {

/// Keeps one gateway's driver and channel records in the registry equal to what is. While the registry is away the
/// latest state of each instance waits; flush() writes what waits. Readers never see a channel of an instance that is
/// not there: channels come before the record says `active`, and go after it says otherwise. Used on one thread.
class RecordWriter {
 public:
  RecordWriter(discovery::Registry& registry, discovery::Paths paths) : registry_(registry), paths_(std::move(paths)) {}

  void put(const discovery::DriverRecord& record);
  /// Removes the record, its channels, and the driver's node when that was the last instance of it.
  void erase(const std::string& driver, const std::string& instance);
  /// \return whether all is written. Called after a reconnect and now and then.
  bool flush();

 private:
  struct Entry {
    std::string driver;                             ///< under which it is, or was, written
    std::optional<discovery::DriverRecord> wanted;  ///< nullopt: to be removed
    std::optional<std::set<std::string>> channels;  ///< in the registry; nullopt: not known yet
    /// As they were written last, while the record says `active`; nullopt: they have to be written.
    std::optional<std::vector<discovery::ChannelRecord>> shown;
    bool dirty = true;
  };
  bool write(const std::string& instance, Entry& entry);
  void write_record(const discovery::DriverRecord& record, Entry& entry);
  void remove_record(const std::string& driver, const std::string& instance);

  discovery::Registry& registry_;
  const discovery::Paths paths_;
  std::map<std::string, Entry> entries_;  ///< by instance
  bool told_away_ = false;
};

}  // namespace iotcloud::gateway

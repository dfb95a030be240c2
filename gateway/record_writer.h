#pragma once

#include <map>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include <iotcloud/discovery/records.h>
#include <iotcloud/discovery/registry.h>

namespace iotcloud::gateway {

/// Writes one gateway's driver and channel records to the registry. While the registry is unreachable it keeps the
/// latest record of each instance, which flush() writes later. A record that says `active` always has its channels:
/// they are written before the record says `active`, and removed after it says otherwise. When the driver's name
/// becomes known, the record under the former name goes after the new one is there. Used on one thread.
///
/// The records of this gateway in the registry show whether it is the registry that this gateway wrote to. So the
/// writer is paused, from the beginning and whenever the connection is lost, until the owner has looked at them.
class RecordWriter {
 public:
  RecordWriter(discovery::Registry& registry, discovery::Paths paths) : registry_(registry), paths_(std::move(paths)) {}

  void pause() { paused_ = true; }
  /// Ends the pause, and writes what is still to be written.
  void resume();
  /// Writes nothing any more.
  void close() { closed_ = true; }
  /// Finds the records that the registry lost, or has in another version than this writer wrote last; flush() puts them
  /// back. \throws discovery::RegistryError.
  void restore();
  /// The registry has a record of the instance under this driver, which this gateway wrote before it was started again.
  /// If the instance's record is written under another driver's name, or removed, this one is removed, too.
  void found(const discovery::DriverName& driver, const discovery::InstanceId& instance);
  /// Whether this writer has written a record of the instance.
  bool has_written(const discovery::InstanceId& instance) const;

  void put(const discovery::DriverRecord& record);
  /// Removes the record, its channels, and the driver's node if no other instance is below it.
  void erase(const discovery::DriverName& driver, const discovery::InstanceId& instance);
  /// \return whether everything is written. To be called after a reconnection, and periodically.
  bool flush();

 private:
  struct Entry {
    /// The drivers under which the registry has, or may have, a record of the instance. Until the plugin has told its
    /// driver's name, this is the plugin's name.
    std::set<discovery::DriverName> under;
    std::optional<discovery::DriverRecord> wanted;  ///< the record to write; nullopt: none is to be there
    std::optional<std::set<std::string>> channels;  ///< names of the channels in the registry; nullopt: not known yet
    /// The channels as last written for an `active` record; nullopt: they must be written.
    std::optional<std::vector<discovery::ChannelRecord>> shown;
    bool dirty = false;    ///< the wanted record is to be written
    bool stale = false;    ///< records under other drivers' names are to be removed
    bool written = false;  ///< the registry had it once
  };
  void want(Entry& entry, std::optional<discovery::DriverRecord> record);
  bool write(const discovery::InstanceId& instance, Entry& entry);
  void remove_unwanted(const discovery::InstanceId& instance, Entry& entry);
  void write_record(const discovery::DriverRecord& record, Entry& entry);
  void remove_record(const discovery::DriverName& driver, const discovery::InstanceId& instance);

  discovery::Registry& registry_;
  const discovery::Paths paths_;
  std::map<discovery::InstanceId, Entry> entries_;
  bool told_away_ = false;
  bool paused_ = true;
  bool closed_ = false;
};

}  // namespace iotcloud::gateway

#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/ids.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/topology/endpoints/placement/fair_shares.h>

namespace iotcloud::topology {

/// The workers that read one channel of a driver as one group, so that each message goes to one of them: the workers of
/// one topology, and those of other topologies whose YAML names the same `group`. Each worker has an ephemeral node in
/// the registry.
///
/// All members must read from the same broker and choose the same drivers; otherwise each could leave a driver to
/// another one that does not read it. So a member whose settings differ from those of the oldest member gets no share,
/// nor does one of a topology of the same name that another engine runs.
class ReadingGroup {
 public:
  struct Member {
    Sharer sharer;
    discovery::TopologyName topology;
    bool shares = false;        ///< its YAML names the group; false: only workers of its topology may be in the group
    std::string broker;         ///< the logical broker
    std::string where;          ///< as the YAML says it
    std::int64_t since_ms = 0;  ///< when it joined, Unix time
    std::string spouts;         ///< DriverUnits::description()
    std::string engine;         ///< discovery::ReaderRecord::engine
  };
  /// The workers among which the group's units are shared out.
  struct Shares {
    std::vector<Sharer> sharers;
    /// All of them have the same spouts of the driver (Member::spouts), so all know the same units of it.
    bool alike = false;
    std::string problem;  ///< why this worker gets no share, as a text for the log; empty: it gets one
  };
  using OnChange = std::function<void(const Shares& shares)>;

  /// Adds this worker to the group; the destructor removes it. \param path discovery::Paths::readers(). \param
  /// on_change is called on the registry's dispatcher, once soon and then after each change.
  ReadingGroup(discovery::Registry& registry, std::string path, Member self, OnChange on_change);
  ~ReadingGroup();

  /// The registry's node of the election for a unit.
  static std::string election(const std::string& path, const std::string& unit) { return path + "/units/" + unit; }
  /// Removes the group's records if the group has no members. Leaves in place what it cannot remove.
  static void clear_up(discovery::Registry& registry, const std::string& path) noexcept;

 private:
  void on_names(const std::vector<std::string>& names);
  void read();
  void read_again_soon();
  void tell(std::vector<Member> members);

  discovery::Registry& registry_;
  const std::string path_;
  const Member self_;
  const OnChange on_change_;
  std::vector<std::string> names_;  ///< the members' names; only the dispatcher uses it

  config::Mutex mutex_;
  bool over_ IOTCLOUD_GUARDED_BY(mutex_) = false;
  discovery::GuardPtr again_ IOTCLOUD_GUARDED_BY(mutex_);  ///< timer that calls read() after the registry was away
  discovery::GuardPtr member_;                             ///< this worker's node
  discovery::GuardPtr watch_;
};

}  // namespace iotcloud::topology

#pragma once

#include <cstdint>
#include <functional>
#include <mutex>
#include <string>
#include <vector>

#include <iotcloud/discovery/registry.h>
#include <iotcloud/topology/endpoints/placement/fair_shares.h>

namespace iotcloud::topology {

/// The workers that read one channel of a driver as one group, so that each message goes to one of them: those of one
/// topology, and those of others whose YAML names the same `group`. Each shows itself as an ephemeral node.
///
/// All must choose the same drivers, or nobody would read what one leaves to another: a member that says otherwise than
/// the longest standing one has no share.
class ReadingGroup {
 public:
  struct Member {
    Sharer sharer;
    std::string topology;
    bool shares = false;  ///< its YAML names the group; otherwise it is for the workers of that topology alone
    std::string broker;   ///< the logical name
    std::string where;    ///< as it stands in the YAML
    std::int64_t since_ms = 0;
  };
  /// \param problem why this worker has no share, for people; empty: it has one.
  using OnChange = std::function<void(const std::vector<Sharer>& sharers, const std::string& problem)>;

  /// Shows this worker. \param path discovery::Paths::readers(). \param on_change is called on the registry's
  /// dispatcher with those who share, soon and after each change.
  ReadingGroup(discovery::Registry& registry, std::string path, Member self, OnChange on_change);
  ~ReadingGroup();

  /// Where the election for a unit is held.
  static std::string election(const std::string& path, const std::string& unit) { return path + "/units/" + unit; }
  /// Takes the group's records away when nobody is in it. \throws nothing: what cannot be removed stays.
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
  std::vector<std::string> names_;  ///< of the dispatcher

  std::mutex mutex_;
  bool over_ = false;           ///< guarded by mutex_
  discovery::GuardPtr again_;   ///< guarded by mutex_: the members are read once more, the registry was away
  discovery::GuardPtr member_;  ///< this one's node
  discovery::GuardPtr watch_;
};

}  // namespace iotcloud::topology

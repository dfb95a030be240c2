#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include <iotcloud/discovery/description/fields.h>
#include <iotcloud/discovery/ids.h>
#include <iotcloud/processes/descriptor.h>

namespace iotcloud::gateway {

/// The last signed order, or removal of one, that a gateway followed for one instance.
struct FollowedOrder {
  discovery::InstanceId instance;
  std::int64_t given_ms = 0;  ///< when it was given, in its master's wall time
  /// `given_ms`, but no later than a little after the gateway's own wall time: a master whose clock is years ahead must
  /// not make the orders of all others old.
  std::int64_t counts_ms = 0;
  std::int64_t created = 0;  ///< of the order's node (discovery::Node)
  std::int64_t version = 0;  ///< of the order's node
  bool removed = false;      ///< the instance's order was removed; `created` and `version` say nothing
  static constexpr const char* what = "an order that was followed";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(instance, required),  IOTCLOUD_FIELD(given_ms, required),
                                            IOTCLOUD_FIELD(counts_ms, required), IOTCLOUD_FIELD(created, usual),
                                            IOTCLOUD_FIELD(version, usual),      IOTCLOUD_FIELD(removed, usual)};
  friend bool operator==(const FollowedOrder&, const FollowedOrder&) = default;
};

/// How far a gateway is with the signed orders of its masters, also after a restart: an order that is older than what
/// was followed is one that somebody wrote once more. A file with a JSON object on each line. Not thread safe; one
/// process at a time.
class FollowedOrders {
 public:
  /// \param file made when something is added; empty: this process only remembers. \throws config::Error if the file
  /// cannot be read or is damaged, but for a last line without its end, which a killed process left: what it says was
  /// not followed.
  explicit FollowedOrders(std::string file = "");

  /// Null: none is known. Valid until the next call of another function.
  const FollowedOrder* find(const discovery::InstanceId& instance) const;
  /// An order for an unknown instance counts as an old one that somebody wrote again if it was given before this time:
  /// this gateway has followed newer orders, and if that one had been there then, it would have followed it, too.
  std::int64_t oldest_of_unknown_ms() const;
  /// Adds orders; they are on the disk when this returns. \throws config::Error if they cannot be written; then nothing
  /// is added.
  void add(const std::vector<FollowedOrder>& orders);
  /// The token of the freeze (discovery::FreezeRecord) in which this gateway is; empty: in none.
  const std::string& freeze() const { return freeze_; }
  /// Keeps the token, or its absence, on the disk. \throws config::Error if it cannot be written; then nothing changes.
  void set_freeze(const std::string& token);
  /// Forgets all orders, also on the disk, because a master says that those of the registry are meant as they stand.
  /// \throws config::Error as set_freeze()
  void forget_all();

 private:
  using Known = std::map<discovery::InstanceId, FollowedOrder>;
  void load();
  void take(const FollowedOrder& order);
  void forget_old_removals();
  void replace(const Known& known, const std::string& freeze);

  const std::string file_;
  Known known_;
  std::string freeze_;
  std::int64_t newest_ms_ = 0;        ///< of all `counts_ms`
  processes::OwnedDescriptor lines_;  ///< the file, to append to it; empty: the next write replaces it
  std::size_t written_ = 0;           ///< lines in the file
};

}  // namespace iotcloud::gateway

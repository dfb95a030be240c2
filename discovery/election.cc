#include <algorithm>
#include <array>
#include <utility>

#include <iotcloud/config/log.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/client/path.h>
#include <iotcloud/discovery/client/turn.h>
#include <iotcloud/discovery/registry.h>

namespace iotcloud::discovery {
namespace {

using Names = std::vector<std::string>;

const config::Logger election_logger{"discovery.election"};
constexpr std::size_t sequence_digits = 10;
const std::string member_prefix = "member-";

/// The members' names, oldest first.
Names members_in_order(Names names) {
  std::erase_if(names, [](const std::string& name) {
    return name.size() != member_prefix.size() + sequence_digits || !name.starts_with(member_prefix);
  });
  std::sort(names.begin(), names.end());
  return names;
}

}  // namespace

/// With Succession::longest_standing every member holds a sequential node: the oldest leads, and each other member
/// watches only the one before it, so that a member that leaves wakes one other. With whoever_is_first all members try
/// to hold the same node, and its holder leads. Uses watches only, no calls: nothing here waits, and nothing is lost
/// while the registry is away. Everything but begin() and end() runs on the dispatcher, while it holds `turn`.
struct Election::Impl : TakesTurns<Impl> {
  Impl(Registry& r, std::string p, std::string d, Callbacks c, Succession s)
      : registry(r),
        path(std::move(p)),
        data(std::move(d)),
        callbacks(std::move(c)),
        in_line(s == Succession::longest_standing) {}

  /// Does not lock `turn`, because a user may construct under a lock that the callbacks take as well. The first report
  /// of the session, which comes at once, does the rest.
  void begin() {
    session_listener = registry.on_session(guarded([](Impl& self, SessionState state) {
      self.turn.assert_held();
      self.on_session(state);
    }));
  }

  void end() {
    // destroyed after `turn` is unlocked: their destructors wait for callbacks, which lock it
    std::array<GuardPtr, 5> dying;
    const DispatchTurnLock lock(turn);
    over = true;
    set_lead(std::nullopt);
    dying = {std::move(session_listener), std::move(predecessor_watch), std::move(list_watch), std::move(own_watch),
             std::move(hold)};
  }

  void stand() IOTCLOUD_REQUIRES(turn) {
    hold.reset();  // the old hold goes first: releasing it later would remove the new hold's node at the same path
    hold = registry.hold_eventually(in_line ? path + "/" + member_prefix : path, data, in_line,
                                    guarded([](Impl& self, const std::string& real_path) {
                                      self.turn.assert_held();
                                      self.on_standing(real_path);
                                    }));
  }

  /// The member's node exists, for the first time or again under a new name.
  void on_standing(const std::string& real_path) IOTCLOUD_REQUIRES(turn) {
    own_path = real_path;
    first = false;
    lose();
    if (over) return;
    watch_own_node();
    if (in_line) {
      find_place();
    } else {
      first = true;
    }
  }

  void watch_own_node() IOTCLOUD_REQUIRES(turn) {
    own_epoch = 0;
    own_watch = registry.watch_node(own_path, guarded([](Impl& self, const std::optional<Node>& node) {
                                      self.turn.assert_held();
                                      self.on_own_node(node);
                                    }));
  }

  void on_own_node(const std::optional<Node>& node) IOTCLOUD_REQUIRES(turn) {
    const bool own = node && node->data == data && (own_epoch == 0 || node->created == own_epoch);
    if (own) {
      own_epoch = node->created;
      decide();
      return;
    }
    // Somebody removed the node, or its session ended; the path may have another member's node by now. Stand again.
    own_path.clear();
    own_epoch = 0;
    first = false;
    lose();
    if (over) return;
    own_watch.reset();
    list_watch.reset();
    predecessor_watch.reset();
    stand();
  }

  /// Finds the member's place in line. It reads the list of members once; after that a watch of the predecessor's node
  /// suffices.
  void find_place() IOTCLOUD_REQUIRES(turn) {
    list_watch = registry.watch_children(path, guarded([](Impl& self, const std::optional<Names>& names) {
                                           self.turn.assert_held();
                                           self.on_members(members_in_order(names.value_or(Names())));
                                         }));
  }

  void on_members(const Names& members) IOTCLOUD_REQUIRES(turn) {
    const auto own = std::find(members.begin(), members.end(), name_of(own_path));
    if (own == members.end()) return;  // another callback follows, from this watch or from that of the own node
    list_watch.reset();
    if (own != members.begin()) {
      predecessor_watch =
          registry.watch_node(path + "/" + *std::prev(own), guarded([](Impl& self, const std::optional<Node>& node) {
                                self.turn.assert_held();
                                if (!node) self.find_place();
                              }));
      return;
    }
    predecessor_watch.reset();
    first = true;
    decide();
  }

  void on_session(SessionState state) IOTCLOUD_REQUIRES(turn) {
    if (!hold) stand();
    if (state == SessionState::connected) {
      if (!own_path.empty() && own_epoch == 0) watch_own_node();
    } else if (state != SessionState::connecting) {
      own_epoch = 0;  // whether the node still exists is not known before the next connection
      lose();
    }
  }

  void decide() IOTCLOUD_REQUIRES(turn) {
    if (!first || own_epoch == 0 || current_lead() || registry.session() != SessionState::connected) return;
    set_lead(Lead{own_epoch, {own_path}});
    election_logger.debug("{} leads {} (epoch {})", data, path, own_epoch);
    if (callbacks.on_elected) callbacks.on_elected(own_epoch);
  }

  void lose() IOTCLOUD_REQUIRES(turn) {
    if (!set_lead(std::nullopt)) return;
    election_logger.debug("{} leads {} no longer", data, path);
    if (callbacks.on_lost) callbacks.on_lost();
  }

  std::optional<Lead> current_lead() const {
    const config::MutexLock lock(lead_mutex);
    return lead;
  }

  /// \return the old value.
  std::optional<Lead> set_lead(std::optional<Lead> now) {
    const config::MutexLock lock(lead_mutex);
    return std::exchange(lead, std::move(now));
  }

  Registry& registry;
  const std::string path;
  const std::string data;
  const Callbacks callbacks;
  const bool in_line;

  mutable config::Mutex lead_mutex;
  std::optional<Lead> lead IOTCLOUD_GUARDED_BY(lead_mutex);  ///< nullopt: this member does not lead

  std::string own_path IOTCLOUD_GUARDED_BY(turn);        ///< empty: this member does not stand
  std::int64_t own_epoch IOTCLOUD_GUARDED_BY(turn) = 0;  ///< 0: unknown
  bool first IOTCLOUD_GUARDED_BY(turn) = false;          ///< no member is before this one
  GuardPtr session_listener;                             ///< set by begin(), read by end() only
  GuardPtr hold IOTCLOUD_GUARDED_BY(turn);
  GuardPtr own_watch IOTCLOUD_GUARDED_BY(turn);
  GuardPtr list_watch IOTCLOUD_GUARDED_BY(turn);
  GuardPtr predecessor_watch IOTCLOUD_GUARDED_BY(turn);
};

Election::Election(Registry& registry, std::string path, std::string data, Callbacks callbacks, Succession succession)
    : impl_(std::make_shared<Impl>(registry, std::move(path), std::move(data), std::move(callbacks), succession)) {
  impl_->begin();
}

Election::~Election() {
  impl_->end();
}

bool Election::leading() const {
  if (!impl_->current_lead()) return false;
  const SessionState state = impl_->registry.session();
  return state == SessionState::connected || state == SessionState::connecting;
}

std::optional<Lead> Election::lead() const {
  if (!impl_->in_line) return std::nullopt;
  auto lead = impl_->current_lead();
  return lead && leading() ? std::move(lead) : std::nullopt;
}

std::string Election::leader_data() const {
  try {
    if (!impl_->in_line) {
      const auto node = impl_->registry.get(impl_->path);
      return node ? node->data : std::string();
    }
    for (;;) {
      const Names members = members_in_order(impl_->registry.children(impl_->path).value_or(Names()));
      if (members.empty()) return {};
      if (const auto node = impl_->registry.get(impl_->path + "/" + members.front())) return node->data;
    }
  } catch (const RegistryError& error) {
    election_logger.debug("{}: who leads is not known: {}", impl_->path, error.what());
    return {};
  }
}

}  // namespace iotcloud::discovery

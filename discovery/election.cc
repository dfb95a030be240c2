#include <algorithm>
#include <array>
#include <mutex>
#include <utility>

#include <iotcloud/config/log.h>
#include <iotcloud/discovery/client/path.h>
#include <iotcloud/discovery/registry.h>

namespace iotcloud::discovery {
namespace {

using Names = std::vector<std::string>;

const config::Logger log{"discovery.election"};
constexpr std::size_t sequence_digits = 10;
const std::string member_prefix = "member-";

/// The members' names, longest standing first.
Names members_in_order(Names names) {
  std::erase_if(names, [](const std::string& name) {
    return name.size() != member_prefix.size() + sequence_digits || !name.starts_with(member_prefix);
  });
  std::sort(names.begin(), names.end());
  return names;
}

}  // namespace

/// In a line of succession every member holds a sequential node; the first in order leads, the others watch the one
/// before them only, so that a member that goes wakes one other. Without one all members want to hold the same node,
/// and the one that does leads. Watches only, no calls: nothing here waits, and nothing is lost when the registry is
/// away. Everything but the beginning and the end runs on the dispatcher, in its turn.
struct Election::Impl : std::enable_shared_from_this<Impl> {
  Impl(Registry& r, std::string p, std::string d, Callbacks c, Succession s)
      : registry(r),
        path(std::move(p)),
        data(std::move(d)),
        callbacks(std::move(c)),
        in_line(s == Succession::longest_standing) {}

  /// A callback that runs in its turn, and does nothing once the election is over.
  template <typename Function>
  auto guarded(Function function) {
    return [weak = weak_from_this(), function](const auto& argument) {
      const auto self = weak.lock();
      if (!self) return;
      const std::lock_guard lock(self->turn);
      if (!self->over) function(*self, argument);
    };
  }

  /// Takes no turn (a user may construct under a lock that his callbacks take as well): the first word about the
  /// session, which comes at once, does the rest.
  void begin() {
    session_listener = registry.on_session(guarded([](Impl& self, SessionState state) { self.on_session(state); }));
  }

  void end() {
    std::array<GuardPtr, 5> dying;  // they die after the turn: their destructors wait for callbacks, which want it
    const std::lock_guard lock(turn);
    over = true;
    set_lead(std::nullopt);
    dying = {std::move(session_listener), std::move(predecessor_watch), std::move(list_watch), std::move(own_watch),
             std::move(hold)};
  }

  void stand() {
    hold.reset();  // of two holds of one node the later would lose it when the earlier goes
    hold = registry.hold_eventually(
        in_line ? path + "/" + member_prefix : path, data, in_line,
        guarded([](Impl& self, const std::string& real_path) { self.on_standing(real_path); }));
  }

  /// The member's node is there, for the first time or again under a new name.
  void on_standing(const std::string& real_path) {
    own_path = real_path;
    first = false;
    lose();
    if (over) return;
    watch_own_node();
    if (in_line) {
      look();
    } else {
      first = true;
    }
  }

  void watch_own_node() {
    own_epoch = 0;
    own_watch = registry.watch_node(
        own_path, guarded([](Impl& self, const std::optional<Node>& node) { self.on_own_node(node); }));
  }

  void on_own_node(const std::optional<Node>& node) {
    const bool own = node && node->data == data && (own_epoch == 0 || node->created == own_epoch);
    if (own) {
      own_epoch = node->created;
      decide();
      return;
    }
    // Removed by somebody else, or with a session that is over, and perhaps another's by now: stand again.
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

  /// Finds the member's place. The list is wanted once; what comes afterwards the predecessor tells.
  void look() {
    list_watch = registry.watch_children(path, guarded([](Impl& self, const std::optional<Names>& names) {
                                           self.on_members(members_in_order(names.value_or(Names())));
                                         }));
  }

  void on_members(const Names& members) {
    const auto own = std::find(members.begin(), members.end(), name_of(own_path));
    if (own == members.end()) return;  // another callback follows, of this watch or of the own node's
    list_watch.reset();
    if (own != members.begin()) {
      predecessor_watch =
          registry.watch_node(path + "/" + *std::prev(own), guarded([](Impl& self, const std::optional<Node>& node) {
                                if (!node) self.look();
                              }));
      return;
    }
    predecessor_watch.reset();
    first = true;
    decide();
  }

  void on_session(SessionState state) {
    if (!hold) stand();
    if (state == SessionState::connected) {
      if (!own_path.empty() && own_epoch == 0) watch_own_node();
    } else if (state != SessionState::connecting) {
      own_epoch = 0;  // whether the node outlives this has to be seen
      lose();
    }
  }

  void decide() {
    if (!first || own_epoch == 0 || current_lead() || registry.session() != SessionState::connected) return;
    set_lead(Lead{own_epoch, {own_path}});
    log.debug("{} leads {} (epoch {})", data, path, own_epoch);
    if (callbacks.on_elected) callbacks.on_elected(own_epoch);
  }

  void lose() {
    if (!set_lead(std::nullopt)) return;
    log.debug("{} leads {} no longer", data, path);
    if (callbacks.on_lost) callbacks.on_lost();
  }

  std::optional<Lead> current_lead() const {
    const std::lock_guard lock(lead_mutex);
    return lead;
  }

  /// \return what it was before.
  std::optional<Lead> set_lead(std::optional<Lead> now) {
    const std::lock_guard lock(lead_mutex);
    return std::exchange(lead, std::move(now));
  }

  Registry& registry;
  const std::string path;
  const std::string data;
  const Callbacks callbacks;
  const bool in_line;

  mutable std::mutex lead_mutex;
  std::optional<Lead> lead;  ///< nullopt: it does not lead; guarded by lead_mutex

  /// Held while a callback runs. Recursive, so that the election may be destroyed by its own callback.
  std::recursive_mutex turn;
  // Guarded by turn:
  bool over = false;
  std::string own_path;        ///< empty: not standing
  std::int64_t own_epoch = 0;  ///< 0: not known, or not known any more
  bool first = false;          ///< nobody stands before
  GuardPtr session_listener;   ///< set by begin(), looked at by end() only
  GuardPtr hold, own_watch, list_watch, predecessor_watch;
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
    log.debug("{}: who leads is not known: {}", impl_->path, error.what());
    return {};
  }
}

}  // namespace iotcloud::discovery

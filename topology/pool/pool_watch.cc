#include <chrono>
#include <set>
#include <utility>
#include <vector>

#include <fmt/format.h>

#include <iotcloud/config/metrics.h>
#include <iotcloud/config/mutex.h>
#include <iotcloud/discovery/order_times.h>
#include <iotcloud/security/signed_object.h>
#include <iotcloud/topology/pool/logger.h>
#include <iotcloud/topology/pool/pool_watch.h>

namespace iotcloud::topology {

using discovery::PoolId;
using discovery::StandingSubmission;
using discovery::Submission;
using discovery::TopologyName;
using Names = std::optional<std::vector<std::string>>;

namespace {

/// Several changes that come together are looked at once.
constexpr std::chrono::milliseconds gathering{10};
constexpr std::chrono::milliseconds retry_pause{500};

}  // namespace

/// Its functions run on the registry's dispatcher, but for look_soon().
struct PoolWatch::Impl : std::enable_shared_from_this<Impl> {
  explicit Impl(Options given) : options(std::move(given)) {}

  void begin() {
    guards.push_back(options.registry->watch_children(
        options.paths.pools, later<const Names&>([](Impl& self, const Names& names) {
          self.follow(names, self.pools,
                      [&](const std::string& name) { return self.options.paths.pools + "/" + name; });
        })));
    guards.push_back(options.registry->watch_children(
        options.paths.submissions,
        later<const Names&>([](Impl& self, const Names& names) { self.follow_submissions(names); })));
  }

  /// A callback that does nothing any more when the watch is gone.
  template <typename Argument, typename Use>
  std::function<void(Argument)> later(Use use) {
    return [weak = weak_from_this(), use](Argument argument) {
      if (const auto self = weak.lock()) use(*self, argument);
    };
  }

  using NodeGuards = std::map<std::string, discovery::GuardPtr>;

  /// Watches the node of each name, and none of others.
  template <typename PathOf>
  void follow(const Names& names, NodeGuards& watched, PathOf&& path_of) {
    const std::set<std::string> now(names ? names->begin() : std::vector<std::string>::const_iterator{},
                                    names ? names->end() : std::vector<std::string>::const_iterator{});
    std::erase_if(watched, [&](const auto& one) { return !now.contains(one.first); });
    for (const auto& name : now) {
      auto& guard = watched[name];
      if (guard) continue;
      guard = options.registry->watch_node(
          path_of(name),
          later<const std::optional<discovery::Node>&>([](Impl& self, const auto& /*node*/) { self.look_soon(); }));
    }
    look_soon();
  }

  void follow_submissions(const Names& names) {
    follow(names, submissions, [&](const std::string& name) { return options.paths.submission(TopologyName(name)); });
    std::erase_if(places, [&](const auto& one) { return !submissions.contains(one.first); });
    for (const auto& [name, guard] : submissions) {
      auto& of_places = places[name];
      if (of_places) continue;
      of_places =
          options.registry->watch_children(options.paths.places(TopologyName(name)),
                                           later<const Names&>([](Impl& self, const Names&) { self.look_soon(); }));
    }
  }

  void look_soon() { look_after(gathering); }

  void look_after(std::chrono::milliseconds pause) {
    discovery::GuardPtr before;  // ends without the lock, which its callback may wait for
    const config::MutexLock lock(mutex);
    if (closed || std::exchange(planned, true)) return;
    before = std::exchange(look_guard, options.registry->after(pause, [weak = weak_from_this()] {
      if (const auto self = weak.lock()) self->look();
    }));
  }

  void look() {
    {
      const config::MutexLock lock(mutex);
      if (closed) return;
      planned = false;
    }
    PoolView view;
    std::string trouble;
    try {
      view.pools = discovery::list_pools(*options.registry, options.paths);
      auto standing = discovery::list_submissions(*options.registry, options.paths);
      trouble = accept(standing);
      std::vector<TopologyName> topologies;
      for (const auto& [name, submission] : accepted) {
        topologies.push_back(name);
        view.submissions.emplace(name, submission);
      }
      view.holders = discovery::list_holders(*options.registry, options.paths, topologies);
    } catch (const discovery::RegistryError& error) {
      pool_logger.debug("the registry is read when it answers: {}", error.what());
      return look_after(retry_pause);
    }
    options.on_view(std::move(view), std::move(trouble));
  }

  /// Takes up what stands in the registry. \return what is refused; empty: nothing
  std::string accept(const std::map<TopologyName, StandingSubmission>& standing) {
    std::string trouble;
    for (const auto& [name, one] : standing) {
      const auto before = accepted.find(name);
      if (before != accepted.end() && before->second == one.submission) continue;
      const std::string why = objection(one, before == accepted.end() ? nullptr : &before->second);
      if (why.empty()) {
        accepted.insert_or_assign(name, one.submission);
        told.erase(name);
        continue;
      }
      const std::string text = fmt::format("the submission of topology {} is refused: {}", name, why);
      trouble += (trouble.empty() ? "" : "; ") + text;
      if (std::exchange(told[name], text) == text) continue;
      pool_logger.error("{}", text);
      config::process_metrics()
          .counter("iotcloud_pool_submissions_refused_total", "Submissions that no trusted master gave now")
          .add();
    }
    std::erase_if(told, [&](const auto& one) { return !standing.contains(one.first); });
    // A topology whose end was marked is forgotten with its mark; what else vanishes goes on as it was.
    std::erase_if(accepted, [&](const auto& one) { return one.second.killed && !standing.contains(one.first); });
    return trouble;
  }

  /// Why a submission must not be followed; empty: it may.
  std::string objection(const StandingSubmission& standing, const Submission* before) const {
    const auto& submission = standing.submission;
    if (before != nullptr && submission.epoch < before->epoch) return "a later master has given another one";
    if (!options.masters) return "";
    const std::string path = options.paths.submission(submission.name);
    if (security::signer_of_object(*options.masters, path, standing.node.data).empty())
      return "no trusted master has signed it for this topology";
    if (before != nullptr && submission.given_ms < before->given_ms)
      return "a master has signed it, but it is out of date: it was given before the last one";
    if (discovery::written_late(standing.node, submission.given_ms))
      return "a master has signed it, but long before it was written here: somebody wrote an old one once more, or "
             "copied the registry; if it is meant, `iotcloud topology update` it";
    return "";
  }

  const Options options;
  config::Mutex mutex;
  bool planned IOTCLOUD_GUARDED_BY(mutex) = false;
  bool closed IOTCLOUD_GUARDED_BY(mutex) = false;  ///< no look begins any more
  discovery::GuardPtr look_guard IOTCLOUD_GUARDED_BY(mutex);

  // Used on the registry's dispatcher only, but for construction and destruction.
  std::map<TopologyName, Submission> accepted;
  std::map<TopologyName, std::string> told;  ///< what was told of refused ones that still stand
  NodeGuards pools, submissions, places;
  std::vector<discovery::GuardPtr> guards;
};

PoolWatch::PoolWatch(Options options) : impl_(std::make_shared<Impl>(std::move(options))) {
  if (impl_->options.masters)
    keys_watch_ = impl_->options.masters->on_change([impl = impl_.get()] { impl->look_soon(); });
  impl_->begin();
}

PoolWatch::~PoolWatch() {
  keys_watch_ = {};
  impl_->guards.clear();  // nobody follows names any more
  for (auto* watched : {&impl_->pools, &impl_->submissions, &impl_->places}) watched->clear();
  discovery::GuardPtr last_look;
  const config::MutexLock lock(impl_->mutex);
  impl_->closed = true;
  last_look = std::move(impl_->look_guard);
}

}  // namespace iotcloud::topology

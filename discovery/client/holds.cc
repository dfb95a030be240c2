#include <algorithm>
#include <utility>

#include <iotcloud/discovery/client/holds.h>
#include <iotcloud/discovery/client/path.h>
#include <iotcloud/discovery/logger.h>

namespace iotcloud::discovery {
namespace {

constexpr std::chrono::milliseconds hold_retry_pause{50};
/// Pause before the next attempt when the registry refused the last one for a reason that only a person can remove.
constexpr std::chrono::milliseconds refused_pause{1000};

}  // namespace

void Holds::add(const HoldPtr& hold) {
  holds_.insert(hold);
  step(hold);
}

void Holds::release(const HoldPtr& hold) {
  hold->released = true;
  const auto [begin, end] = waiting_.equal_range(hold->path);
  const auto place = std::find_if(begin, end, [&](const auto& entry) { return entry.second == hold; });
  if (place != end) waiting_.erase(place);
  step(hold);
}

void Holds::connected(std::int64_t session) {
  connected_ = true;
  if (std::exchange(session_, session) != session) taken_.clear();
  waiting_.clear();  // all of them try again
  const std::vector<HoldPtr> all(holds_.begin(), holds_.end());
  for (const HoldPtr& hold : all) step(hold);
}

/// Takes a hold's next step, unless an operation is under way.
void Holds::step(const HoldPtr& hold) {
  if (hold->busy) return;
  if (hold->session != session_) {  // the old session's nodes are gone
    forget_node(hold);
    hold->in_doubt = false;
  }
  const bool exists = !hold->real_path.empty();
  if (hold->released && !exists && !hold->in_doubt) {
    holds_.erase(hold);
  } else if (!connected_) {
    return;  // connected() calls this again
  } else if (hold->in_doubt) {
    resolve_doubt(hold);
  } else if (hold->released) {
    remove(hold);
  } else if (!exists) {
    create(hold);
  }
}

void Holds::step_later(const HoldPtr& hold, std::chrono::milliseconds pause) {
  hold->busy = true;
  worker_.post_at(std::chrono::steady_clock::now() + pause, [this, hold] {
    hold->busy = false;
    step(hold);
  });
}

Done Holds::on_worker(std::function<void(Reply)> next) {
  return [this, next = std::move(next)](Reply reply) {
    worker_.post([next, reply = std::move(reply)]() mutable { next(std::move(reply)); });
  };
}

void Holds::create(const HoldPtr& hold) {
  hold->busy = true;
  const std::string parent = parent_of(hold->path);
  const bool leads_the_way = !hold->parent_known;
  if (leads_the_way) {
    const auto [followers, none] = behind_.try_emplace(parent);
    if (!none) {
      followers->second.push_back(hold);
      return;
    }
  }
  hold->session = session_;
  connection_.create(hold->path, hold->data, true, hold->sequential, {},
                     on_worker([this, hold, parent, leads_the_way](const Reply& reply) {
                       hold->busy = false;
                       created(hold, reply);
                       if (leads_the_way && reply.status != ReplyStatus::no_node) let_through(parent);
                     }));
}

void Holds::let_through(const std::string& parent) {
  const auto followers = behind_.extract(parent);
  if (followers.empty()) return;
  for (const HoldPtr& hold : followers.mapped()) {
    hold->busy = false;
    hold->parent_known = true;
    step(hold);
  }
}

void Holds::created(const HoldPtr& hold, const Reply& reply) {
  switch (reply.status) {
    case ReplyStatus::ok:
      if (taken(reply.path)) {  // another hold took this node: take the one that it created
        hold->in_doubt = true;
        step(hold);
      } else {
        settle(hold, reply.path);
      }
      return;
    case ReplyStatus::no_node:
      hold->busy = true;
      make_parents(hold->path, [this, hold](ReplyStatus status) {
        hold->busy = false;
        let_through(parent_of(hold->path));
        if (status == ReplyStatus::ok) {
          hold->parent_known = true;
          step(hold);
        } else if (status == ReplyStatus::away) {
          step_later(hold, hold_retry_pause);
        } else {
          refused(hold, status);
        }
      });
      return;
    case ReplyStatus::away:
      hold->in_doubt = true;
      step_later(hold, hold_retry_pause);
      return;
    default:
      refused(hold, reply.status);
  }
}

/// The node exists and is ours.
void Holds::settle(const HoldPtr& hold, const std::string& real_path) {
  if (hold->session != session_) {  // it belongs to a session that is over
    step(hold);
    return;
  }
  hold->in_doubt = false;
  hold->complained = false;
  hold->real_path = real_path;
  hold->suspect = false;
  hold->parent_known = true;
  taken_[real_path] = hold;
  if (hold->released) {
    step(hold);
    return;
  }
  hold->on_created->deliver_each(dispatcher_, real_path);
  if (auto answer = std::exchange(hold->first_answer, nullptr)) answer(ReplyStatus::ok);
}

void Holds::refused(const HoldPtr& hold, ReplyStatus status) {
  if (auto answer = std::exchange(hold->first_answer, nullptr)) {
    holds_.erase(hold);
    answer(status);
    return;
  }
  if (!std::exchange(hold->complained, true)) {
    logger.warn("{} cannot be created for now: {}", hold->path,
                status == ReplyStatus::exists ? "another session's node stands there; waiting for it to go"
                : status == ReplyStatus::denied
                    ? "what stands above it belongs to another user of the registry (or no master has made it yet); "
                      "trying on"
                    : "the registry refuses; trying on");
  }
  if (status == ReplyStatus::exists) {
    wait_for_place(hold);
  } else {
    step_later(hold, refused_pause);
  }
}

/// Another session's node is at the path (that of a process which died a moment ago, say). Watches it until it is gone.
/// When this client gets a new session, the hold starts again from the beginning.
void Holds::wait_for_place(const HoldPtr& hold) {
  hold->busy = true;
  connection_.get(hold->path, true, on_worker([this, hold, session = session_](const Reply& reply) {
                    hold->busy = false;
                    if (reply.status == ReplyStatus::ok && session == session_ && !hold->released) {
                      waiting_.emplace(hold->path, hold);
                    } else if (reply.status == ReplyStatus::away) {
                      step_later(hold, hold_retry_pause);
                    } else {
                      step(hold);
                    }
                  }));
}

void Holds::changed(const std::string& path) {
  if (const auto held = taken_.find(path); held != taken_.end()) held->second->suspect = true;
  const auto [begin, end] = waiting_.equal_range(path);
  std::vector<HoldPtr> woken;
  for (auto place = begin; place != end; ++place) woken.push_back(place->second);
  waiting_.erase(begin, end);
  for (const HoldPtr& hold : woken) step(hold);
}

void Holds::remove(const HoldPtr& hold) {
  if (!hold->suspect) {
    remove_own(hold);
    return;
  }
  hold->busy = true;
  connection_.get(hold->real_path, false, on_worker([this, hold](const Reply& reply) {
                    hold->busy = false;
                    if (reply.status == ReplyStatus::away) {
                      step_later(hold, hold_retry_pause);
                    } else if (reply.status == ReplyStatus::ok && reply.node.owner_session == hold->session) {
                      remove_own(hold);
                    } else {
                      forget_node(hold);
                      step(hold);
                    }
                  }));
}

void Holds::remove_own(const HoldPtr& hold) {
  hold->busy = true;
  connection_.remove(hold->real_path, -1, {}, on_worker([this, hold](const Reply& reply) {
                       hold->busy = false;
                       if (reply.status == ReplyStatus::away) {
                         step_later(hold, hold_retry_pause);
                       } else {
                         forget_node(hold);
                         step(hold);
                       }
                     }));
}

void Holds::forget_node(const HoldPtr& hold) {
  const auto place = taken_.find(hold->real_path);
  if (place != taken_.end() && place->second == hold) taken_.erase(place);
  hold->real_path.clear();
}

/// Looks for the node that was created if the creation whose answer was lost took effect.
void Holds::resolve_doubt(const HoldPtr& hold) {
  if (!hold->sequential) {
    look_at(hold, {hold->path});
    return;
  }
  hold->busy = true;
  connection_.children(parent_of(hold->path), false, on_worker([this, hold](const Reply& reply) {
                         hold->busy = false;
                         if (reply.status == ReplyStatus::away) {
                           step_later(hold, hold_retry_pause);
                           return;
                         }
                         const std::string parent = parent_of(hold->path);
                         std::vector<std::string> candidates;
                         for (const std::string& name : reply.names) {
                           std::string path = child_of(parent, name);
                           if (path.size() == hold->path.size() + 10 && path.starts_with(hold->path)) {
                             candidates.push_back(std::move(path));
                           }
                         }
                         look_at(hold, std::move(candidates));
                       }));
}

void Holds::look_at(const HoldPtr& hold, std::vector<std::string> candidates) {
  while (!candidates.empty() && taken(candidates.back())) candidates.pop_back();
  if (candidates.empty()) {  // it was not created
    hold->in_doubt = false;
    step(hold);
    return;
  }
  const std::string path = std::move(candidates.back());
  candidates.pop_back();
  hold->busy = true;
  connection_.get(path, false, on_worker([this, hold, path, candidates](const Reply& reply) {
                    hold->busy = false;
                    if (reply.status == ReplyStatus::away) {
                      step_later(hold, hold_retry_pause);
                    } else if (reply.status == ReplyStatus::ok && reply.node.owner_session == hold->session &&
                               reply.node.data == hold->data && !taken(path)) {
                      settle(hold, path);
                    } else {
                      look_at(hold, candidates);
                    }
                  }));
}

void Holds::make_parents(const std::string& path, const std::function<void(ReplyStatus)>& next) {
  const std::string parent = parent_of(path);
  connection_.create(parent, "", false, false, {}, on_worker([this, path, parent, next](const Reply& reply) {
                       if (reply.status == ReplyStatus::no_node && parent != "/") {
                         make_parents(parent, [this, path, next](ReplyStatus status) {
                           if (status == ReplyStatus::ok) {
                             make_parents(path, next);
                           } else {
                             next(status);
                           }
                         });
                       } else {
                         next(reply.status == ReplyStatus::exists ? ReplyStatus::ok : reply.status);
                       }
                     }));
}

}  // namespace iotcloud::discovery

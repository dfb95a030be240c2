#include <algorithm>
#include <utility>

#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/topology/pool/logger.h>
#include <iotcloud/topology/pool/pool.h>

namespace iotcloud::topology {

using discovery::PlaceId;
using discovery::Submission;
using std::chrono::milliseconds;

namespace {

/// How long, after the time that a kill order gives, a worker has to close and to end before its pool ends it.
constexpr milliseconds kill_margin{5000};
constexpr milliseconds clean_pause{60000};
/// Of the time in which the pool is to stop: for workers that must be killed to end.
constexpr milliseconds death_reserve{3000};

std::string text_of(const PlaceId& place) {
  return fmt::format("place {} of topology {}", place.number, place.topology);
}

}  // namespace

Pool::Pool(PoolOptions options)
    : options_(std::move(options)),
      presence_(*options_.registry, options_.paths, options_.record),
      fleet_(*options_.launcher, {.restart = options_.restart,
                                  .stop_limit = options_.stop_limit,
                                  .clock = &config::system_clock(),
                                  .post = [this](std::function<void()> task) { post(std::move(task)); },
                                  .on_change = [this] { to_show_ = true; }}) {}

Pool::~Pool() {
  stop(milliseconds{5000});
}

void Pool::start(const std::stop_token& stop) {
  bool answers = true;  // an absent registry must not be waited for once for each place
  for (const auto& place : fleet_.adopt()) {
    answers = answers && remove_former(place);
    claims_[place].held = true;
    claim(place);
  }
  presence_.show(fleet_.states(), options_.libraries->all(), "");
  presence_.join(options_.session_timeout + options_.session_timeout / 2, stop);
  thread_ = std::jthread([this](const std::stop_token& end) { run(end); });
  watch_ = std::make_unique<PoolWatch>(PoolWatch::Options{
      options_.registry, options_.paths, options_.masters, [this](PoolView view, std::string trouble) {
        post([this, view = std::move(view), trouble = std::move(trouble)]() mutable {
          look(std::move(view), std::move(trouble));
        });
      }});
}

void Pool::post(std::function<void()> task) {
  const config::MutexLock lock(mutex_);
  tasks_.push_back(std::move(task));
  changed_.notify_all();
}

void Pool::run(const std::stop_token& stop) {
  auto clean_at = std::chrono::steady_clock::now() + clean_pause;
  while (!stop.stop_requested()) {
    const auto due = fleet_.do_due();
    if (std::exchange(to_show_, false)) show();
    std::vector<std::function<void()>> tasks;
    {
      const config::MutexLock lock(mutex_);
      changed_.wait_until(mutex_, stop, std::min(due.value_or(clean_at), clean_at),
                          [this]() IOTCLOUD_REQUIRES(mutex_) { return !tasks_.empty(); });
      tasks.swap(tasks_);
    }
    for (const auto& task : tasks) attempt(task);
    if (to_show_ && view_ && !leaving_) follow();  // a worker has ended, or runs: its place may go to another pool
    if (leaving_) leave();
    if (std::chrono::steady_clock::now() < clean_at) continue;
    clean_at = std::chrono::steady_clock::now() + clean_pause;
    clean_libraries();
  }
}

/// Runs a task; one that fails leaves the others alone.
void Pool::attempt(const std::function<void()>& task) {
  try {
    task();
  } catch (const std::exception& error) {
    pool_logger.error("the pool could not follow what it saw, and looks again with the next change: {}", error.what());
  }
}

/// Gives up the places whose workers have ended.
void Pool::leave() {
  std::erase_if(claims_, [&](const auto& one) { return !fleet_.has(one.first); });
  const config::MutexLock lock(mutex_);
  gone_ = fleet_.states().empty();
  changed_.notify_all();
}

void Pool::look(PoolView view, std::string trouble) {
  if (leaving_) return;
  view_ = std::move(view);
  // The record that was read may be older than what it says: after a lost session the registry has the first one again.
  for (auto& pool : view_->pools) {
    if (is_this(pool)) pool.files = options_.libraries->all();
  }
  {
    const config::MutexLock lock(mutex_);
    refused_ = std::move(trouble);
  }
  to_show_ = true;
  follow();
}

bool Pool::is_this(const discovery::PoolRecord& pool) const {
  return pool.id == options_.record.id && pool.state_id == options_.record.state_id;
}

/// Makes it so that this pool runs its share.
void Pool::follow() {
  const auto is_mine = [this](const auto& pool) { return is_this(pool); };
  if (std::none_of(view_->pools.begin(), view_->pools.end(), is_mine)) return;  // not joined, or cut off: nothing moves
  const auto shared = share_places(*view_);
  std::set<PlaceId> places;
  for (const auto& [place, pool] : shared) {
    if (pool == options_.record.id) places.insert(place);
  }
  for (const auto& [place, one] : claims_) places.insert(place);
  for (const auto& place : places) {
    const auto share = shared.find(place);
    follow(place, share == shared.end() ? nullptr : &share->second);
  }
  let_go(shared);
}

/// \param whose the pool whose share the place is; nullptr: nobody's
void Pool::follow(const PlaceId& place, const discovery::PoolId* whose) {
  const auto submitted = view_->submissions.find(place.topology);
  if (submitted == view_->submissions.end()) return;  // the registry has lost it: what runs goes on
  const Submission& submission = submitted->second;
  if (submission.killed) return fleet_.let_end(place, milliseconds(submission.drain_ms) + kill_margin);
  const auto holder = view_->holders.find(place);
  const bool of_another = holder != view_->holders.end() && holder->second.pool != options_.record.id;
  const auto claimed = claims_.find(place);
  const bool was_taken = of_another && claimed != claims_.end() && std::exchange(claimed->second.held, false);
  const bool is_wanted = place.number < submission.workers;
  const bool is_mine = whose != nullptr && *whose == options_.record.id;
  if (!is_wanted || (whose != nullptr && !is_mine) || was_taken) {
    // To another pool, or one worker less: when the worker has ended, let_go() gives the place up.
    fleet_.end(place);
    return;
  }
  if (!is_mine) return;  // no pool can run what is wanted now: what runs goes on
  claim(place);
  const auto& version = submission.version_of(place.number);
  if (claims_.at(place).held) fleet_.run({place, version, version.number < submission.last_number});
}

std::string Pool::holder() const {
  return discovery::encode(discovery::PlaceHolder{options_.record.id, options_.record.state_id});
}

/// Removes the node by which a former run of this pool held a place. \return false if the registry is away
bool Pool::remove_former(const PlaceId& place) {
  const std::string path = options_.paths.place(place.topology, place.number);
  try {
    const auto there = options_.registry->get(path);
    if (there && there->data == holder()) options_.registry->remove(path, there->version);
  } catch (const discovery::RegistryError& error) {
    pool_logger.debug("{} is held when the registry answers: {}", text_of(place), error.what());
    return error.code() != discovery::RegistryErrorCode::away;
  }
  return true;
}

/// Asks for a place, unless this pool holds it or asks for it already.
void Pool::claim(const PlaceId& place) {
  auto& claim = claims_[place];
  if (claim.node) return;
  const std::string path = options_.paths.place(place.topology, place.number);
  claim.node = options_.registry->hold_eventually(path, holder(), false, [this, place](const std::string& /*path*/) {
    post([this, place] {
      const auto found = claims_.find(place);
      if (found == claims_.end()) return;
      found->second.held = true;
      if (!view_ || leaving_) return;
      view_->holders[place] = {options_.record.id, options_.record.state_id};  // what was seen last may be older
      follow();
    });
  });
}

/// Gives up the places that have no worker and are not this pool's to run.
void Pool::let_go(const std::map<PlaceId, discovery::PoolId>& shared) {
  std::erase_if(claims_, [&](const auto& one) {
    const auto mine = shared.find(one.first);
    return !fleet_.has(one.first) && (mine == shared.end() || mine->second != options_.record.id);
  });
}

void Pool::show() {
  auto states = fleet_.states();
  for (auto& state : states) state.pool = options_.record.id;
  std::string trouble;
  {
    const config::MutexLock lock(mutex_);
    shown_ = states;
    trouble = refused_;
  }
  auto& metrics = config::process_metrics();
  metrics.gauge("iotcloud_pool_places", "Worker places that this pool has")
      .set(static_cast<std::int64_t>(states.size()));
  metrics.gauge("iotcloud_pool_workers", "Of them, those whose worker runs")
      .set(std::count_if(states.begin(), states.end(), [](const auto& place) { return place.state == "running"; }));
  presence_.show(std::move(states), options_.libraries->all(), std::move(trouble));
}

void Pool::clean_libraries() {
  if (!view_) return;
  std::set<std::string> named;
  for (const auto& [name, submission] : view_->submissions) {
    if (submission.killed) continue;
    for (const auto& library : submission.version.libraries) named.insert(library.sha256);
    if (!submission.previous) continue;
    for (const auto& library : submission.previous->libraries) named.insert(library.sha256);
  }
  options_.libraries->clean(named);
  to_show_ = true;
}

void Pool::take_library() {
  post([this] { to_show_ = true; });
}

void Pool::stop(milliseconds limit) {
  if (std::exchange(stopped_, true)) return;
  watch_.reset();
  if (thread_.joinable()) {
    presence_.leave();  // other pools take over what this one gives up from now on
    const auto for_workers = std::max(limit - death_reserve, limit / 2);
    post([this, for_workers] {
      leaving_ = true;
      for (const auto& state : fleet_.states()) fleet_.end({state.topology, state.place}, for_workers);
    });
    const config::MutexLock lock(mutex_);
    if (!changed_.wait_for(mutex_, limit, [this]() IOTCLOUD_REQUIRES(mutex_) { return gone_; }))
      pool_logger.error("workers that were killed have not ended within {} ms; their places go to other pools",
                        limit.count());
  }
  thread_ = {};
  claims_.clear();
}

std::string Pool::trouble() const {
  if (options_.registry->session() != discovery::SessionState::connected) return "the registry is away";
  const config::MutexLock lock(mutex_);
  return !refused_.empty() ? refused_ : presence_.trouble();
}

std::vector<discovery::PlaceStatus> Pool::places() const {
  const config::MutexLock lock(mutex_);
  return shown_;
}

}  // namespace iotcloud::topology

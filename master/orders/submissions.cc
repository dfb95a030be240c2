#include <algorithm>
#include <utility>

#include <fmt/format.h>

#include <iotcloud/config/clock.h>
#include <iotcloud/discovery/name_taken.h>
#include <iotcloud/master/logger.h>
#include <iotcloud/master/orders/node_name.h>
#include <iotcloud/master/orders/order_kind.h>
#include <iotcloud/master/orders/submissions.h>
#include <iotcloud/security/sha256.h>

namespace iotcloud::master {

using discovery::InstanceId;
using discovery::Lead;
using discovery::PlaceStatus;
using discovery::RegistryError;
using discovery::RegistryErrorCode;
using discovery::Submission;
using discovery::TopologyName;
using std::chrono::milliseconds;

namespace {

/// How long a topology of which a worker cannot run is waited for until its other workers have ended.
constexpr milliseconds take_back_limit{10'000};

/// Why a request cannot be followed, whatever stands in the registry; nullopt: it can.
std::optional<OrderResult> refuse_request(const SubmitRequest& request, int fewest_workers) {
  const auto bad = [](std::string text) { return refuse(OrderRefusal::bad_request, std::move(text)); };
  if (!is_node_name(request.topology)) return bad(fmt::format("\"{}\" cannot be a topology's name", request.topology));
  if (request.workers < fewest_workers || request.workers > Submission::most_workers)
    return bad(fmt::format("a topology has 1 to {} workers, not {}", Submission::most_workers, request.workers));
  if (request.yaml.empty()) return bad("its file is empty");
  if (request.yaml.size() > largest_order)
    return bad(fmt::format("its file has {} bytes, more than {}", request.yaml.size(), largest_order));
  for (const auto& library : request.libraries) {
    if (!is_node_name(library.file) || !security::is_sha256(library.sha256))
      return bad(fmt::format("the library \"{}\" has no plain file name, or no SHA-256", library.file));
  }
  return std::nullopt;
}

bool runs(const PlaceWatch::Places& places, int place, std::int64_t version) {
  const auto found = places.find(place);
  return found != places.end() && found->second.version == version && found->second.state == "running";
}

bool has_failed(const PlaceWatch::Places& places, int place, std::int64_t version) {
  const auto found = places.find(place);
  return found != places.end() && found->second.version == version && found->second.state == "failed";
}

InstanceOutcome outcome_of(const PlaceWatch::Places& places, const TopologyName& topology, int place,
                           std::int64_t version, milliseconds limit) {
  InstanceOutcome outcome;
  outcome.instance = InstanceId(fmt::format("{}/{}", topology, place));
  const auto found = places.find(place);
  if (found == places.end()) {
    outcome.reason = fmt::format(
        "no pool has taken it within {} ms: they have no room, or lack a library (`iotcloud topology pools`)",
        limit.count());
    return outcome;
  }
  const PlaceStatus& status = found->second;
  outcome.gateway = discovery::GatewayId(status.pool.str());
  if (runs(places, place, version)) {
    outcome.outcome = OrderOutcome::done;
    outcome.reason = status.reason;
  } else if (has_failed(places, place, version)) {
    outcome.outcome = OrderOutcome::failed;
    outcome.reason = status.reason;
  } else {
    outcome.reason = fmt::format("after {} ms version {} is {}{}{}", limit.count(), status.version, status.state,
                                 status.reason.empty() ? "" : ": ", status.reason);
  }
  return outcome;
}

std::optional<OrderResult> refuse_not_submitted(const TopologyName& topology) {
  return refuse(
      OrderRefusal::unknown_topology,
      fmt::format("topology {} is not submitted to the pools; `iotcloud topology submit` does that, and workers "
                  "that were started by hand are updated by hand",
                  topology));
}

}  // namespace

std::optional<OrderResult> Submissions::rewrite(const TopologyName& topology, const Lead& lead, const Alter& alter) {
  const std::string path = desk_.options.paths.submission(topology);
  while (!desk_.leadership.closing().stop_requested()) {
    const auto known = desk_.book.last_given(path);  // before the node is read
    const auto node = desk_.registry.get(path);
    Submission submission;
    submission.name = topology;
    submission.killed = true;  // as if there had been one
    const bool ours = node && desk_.book.is_ours(path, node->data);
    if (ours) submission = discovery::decode_submission(node->data, path);
    if (ours && submission.epoch > lead.epoch)
      return refuse(OrderRefusal::bad_request, "a later master has submitted it; this one's lead is over");
    if (ours && desk_.book.is_old(*node, submission.given_ms, known)) submission.killed = true;
    const auto given_before = std::max(submission.given_ms, known);
    if (auto refusal = alter(submission)) return refusal;
    submission.epoch = lead.epoch;
    submission.given_ms = std::max(config::system_clock().wall_ms(), given_before + 1);
    const auto size = encode(submission).size();
    if (size > discovery::max_node_size * 9 / 10)
      return refuse(
          OrderRefusal::bad_request,
          fmt::format("its file and that of the version before take {} bytes together, more than the registry "
                      "takes",
                      size));
    try {
      desk_.book.put_submission(path, node, submission, lead);
      return std::nullopt;
    } catch (const RegistryError& e) {
      // It changed meanwhile: read it again.
      if (e.code() != RegistryErrorCode::bad_version && e.code() != RegistryErrorCode::exists &&
          e.code() != RegistryErrorCode::no_node)
        throw;
    }
  }
  return refuse(OrderRefusal::bad_request, "this master is stopping");
}

OrderResult Submissions::submit(const SubmitRequest& request) {
  return desk_.leadership.guarded([&] { return submit_checked(request); });
}

OrderResult Submissions::submit_checked(const SubmitRequest& request) {
  auto with_workers = request;
  with_workers.workers = std::max(request.workers, 1);
  if (auto refusal = refuse_request(with_workers, 1)) return *refusal;
  const auto lead = desk_.leadership.lead();
  if (!lead) return refuse(OrderRefusal::not_leading, lost_lead_text);
  if (discovery::list_pools(desk_.registry, desk_.options.paths).empty())
    return refuse(OrderRefusal::bad_request,
                  "no pool of workers runs; start one on a machine: iotcloud-topology --pool --config pool.yaml");
  if (auto taken = discovery::taken_by_storm(desk_.registry, desk_.options.paths, request.topology); !taken.empty())
    return refuse(OrderRefusal::bad_request, std::move(taken));
  const auto by_hand = discovery::list_workers(desk_.registry, desk_.options.paths, request.topology);
  Submission given;
  auto refusal = rewrite(request.topology, *lead, [&](Submission& submission) -> std::optional<OrderResult> {
    if (!submission.killed)
      return refuse(
          OrderRefusal::bad_request,
          fmt::format("a topology {} is submitted already; `iotcloud topology update` gives it another version, "
                      "`iotcloud topology kill` ends it",
                      request.topology));
    if (!by_hand.empty())
      return refuse(OrderRefusal::bad_request,
                    fmt::format("a topology {} runs already (worker {}): give this one another name, or kill that one",
                                request.topology, by_hand.front().name));
    const auto last = submission.last_number;
    const auto given_ms = submission.given_ms;
    submission = Submission{};
    submission.name = request.topology;
    submission.workers = with_workers.workers;
    submission.last_number = last + 1;
    submission.given_ms = given_ms;
    submission.manager = request.manager;
    submission.version = {submission.last_number, request.yaml, request.libraries,
                          digest_of(request.yaml, request.libraries)};
    given = submission;
    return std::nullopt;
  });
  if (refusal) return *refusal;
  auto result = await_running(given, 0, given.workers, request.wait);
  const bool failed = std::any_of(result.outcomes.begin(), result.outcomes.end(),
                                  [](const auto& outcome) { return outcome.outcome == OrderOutcome::failed; });
  if (failed && !mark_killed(request.topology, milliseconds{0}, *lead)) {
    const bool gone = await_end(request.topology, take_back_limit);
    if (gone) discovery::remove_topology(desk_.registry, desk_.options.paths, request.topology, lead->fence);
    for (auto& outcome : result.outcomes) {
      if (outcome.outcome == OrderOutcome::done) outcome.reason = "it ran, until another worker failed";
      if (outcome.outcome != OrderOutcome::failed) outcome.outcome = OrderOutcome::failed;
      outcome.reason += gone ? "; the topology was taken back" : "; the topology is being taken back";
    }
  }
  remember(request.topology, "submit", result.summary());
  desk_.tell(result, "submit");
  return result;
}

/// Waits until the workers at these places run their version, or one of them cannot.
OrderResult Submissions::await_running(const Submission& submission, int from, int to, const WaitLimit& wait) {
  const auto limit = desk_.limit(wait);
  PlaceWatch watch(desk_.registry, desk_.options.paths, submission.name);
  const auto version_at = [&](int place) { return submission.version_of(place).number; };
  const auto places = watch.wait(limit, desk_.leadership.closing(), [&](const PlaceWatch::Places& seen) {
    bool all_run = true;
    for (int place = from; place < to; ++place) {
      if (has_failed(seen, place, version_at(place))) return true;
      all_run = all_run && runs(seen, place, version_at(place));
    }
    return all_run;
  });
  OrderResult result;
  for (int place = from; place < to; ++place)
    result.outcomes.push_back(outcome_of(places, submission.name, place, version_at(place), limit));
  return result;
}

OrderResult Submissions::update(const SubmitRequest& request) {
  if (auto refusal = refuse_request(request, 0)) return *refusal;
  return change(request.topology, "update", request.wait, request.settle,
                [&](Submission& submission) -> std::optional<OrderResult> {
                  const auto digest = digest_of(request.yaml, request.libraries);
                  const int workers = request.workers > 0 ? request.workers : submission.workers;
                  if (!request.manager.empty()) submission.manager = request.manager;
                  if (submission.version.digest == digest) {  // the same: an update that stopped goes on
                    submission.pending = std::min(submission.pending, workers);
                    submission.workers = workers;
                    return std::nullopt;
                  }
                  if (submission.pending == 0) submission.previous = submission.version;
                  submission.version = {++submission.last_number, request.yaml, request.libraries, digest};
                  submission.pending = submission.workers = workers;
                  return std::nullopt;
                });
}

OrderResult Submissions::roll_back(const RollbackRequest& request) {
  return change(request.topology, "rollback", request.wait, request.settle,
                [&](Submission& submission) -> std::optional<OrderResult> {
                  if (!submission.previous)
                    return refuse(OrderRefusal::bad_request,
                                  fmt::format("topology {} has had no other version", request.topology));
                  if (submission.pending > 0) {  // of an update that stopped: what was updated goes back at once
                    submission.version = *submission.previous;
                    submission.previous.reset();
                    submission.pending = 0;
                    return std::nullopt;
                  }
                  std::swap(submission.version, *submission.previous);
                  submission.pending = submission.workers;
                  return std::nullopt;
                });
}

OrderResult Submissions::change(const TopologyName& topology, const std::string& what, const WaitLimit& wait,
                                milliseconds settle, const Alter& begin) {
  return desk_.leadership.guarded([&]() -> OrderResult {
    if (!is_node_name(topology)) return *refuse_not_submitted(topology);
    {
      const config::MutexLock lock(mutex_);
      if (!changing_.insert(topology).second)
        return refuse(OrderRefusal::bad_request, fmt::format("an update of topology {} is under way", topology));
    }
    struct Done {
      Submissions& of;
      const TopologyName& topology;
      ~Done() {
        const config::MutexLock lock(of.mutex_);
        of.changing_.erase(topology);
      }
    } const done{*this, topology};
    const auto lead = desk_.leadership.lead();
    if (!lead) return refuse(OrderRefusal::not_leading, lost_lead_text);
    Submission wanted;
    auto refusal = rewrite(topology, *lead, [&](Submission& submission) -> std::optional<OrderResult> {
      if (submission.killed) return refuse_not_submitted(topology);
      if (auto refused = begin(submission)) return refused;
      wanted = submission;
      return std::nullopt;
    });
    if (refusal) return *refusal;
    auto result = go_step_by_step(wanted, wait, settle);
    remember(topology, what, result.summary());
    desk_.tell(result, what);
    return result;
  });
}

/// Updates the places that are pending, one after the other, and goes back when one fails.
OrderResult Submissions::go_step_by_step(const Submission& begun, const WaitLimit& wait, milliseconds settle) {
  Submission wanted = begun;
  OrderResult all;
  const auto lead = desk_.leadership.lead();
  while (lead) {
    const int step = std::max(wanted.workers - wanted.pending - 1, 0);
    auto result =
        await_running(wanted, wanted.pending == begun.pending ? 0 : step, wanted.workers - wanted.pending, wait);
    if (result.all_done() && wanted.pending > 0 && settle.count() > 0) {
      PlaceWatch watch(desk_.registry, desk_.options.paths, wanted.name);
      const auto places = watch.wait(settle, desk_.leadership.closing(), [&](const PlaceWatch::Places& seen) {
        return !seen.empty() && step < wanted.workers - wanted.pending && !runs(seen, step, wanted.version.number);
      });
      if (step < wanted.workers - wanted.pending && !runs(places, step, wanted.version.number))
        result.outcomes.back() = {result.outcomes.back().gateway, result.outcomes.back().instance, OrderOutcome::failed,
                                  "it did not go on running"};
    }
    const bool in_order = result.all_done();
    all.outcomes.insert(all.outcomes.end(), result.outcomes.begin(), result.outcomes.end());
    if (!in_order) return go_back(wanted, wait, std::move(all));
    if (wanted.pending == 0) return all;
    auto refusal = rewrite(wanted.name, *lead, [&](Submission& submission) -> std::optional<OrderResult> {
      if (submission.killed || submission.version.number != wanted.version.number)
        return refuse(OrderRefusal::bad_request,
                      fmt::format("topology {} was ordered otherwise meanwhile", wanted.name));
      --submission.pending;
      wanted = submission;
      return std::nullopt;
    });
    if (refusal) return *refusal;
  }
  return refuse(OrderRefusal::not_leading, lost_lead_text);
}

/// Returns to the version before. \param result the outcomes so far
OrderResult Submissions::go_back(const Submission& failed, const WaitLimit& wait, OrderResult result) {
  const auto lead = desk_.leadership.lead();
  if (!failed.previous || !lead) return result;
  Submission back;
  auto refusal = rewrite(failed.name, *lead, [&](Submission& submission) -> std::optional<OrderResult> {
    if (submission.killed || submission.version.number != failed.version.number || !submission.previous)
      return refuse(OrderRefusal::bad_request, fmt::format("topology {} was ordered otherwise meanwhile", failed.name));
    submission.version = *submission.previous;
    submission.previous.reset();
    submission.pending = 0;
    back = submission;
    return std::nullopt;
  });
  if (refusal) return *refusal;
  const auto after = await_running(back, 0, back.workers, wait);
  for (auto& outcome : result.outcomes) {
    if (outcome.outcome == OrderOutcome::done) outcome.reason = "it was updated, and another worker failed";
    outcome.outcome = OrderOutcome::failed;
    const auto place = std::find_if(after.outcomes.begin(), after.outcomes.end(),
                                    [&](const auto& one) { return one.instance == outcome.instance; });
    if (place == after.outcomes.end()) continue;
    outcome.reason += place->outcome == OrderOutcome::done
                          ? fmt::format("; back on version {}", back.version.number)
                          : fmt::format("; on its way back to version {}: {}", back.version.number, place->reason);
  }
  return result;
}

bool Submissions::stands(const TopologyName& topology) {
  const auto& paths = desk_.options.paths;
  const std::string path = paths.submission(topology);
  const auto node = desk_.registry.get(path);
  if (!node) return false;
  const auto places = desk_.registry.children(paths.places(topology));
  return !discovery::decode_submission(node->data, path).killed || (places && !places->empty());
}

std::optional<OrderResult> Submissions::mark_killed(const TopologyName& topology, milliseconds drain,
                                                    const Lead& lead) {
  return rewrite(topology, lead, [&](Submission& submission) -> std::optional<OrderResult> {
    if (submission.killed && submission.last_number == 0) return refuse_not_submitted(topology);
    submission.killed = true;
    submission.drain_ms = drain.count();
    // What it ran, and the secrets that may be in it, is not needed any more.
    submission.version.yaml.clear();
    submission.version.libraries.clear();
    submission.previous.reset();
    submission.pending = 0;
    return std::nullopt;
  });
}

bool Submissions::await_end(const TopologyName& topology, milliseconds limit) {
  const auto end = std::chrono::steady_clock::now() + limit;
  const auto closing = desk_.leadership.closing();
  {
    config::Mutex mutex;
    config::StoppableConditionVariable changed;
    bool gone = false;
    const auto guard = desk_.registry.watch_children(desk_.options.paths.places(topology), [&](const auto& names) {
      const config::MutexLock lock(mutex);
      gone = !names || names->empty();
      changed.notify_all();
    });
    const config::MutexLock lock(mutex);
    if (!changed.wait_for(mutex, closing, limit, [&] { return gone; })) return false;
  }
  // A pool lets go of a place before its record says so.
  PlaceWatch told(desk_.registry, desk_.options.paths, topology);
  const auto left = std::chrono::ceil<milliseconds>(end - std::chrono::steady_clock::now());
  return told.wait(left, closing, [](const PlaceWatch::Places& places) { return places.empty(); }).empty();
}

void Submissions::remember(const TopologyName& topology, const std::string& order, const std::string& outcome) try {
  const auto lead = desk_.leadership.lead();
  if (!lead) return;
  const auto& paths = desk_.options.paths;
  const std::string path = paths.topology_history(topology);
  const auto node = desk_.registry.get(path);
  discovery::TopologyHistory history;
  if (node) history = discovery::decode_history(node->data, path);
  discovery::TopologyEvent event;
  event.time_ms = config::system_clock().wall_ms();
  event.order = order;
  event.outcome = outcome;
  const std::string submission_path = paths.submission(topology);
  if (const auto standing = desk_.registry.get(submission_path)) {
    const auto submission = discovery::decode_submission(standing->data, submission_path);
    event.version = submission.version.number;
    event.digest = submission.version.digest;
    event.workers = submission.workers;
  }
  history.events.push_back(std::move(event));
  const auto surplus =
      std::max(history.events.size(), discovery::TopologyHistory::most) - discovery::TopologyHistory::most;
  history.events.erase(history.events.begin(), history.events.begin() + static_cast<std::ptrdiff_t>(surplus));
  discovery::put(desk_.registry, path, encode(history), lead->fence);
} catch (const config::Error& e) {
  logger.warn("the history of topology {} misses its {}: {}", topology, order, e.what());
}

std::vector<OrderKind> submission_orders() {
  using security::Role;
  return {order_kind<SubmitRequest>(
              "submitTopology", Role::admin,
              [](auto& services, const auto& request) { return services.submissions.submit(request); }),
          order_kind<SubmitRequest>(
              "updateTopology", Role::admin,
              [](auto& services, const auto& request) { return services.submissions.update(request); }),
          order_kind<RollbackRequest>("rollbackTopology", Role::admin, [](auto& services, const auto& request) {
            return services.submissions.roll_back(request);
          })};
}

}  // namespace iotcloud::master

#include <algorithm>
#include <utility>

#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/config/metrics.h>
#include <iotcloud/topology/pool/logger.h>
#include <iotcloud/topology/pool/worker_fleet.h>

namespace iotcloud::topology {

using discovery::PlaceId;

namespace {

std::string name_of(const PlaceId& place) {
  return fmt::format("worker {} of topology {}", place.number, place.topology);
}

/// What a worker says goes into the pool's record, which has room for so much of each.
std::string cut(const std::string& text) {
  constexpr std::size_t most = 400;
  return text.size() <= most ? text : text.substr(0, most) + "...";
}

}  // namespace

WorkerFleet::WorkerFleet(WorkerLauncher& launcher, Options options)
    : launcher_(launcher), options_(std::move(options)) {}

WorkerEvents WorkerFleet::events_of(const PlaceId& id, std::int64_t life) {
  const auto later = [this, id, life, alive = std::weak_ptr<bool>(alive_)](auto event) {
    options_.post([this, id, life, alive, event] {
      if (alive.expired()) return;
      const auto found = places_.find(id);
      if (found != places_.end() && found->second.life == life) event();
    });
  };
  return {[this, id, later](const pooled::WorkerReport& report) { later([this, id, report] { heard(id, report); }); },
          [this, id, later](const WorkerEnding& ending) { later([this, id, ending] { ended(id, ending); }); }};
}

std::vector<PlaceId> WorkerFleet::adopt() {
  std::vector<PlaceId> adopted;
  for (const auto& worker : launcher_.running()) {
    auto& place = places_[worker.place];
    place.life = ++lives_;
    place.runs_version = worker.version;
    place.status.topology = worker.place.topology;
    place.status.place = worker.place.number;
    place.status.version = worker.version;
    place.restarts.started(options_.clock->now());
    show(place, "starting", "");
    place.link = launcher_.adopt(worker, events_of(worker.place, place.life));
    adopted.push_back(worker.place);
    pool_logger.info("adopted {}, version {}", name_of(worker.place), worker.version);
  }
  return adopted;
}

void WorkerFleet::run(const WorkerOrder& order) {
  auto& place = places_[order.place];
  place.ending = false;
  place.stop_at.reset();
  place.status.topology = order.place.topology;
  place.status.place = order.place.number;
  const bool same = place.order && place.order->version.number == order.version.number;
  place.order = order;
  if (place.link) {
    if (place.runs_version == order.version.number || place.stopping) return;
    pool_logger.info("{} ends, for version {}", name_of(order.place), order.version.number);
    place.stopping = true;
    show(place, "stopping", fmt::format("for version {}", order.version.number));
    place.link->stop(options_.stop_limit);
    return;
  }
  if (same) return;  // it waits for its restart, or is left alone
  place.restarts = {};
  place.start_at.reset();
  start(order.place, place);
}

void WorkerFleet::start(const PlaceId& id, Place& place) {
  place.start_at.reset();
  place.stopping = false;
  place.life = ++lives_;
  place.runs_version = place.order->version.number;
  place.status.version = place.runs_version;
  place.status.worker.clear();
  place.restarts.started(options_.clock->now());
  show(place, "starting", place.last_failure.empty() ? "" : "again, after it " + place.last_failure);
  try {
    place.link = launcher_.start(*place.order, events_of(id, place.life));
  } catch (const WorkerRefused& refused) {
    leave_alone(id, place, refused.what());
  } catch (const std::exception& error) {
    failed(id, place, fmt::format("could not be started: {}", error.what()));
  }
}

void WorkerFleet::end(const PlaceId& id, std::chrono::milliseconds limit) {
  const auto found = places_.find(id);
  if (found == places_.end()) return;
  Place& place = found->second;
  if (!place.link) {
    places_.erase(found);
    options_.on_change();
    return;
  }
  place.ending = true;
  if (!std::exchange(place.stopping, true)) show(place, "stopping", "");
  place.link->stop(limit);  // also when it stops already: it may have less time now
}

void WorkerFleet::let_end(const PlaceId& id, std::chrono::milliseconds limit) {
  const auto found = places_.find(id);
  if (found == places_.end() || found->second.ending) return;
  if (found->second.status.state != "running") return end(id);
  found->second.ending = true;
  found->second.stop_at = options_.clock->now() + limit;
  show(found->second, "stopping", "the topology was killed");
}

void WorkerFleet::heard(const PlaceId& id, const pooled::WorkerReport& report) {
  Place& place = places_.at(id);
  if (place.stopping || place.ending) return;
  const bool started = report.runs && place.status.state != "running";
  if (!started && place.status.worker == cut(report.worker)) return;
  place.status.worker = cut(report.worker);
  if (started) {
    pool_logger.info("{} runs version {} as {}", name_of(id), place.runs_version, report.worker);
    show(place, "running", place.last_failure.empty() ? "" : "again, after it " + place.last_failure);
    place.last_failure.clear();
  } else {
    options_.on_change();
  }
}

void WorkerFleet::ended(const PlaceId& id, const WorkerEnding& ending) {
  Place& place = places_.at(id);
  place.link.reset();
  if (place.ending) {
    pool_logger.info("{} has ended{}{}", name_of(id), ending.reason.empty() ? "" : ": ", ending.reason);
    places_.erase(id);
    options_.on_change();
    return;
  }
  const bool replaced = place.order && place.order->version.number != place.runs_version;
  if (place.stopping || replaced) {
    place.restarts = {};
    place.last_failure.clear();
    start(id, place);
  } else if (ending.how == WorkerEnding::How::refused) {
    leave_alone(id, place, ending.reason);
  } else {
    failed(id, place, ending.reason.empty() ? "ended by itself" : ending.reason);
  }
}

void WorkerFleet::failed(const PlaceId& id, Place& place, const std::string& reason) {
  config::process_metrics()
      .counter("iotcloud_pool_worker_failures_total", "Workers that crashed, hung, spun or took too much",
               {{"topology", id.topology.str()}})
      .add();
  if (!place.order) {
    leave_alone(id, place, fmt::format("{}; this pool does not know what is to run there", reason));
    return;
  }
  const auto pause = place.restarts.failed(options_.clock->now(), options_.restart);
  if (!pause) {
    leave_alone(id, place,
                fmt::format("{}; that was failure {} in a row, so it is left alone until it gets another version",
                            reason, place.restarts.failures()));
    return;
  }
  place.last_failure = reason;
  place.start_at = options_.clock->now() + *pause;
  pool_logger.error("{} {}; it is started again in {} ms", name_of(id), reason, pause->count());
  show(place, "starting", fmt::format("it {}; it is started again in {} ms", reason, pause->count()));
}

void WorkerFleet::leave_alone(const PlaceId& id, Place& place, const std::string& reason) {
  pool_logger.error("{} does not run: {}", name_of(id), reason);
  place.start_at.reset();
  show(place, "failed", reason);
}

std::optional<config::Clock::Instant> WorkerFleet::do_due() {
  std::optional<config::Clock::Instant> next;
  const auto now = options_.clock->now();
  const auto is_due = [&](std::optional<config::Clock::Instant>& at) {
    if (at && *at > now) next = std::min(next.value_or(*at), *at);
    return at && *at <= now;
  };
  for (auto& [id, place] : places_) {
    if (is_due(place.start_at)) start(id, place);
    if (!is_due(place.stop_at)) continue;
    place.stop_at.reset();
    place.stopping = true;
    if (place.link) place.link->stop(options_.stop_limit);
  }
  return next;
}

void WorkerFleet::show(Place& place, const std::string& state, const std::string& reason) {
  place.status.state = state;
  place.status.reason = cut(reason);
  place.status.since_ms = options_.clock->wall_ms();
  options_.on_change();
}

std::vector<discovery::PlaceStatus> WorkerFleet::states() const {
  std::vector<discovery::PlaceStatus> states;
  for (const auto& [id, place] : places_) states.push_back(place.status);
  return states;
}

}  // namespace iotcloud::topology

#include <algorithm>
#include <array>
#include <cmath>
#include <set>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/description/json.h>
#include <iotcloud/discovery/submissions.h>
#include <iotcloud/master/console/live.h>
#include <iotcloud/master/logger.h>

namespace iotcloud::master {

namespace {

using Json = nlohmann::ordered_json;
using std::chrono::milliseconds;

constexpr std::size_t rows_at_once = 500, most_shown_faults = 100;
constexpr std::size_t largest_page = std::size_t{8} << 20U;
/// Of a task's counts, those that are told of some time ago, too.
constexpr std::array remembered_counts{"emitted",   "transferred", "executed", "acked",     "failed",
                                       "timed_out", "errors",      "late",     "superseded"};
/// And those that say that tuples were lost. What `keep_last` replaced is not lost: the topology's author wants it so.
constexpr std::array lost_counts{"late", "timed_out", "failed", "errors"};
/// Of Options::remember: how long ago.
constexpr std::array former_spans{1, 18, 144};
/// After so many a host that told nothing is forgotten.
constexpr int rounds_without_answer = 10;
/// A look may take this part of the time at most.
constexpr int rest_of_look = 20;

std::shared_ptr<const std::string> event(const char* name, const std::string& data) {
  return std::make_shared<const std::string>(std::string("event: ") + name + "\ndata: " + data + "\n\n");
}

Json row_of(const discovery::DriverRecord& driver) {
  Json row{{"instance", driver.instance.str()},
           {"gateway", driver.gateway.str()},
           {"driver", driver.name.str()},
           {"name", driver.deployment.empty() ? "" : driver.deployment + "/" + std::to_string(driver.index)},
           {"state", to_string(driver.state)},
           {"reason", driver.reason},
           {"since_ms", driver.since_ms},
           {"metadata", driver.metadata},
           {"channels", driver.channels.size()}};
  if (driver.starts_again) row["starts_again"] = true;
  if (!driver.made_by.empty()) row["made_by"] = driver.made_by;
  return row;
}

/// The value below which the part `q` of all is.
double quantile(const std::map<double, std::uint64_t>& buckets, double q) {
  std::uint64_t all = 0, seen = 0;
  for (const auto& [end, count] : buckets) all += count;
  const auto rank = static_cast<std::uint64_t>(std::ceil(q * static_cast<double>(all)));
  for (const auto& [end, count] : buckets) {
    seen += count;
    if (seen >= rank) return end;
  }
  return 0;
}

/// Adds to `growth` by how much the buckets have grown.
void add_growth(const std::map<double, std::uint64_t>& before, const std::map<double, std::uint64_t>& now,
                std::map<double, std::uint64_t>& growth) {
  for (const auto& [end, count] : now) {
    const auto then = before.find(end);
    const auto former = then == before.end() ? 0 : then->second;
    if (count > former) growth[end] += count - former;
  }
}

std::optional<double> p99_of(const std::map<double, std::uint64_t>& buckets) {
  return buckets.empty() ? std::nullopt : std::optional(quantile(buckets, 0.99));
}

Json number_or_null(std::optional<double> number) {
  return number ? Json(*number) : Json();
}

std::uint64_t number_in(const Json& from, const char* key) {
  const auto found = from.find(key);
  return found != from.end() && found->is_number_unsigned() ? found->get<std::uint64_t>() : 0;
}

}  // namespace

Live::Live(Source source, Options options, const config::Clock& clock)
    : source_(std::move(source)),
      options_(options),
      clock_(clock),
      looks_([this](const std::stop_token& stop) { look_on(stop); }),
      pages_([this](const std::stop_token& stop) { read_pages_on(stop); }),
      messages_counter_([this](const std::stop_token& stop) { count_messages_on(stop); }) {}

Live::~Live() {
  for (auto* thread : {&looks_, &pages_, &messages_counter_}) thread->request_stop();
  for (auto* thread : {&looks_, &pages_, &messages_counter_}) thread->join();
}

void Live::follow(std::shared_ptr<rpc::HttpStream> stream, Wanted wanted, std::function<bool()> may) {
  const auto now = clock_.now();
  const config::MutexLock lock(mutex_);
  followers_.push_back({std::move(stream), std::move(wanted), std::move(may), true, now, now});
  changed_.notify_all();
}

std::optional<discovery::DriverRecord> Live::find(const discovery::GatewayId& gateway,
                                                  const discovery::InstanceId& instance) {
  {
    const config::MutexLock lock(mutex_);
    if (const auto found = rows_.find({gateway, instance}); found != rows_.end()) return found->second.record;
  }
  for (auto& driver : source_.drivers()) {
    if (driver.gateway == gateway && driver.instance == instance) return std::move(driver);
  }
  return std::nullopt;
}

std::size_t Live::followers() const {
  const config::MutexLock lock(mutex_);
  return followers_.size();
}

void Live::look_on(const std::stop_token& stop) {
  config::Clock::Instant next{};
  while (!stop.stop_requested()) {
    {
      const config::MutexLock lock(mutex_);
      const auto is_fresh = [](const Follower& follower) { return follower.fresh; };
      changed_.wait(mutex_, stop, [this]() IOTCLOUD_REQUIRES(mutex_) { return !followers_.empty(); });
      if (stop.stop_requested()) return;
      changed_.wait_for(
          mutex_, stop, std::max(next - clock_.now(), config::Clock::Instant::duration::zero()),
          [&]() IOTCLOUD_REQUIRES(mutex_) { return std::any_of(followers_.begin(), followers_.end(), is_fresh); });
      if (stop.stop_requested()) return;
    }
    if (clock_.now() >= next) {
      const auto begun = clock_.now();
      look();
      next = clock_.now() +
             std::max<config::Clock::Instant::duration>(options_.look, rest_of_look * (clock_.now() - begun));
    } else {
      tell_all({});  // somebody is new, and what was found a moment ago will do
    }
  }
}

void Live::look() {
  std::vector<Key> changed;
  std::string problem;
  try {
    master_ = source_.status();
    auto drivers = source_.drivers();
    gateways_ = source_.gateways();
    topologies_ = source_.topologies();
    std::sort(drivers.begin(), drivers.end(), [](const auto& one, const auto& other) {
      return std::tie(one.gateway, one.instance) < std::tie(other.gateway, other.instance);
    });
    const config::MutexLock lock(mutex_);
    auto known = rows_.begin();
    const auto forget_until = [&](const Key* end) IOTCLOUD_REQUIRES(mutex_) {
      while (known != rows_.end() && (end == nullptr || known->first < *end)) {
        changed.push_back(known->first);
        known = rows_.erase(known);
      }
    };
    for (auto& driver : drivers) {
      const Key key{driver.gateway, driver.instance};
      forget_until(&key);
      if (known != rows_.end() && known->first == key) {
        const auto row = known++;
        if (row->second.record == driver) continue;
        row->second = {driver, discovery::to_text(row_of(driver))};
      } else {
        rows_.emplace_hint(known, key, Row{driver, discovery::to_text(row_of(driver))});
      }
      changed.push_back(key);
    }
    forget_until(nullptr);
    looked_ = true;
  } catch (const config::Error& error) {
    problem = error.what();
  }
  const auto state = state_of(problem);
  {
    const config::MutexLock lock(mutex_);
    auto text = event("state", state);
    if (!state_ || *state_ != *text) {
      state_ = std::move(text);
      for (auto& follower : followers_) {
        if (!follower.fresh) send(follower, state_);
      }
    }
  }
  tell_all(changed);
}

std::string Live::state_of(const std::string& problem) {
  Json gateways = Json::array(), topologies = Json::array();
  std::set<std::string> lost;
  for (const auto& gateway : gateways_) {
    gateways.push_back(discovery::to_json<Json>(gateway));
    if (!gateway.alive) lost.insert(gateway.record.id);
  }
  for (const auto& topology : topologies_) topologies.push_back(discovery::to_json<Json>(topology));
  std::map<std::string, std::size_t> counts;
  Json faults = Json::array();
  std::size_t number_of_faults = 0, all = 0;
  const config::MutexLock lock(mutex_);
  for (const auto& [key, row] : rows_) {
    ++all;
    const bool is_lost = lost.contains(key.first);
    ++counts[is_lost ? "lost" : to_string(row.record.state)];
    if (row.record.state != discovery::DriverState::failed && !is_lost) continue;
    if (++number_of_faults > most_shown_faults) continue;
    auto fault = row_of(row.record);
    fault["lost"] = is_lost;
    faults.push_back(std::move(fault));
  }
  return discovery::to_text(Json{{"problem", problem},
                                 {"master", discovery::to_json<Json>(master_)},
                                 {"gateways", std::move(gateways)},
                                 {"topologies", std::move(topologies)},
                                 {"instances", all},
                                 {"counts", counts},
                                 {"faults", std::move(faults)},
                                 {"losses", tell_losses()},
                                 {"number_of_faults", number_of_faults}});
}

Live::Text Live::beat() const {
  return event("beat", fmt::format(R"({{"ms":{}}})", options_.beat.count()));
}

void Live::send(Follower& follower, Text text) {
  if (!follower.stream) return;  // its reader has gone; tell_all() removes it
  follower.told = clock_.now();
  if (!follower.stream->send(std::move(text))) follower.stream.reset();
}

void Live::send_rows(Follower& follower, const std::vector<Key>& changed) {
  const auto begin = [](bool reset) {
    return std::string(R"({"reset":)") + (reset ? "true" : "false") + R"(,"set":[)";
  };
  if (follower.fresh) {
    bool first = true;
    auto next = rows_.begin();
    do {
      std::string text = begin(first);
      first = false;
      for (std::size_t number = 0; next != rows_.end() && number < rows_at_once; ++next) {
        if (!follower.wanted.where.matches(next->second.record)) continue;
        if (number++ > 0) text += ',';
        text += next->second.json;
      }
      send(follower, event("rows", text + R"(],"gone":[],"more":)" + (next == rows_.end() ? "false}" : "true}")));
    } while (next != rows_.end() && follower.stream);
    return;
  }
  if (changed.empty()) return;
  std::string text = begin(false);
  Json gone = Json::array();
  bool some = false;
  for (const auto& key : changed) {
    const auto row = rows_.find(key);
    if (row == rows_.end() || !follower.wanted.where.matches(row->second.record)) {
      gone.push_back({{"gateway", key.first}, {"instance", key.second}});
      continue;
    }
    if (std::exchange(some, true)) text += ',';
    text += row->second.json;
  }
  send(follower, event("rows", text + R"(],"gone":)" + discovery::to_text(gone) + "}"));
}

void Live::tell_all(const std::vector<Key>& changed) {
  const auto now = clock_.now();
  const config::MutexLock lock(mutex_);
  for (auto& follower : followers_) {
    if (follower.fresh) send(follower, beat());
    if (follower.fresh && state_) send(follower, state_);
    for (const auto* series : {&tuples_, &messages_}) {
      if (follower.fresh) send_points(follower, *series);
    }
    if (follower.stream && follower.wanted.rows && (looked_ || !follower.fresh)) send_rows(follower, changed);
    follower.fresh = false;
    if (!follower.stream) continue;
    if (now - follower.told >= options_.beat) send(follower, beat());
    if (!follower.stream || now - follower.asked < options_.beat) continue;
    follower.asked = now;
    if (follower.may()) continue;
    send(follower, event("over", "{}"));
    follower.stream.reset();
  }
  followers_.remove_if([](const Follower& follower) { return !follower.stream; });
}

void Live::read_pages_on(const std::stop_token& stop) {
  auto next_sample = clock_.now();
  while (!stop.stop_requested()) {
    bool seen = false;
    {
      const config::MutexLock lock(mutex_);
      const auto sees_one = [](const Follower& follower) { return !follower.wanted.topology.empty(); };
      const auto pause = std::any_of(followers_.begin(), followers_.end(), sees_one)
                             ? std::min<config::Clock::Instant::duration>(options_.pages, next_sample - clock_.now())
                             : next_sample - clock_.now();
      changed_.wait_for(mutex_, stop, std::max(pause, config::Clock::Instant::duration::zero()), [] { return false; });
      if (stop.stop_requested()) return;
      seen = std::any_of(followers_.begin(), followers_.end(), sees_one);
    }
    const bool sample = clock_.now() >= next_sample;
    if (sample) next_sample = clock_.now() + options_.sample;
    if (sample || seen) read_pages(sample);
  }
}

void Live::read_pages(bool sample) {
  std::vector<discovery::TopologyStatus> topologies;
  try {
    topologies = source_.topologies();
  } catch (const config::Error&) {
    return;  // the registry is away; the look says so
  }
  std::map<std::string, Counted> now;
  for (const auto& topology : topologies) {
    bool wanted = false;
    {
      const config::MutexLock lock(mutex_);
      wanted = std::any_of(followers_.begin(), followers_.end(),
                           [&](const Follower& follower) { return follower.wanted.topology == topology.record.name; });
    }
    if (wanted || sample) now[topology.record.name] = show(topology, wanted);
  }
  if (!sample) return;
  std::set<Key> there;
  for (const auto& topology : topologies) {
    for (const auto& worker : topology.workers) there.emplace(topology.record.name, worker.name);
  }
  std::erase_if(of_workers_, [&](const auto& entry) { return !there.contains(entry.first); });
  remember(now);
  note_losses(now);
  count_tuples(now);
}

void Live::add(const Counted& of_worker, Counted& all) {
  all.emitted += of_worker.emitted;
  for (const auto& [end, count] : of_worker.complete) all.complete[end] += count;
  for (const auto& [component, counts] : of_worker.components) {
    for (const auto& [key, count] : counts) all.components[component][key] += count;
  }
}

Live::Counted Live::show(const discovery::TopologyStatus& topology, bool wanted) {
  Counted counted;
  Json pages = Json::array(), problems = Json::array();
  for (const auto& worker : topology.workers) {
    try {
      auto page = discovery::parse_json_as<Json>(source_.worker_page(topology.record.name, worker.name), "its page",
                                                 largest_page);
      Counted of_worker;
      for (const auto& task : page.at("tasks")) {
        const auto complete = task.find("complete");
        if (complete == task.end() || !complete->contains("buckets") || number_in(*complete, "count") == 0) continue;
        for (const auto& bucket : complete->at("buckets"))
          of_worker.complete[bucket.at(0).get<double>()] += bucket.at(1).get<std::uint64_t>();
      }
      std::set<std::string> spouts;
      for (const auto& component : page.at("components")) {
        if (component.at("kind") == "spout") spouts.insert(component.at("id").get<std::string>());
      }
      for (const auto& task : page.at("tasks")) {
        const auto component = task.at("component").get<std::string>();
        if (spouts.contains(component)) of_worker.emitted += number_in(task, "emitted");
        auto& counts = of_worker.components[component];
        for (const char* const key : remembered_counts) counts[key] += number_in(task, key);
      }
      of_workers_[{topology.record.name, worker.name}] = std::move(of_worker);
      if (wanted) pages.push_back(std::move(page));
    } catch (const config::Error& error) {
      problems.push_back({{"worker", worker.name}, {"problem", error.what()}});
    } catch (const nlohmann::json::exception& error) {
      problems.push_back(
          {{"worker", worker.name}, {"problem", std::string("its page cannot be read: ") + error.what()}});
    }
    // A worker whose page cannot be read now has counted what it had: its return is no jump.
    const auto known = of_workers_.find({topology.record.name, worker.name});
    if (known != of_workers_.end()) add(known->second, counted);
  }
  if (!wanted) return counted;
  const auto text = event("topology", discovery::to_text(Json{{"topology", topology.record.name.str()},
                                                              {"at_ms", clock_.wall_ms()},
                                                              {"pages", std::move(pages)},
                                                              {"former", former(topology.record.name)},
                                                              {"problems", std::move(problems)}}));
  const config::MutexLock lock(mutex_);
  for (auto& follower : followers_) {
    if (follower.stream && follower.wanted.topology == topology.record.name) send(follower, text);
  }
  return counted;
}

/// Remembers what the components have counted, now and then. A topology that has gone is forgotten.
void Live::remember(const std::map<std::string, Counted>& now) {
  const auto at = clock_.now();
  std::erase_if(remembered_, [&](const auto& entry) { return !now.contains(entry.first); });
  for (const auto& [topology, counted] : now) {
    auto& all = remembered_[topology];
    if (!all.empty() && at - all.back().at < options_.remember) continue;
    all.push_back({at, counted.components});
    if (all.size() > former_spans.back() + 2U) all.pop_front();
  }
}

/// What the components had counted some time ago, for each time from which on it is known.
Json Live::former(const discovery::TopologyName& topology) const {
  Json all = Json::array();
  const auto found = remembered_.find(topology);
  if (found == remembered_.end()) return all;
  for (const int times : former_spans) {
    const auto span = times * options_.remember;
    const auto newest = std::find_if(found->second.rbegin(), found->second.rend(), [&](const Remembered& remembered) {
      return clock_.now() - remembered.at >= span;
    });
    if (newest == found->second.rend()) break;
    all.push_back({{"span_ms", span.count()}, {"components", newest->components}});
  }
  return all;
}

/// Compares with the last point. A topology that is new or began again has lost nothing yet.
void Live::note_losses(const std::map<std::string, Counted>& now) {
  const auto at = clock_.now();
  const config::MutexLock lock(mutex_);
  const bool nobody_looks = followers_.empty();
  std::erase_if(losses_, [&](const auto& loss) {
    const bool is_over = (loss.second.told || nobody_looks) && at - loss.second.last >= options_.remind;
    return is_over || !now.contains(loss.first.first);
  });
  for (const auto& [topology, counted] : now) {
    const auto before = counted_.find(topology);
    if (before == counted_.end()) continue;
    for (const auto& [component, counts] : counted.components) {
      const auto then = before->second.components.find(component);
      if (then == before->second.components.end()) continue;
      for (const char* const key : lost_counts) {
        const auto count = counts.at(key), former = then->second.at(key);
        if (count <= former) continue;
        auto& loss = losses_.try_emplace({topology, component}, Loss{{}, clock_.wall_ms(), at}).first->second;
        loss.counts[key] += count - former;
        loss.last = at;
        loss.told = false;
      }
    }
  }
}

Json Live::tell_losses() {
  Json all = Json::array();
  for (auto& [where, loss] : losses_) {
    loss.told = true;
    all.push_back(
        {{"topology", where.first}, {"component", where.second}, {"since_ms", loss.since_ms}, {"counts", loss.counts}});
  }
  return all;
}

void Live::count_tuples(const std::map<std::string, Counted>& now) {
  const auto at = clock_.now();
  const auto seconds = std::chrono::duration<double>(at - counted_at_).count();
  const bool first = counted_at_ == config::Clock::Instant{};
  counted_at_ = at;
  double emitted = 0;
  std::map<double, std::uint64_t> complete;
  for (const auto& [topology, counted] : now) {
    const auto before = counted_.find(topology);
    if (before == counted_.end() || counted.emitted < before->second.emitted) continue;  // it is new, or began again
    emitted += static_cast<double>(counted.emitted - before->second.emitted);
    add_growth(before->second.complete, counted.complete, complete);
  }
  counted_ = now;
  if (first) return;
  const config::MutexLock lock(mutex_);
  add_point(tuples_, {clock_.wall_ms(), emitted / seconds, number_or_null(p99_of(complete))});
}

/// nullopt: the registry is away.
std::optional<Live::Carried> Live::carried_now() const {
  try {
    Carried now;
    for (auto& carried : source_.carried()) {
      const Key key{carried.gateway, carried.messages.host};
      const auto at = clock_.now() - carried.messages.age;
      now[key] = {std::move(carried.messages), at};
    }
    return now;
  } catch (const config::Error&) {
    return std::nullopt;
  }
}

void Live::count_messages_on(const std::stop_token& stop) {
  Carried known;  // of each host, what it told last
  bool first = true;
  while (!stop.stop_requested()) {
    const auto asked = clock_.now();
    const auto next = asked + options_.sample;
    auto now = carried_now();
    if (!now) {
      const config::MutexLock lock(mutex_);
      add_point(messages_, {clock_.wall_ms(), Json(), Json(), Json()});
    } else {
      if (!std::exchange(first, false)) count_messages(known, *now);
      for (auto& [host, carried] : *now) known[host] = std::move(carried);
      std::erase_if(
          known, [&](const auto& entry) { return asked - entry.second.at > rounds_without_answer * options_.sample; });
    }
    const config::MutexLock lock(mutex_);
    changed_.wait_for(mutex_, stop, std::max(next - clock_.now(), config::Clock::Instant::duration::zero()),
                      [] { return false; });
  }
}

void Live::count_messages(const Carried& before, const Carried& now) {
  double sent = 0, received = 0;
  std::map<double, std::uint64_t> round_trips;
  for (const auto& [host, carried] : now) {
    const auto found = before.find(host);
    if (found == before.end()) continue;
    const auto& then = found->second.messages;
    const auto& messages = carried.messages;
    const auto seconds = std::chrono::duration<double>(carried.at - found->second.at).count();
    if (messages.sent < then.sent || messages.received < then.received || seconds <= 0) continue;  // it began again
    sent += static_cast<double>(messages.sent - then.sent) / seconds;
    received += static_cast<double>(messages.received - then.received) / seconds;
    add_growth(then.round_trips, messages.round_trips, round_trips);
  }
  const config::MutexLock lock(mutex_);
  add_point(messages_, {clock_.wall_ms(), sent, received, number_or_null(p99_of(round_trips))});
}

void Live::add_point(Series& series, const nlohmann::ordered_json& point) {
  series.points.push_back(discovery::to_text(point));
  if (series.points.size() > options_.points) series.points.pop_front();
  const auto text = event(series.event, R"({"reset":false,"points":[)" + series.points.back() + "]}");
  for (auto& follower : followers_) {
    if (follower.stream && !follower.fresh) send(follower, text);
  }
}

void Live::send_points(Follower& follower, const Series& series) {
  send(follower, event(series.event, fmt::format(R"({{"reset":true,"points":[{}]}})", fmt::join(series.points, ","))));
}

}  // namespace iotcloud::master

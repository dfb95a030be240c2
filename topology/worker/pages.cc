#include <algorithm>
#include <limits>
#include <stdexcept>

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include <iotcloud/config/mutex.h>
#include <iotcloud/topology/endpoints/receiving/arrivals.h>
#include <iotcloud/topology/worker/pages.h>

namespace iotcloud::topology {

namespace {

using Json = nlohmann::ordered_json;

constexpr std::size_t shown_text = 200;
constexpr std::size_t most_text = std::size_t{64} * 1024;  ///< a larger payload is not looked at
constexpr std::chrono::seconds sweep_period{1};

std::string to_text(const Json& json) {
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

Json to_json(const config::Histogram::Summary& summary, const config::Histogram::Spread& spread) {
  Json buckets = Json::array();
  for (const auto& [end_ns, count] : spread) buckets.push_back({end_ns / 1000, count});
  return {{"count", summary.count},
          {"p50_us", summary.p50_ns / 1000},
          {"p99_us", summary.p99_ns / 1000},
          {"max_us", summary.max_ns / 1000},
          {"buckets", buckets}};
}

Json to_json(const Fields& fields) {
  Json names = Json::array();
  for (std::size_t i = 0; i < fields.size(); ++i) names.push_back(fields[i]);
  return names;
}

/// \param kept -1: nothing of the kind
Json kept_json(std::int64_t kept) {
  return kept < 0 ? Json() : Json(kept);
}

Json to_json(const TaskSnapshot& task) {
  Json streams = Json::object();
  for (const StreamSnapshot& one : task.streams)
    streams[one.stream] = {{"emitted", one.emitted}, {"transferred", one.transferred}};
  Json inputs = Json::array();
  for (const InputSnapshot& one : task.inputs) {
    inputs.push_back({{"from", one.from},
                      {"stream", one.stream},
                      {"executed", one.executed},
                      {"acked", one.acked},
                      {"failed", one.failed},
                      {"late", one.late}});
  }
  return {{"component", task.component},
          {"task", task.task_id},
          {"emitted", task.emitted},
          {"transferred", task.transferred},
          {"streams", streams},
          {"inputs", inputs},
          {"executed", task.executed},
          {"acked", task.acked},
          {"failed", task.failed},
          {"timed_out", task.timed_out},
          {"late", task.late},
          {"superseded", task.superseded},
          {"errors", task.errors},
          {"queue_depth", task.queue_depth},
          {"pending", task.pending},
          {"oldest_s", task.oldest_seconds},
          {"capacity", task.capacity},
          {"window_tuples", kept_json(task.window_tuples)},
          {"state_entries", kept_json(task.state_entries)},
          {"state_bytes", kept_json(task.state_bytes)},
          {"execute", to_json(task.execute_latency, task.execute_spread)},
          {"process", to_json(task.process_latency, task.process_spread)},
          {"complete", to_json(task.complete_latency, task.complete_spread)},
          {"last_error", task.last_error}};
}

Json to_json(const std::string& component, const Arrivals::Facts& facts) {
  Json age, backlog;
  if (facts.age_ms) age = static_cast<double>(*facts.age_ms) / 1000;
  if (facts.backlog.known > 0) backlog = facts.backlog.messages;
  return {{"component", component},
          {"age_s", age},
          {"backlog", backlog},
          {"topic", facts.backlog.topic},
          {"most", facts.backlog.most}};
}

Json to_json(const ComponentSpec& component, const Topology& topology, const Snapshot& now) {
  Json inputs = Json::array();
  for (const InputSpec& input : component.inputs) {
    inputs.push_back({{"from", input.from},
                      {"stream", input.stream},
                      {"grouping", input.grouping},
                      {"fields", to_json(input.fields)}});
  }
  Json streams = Json::object();
  if (const auto declared = topology.streams.find(component.id); declared != topology.streams.end()) {
    for (const auto& [name, stream] : declared->second) streams[name] = to_json(stream.fields);
  }
  const auto parallelism = now.parallelism.find(component.id);
  return {{"id", component.id},
          {"kind", component.spout ? "spout" : "bolt"},
          {"parallelism", parallelism == now.parallelism.end() ? component.parallelism : parallelism->second},
          {"tasks", component.tasks},
          {"inputs", inputs},
          {"streams", streams}};
}

/// Whether bytes are UTF-8 without control characters, but for line ends and TAB.
bool is_text(std::string_view bytes) {
  const auto controls = [](char c) {
    const auto byte = static_cast<unsigned char>(c);
    return byte == 0x7F || (byte < 0x20 && c != '\n' && c != '\r' && c != '\t');
  };
  if (bytes.empty() || bytes.size() > most_text || std::any_of(bytes.begin(), bytes.end(), controls)) return false;
  try {
    static_cast<void>(Json(bytes).dump());  // throws for what is not UTF-8
    return true;
  } catch (const Json::exception&) {
    return false;
  }
}

std::string hex_of(std::string_view bytes) {
  constexpr std::string_view digits = "0123456789abcdef";
  std::string hex;
  hex.reserve(bytes.size() * 3);
  for (const char byte : bytes) {
    if (!hex.empty()) hex += ' ';
    hex += digits[static_cast<unsigned char>(byte) >> 4U];
    hex += digits[static_cast<unsigned char>(byte) & 0xFU];
  }
  return hex;
}

Json to_json(const Value& value, std::size_t shown_bytes) {
  struct Show {
    std::size_t shown_bytes;
    Json operator()(std::monostate) const { return nullptr; }
    Json operator()(bool is) const { return is; }
    Json operator()(std::int64_t number) const { return number; }
    Json operator()(double number) const { return number; }
    Json operator()(const std::string& text) const {
      if (text.size() <= shown_text) return text;
      return text.substr(0, shown_text) + fmt::format("... ({} B)", text.size());
    }
    Json operator()(const Payload& payload) const {
      const std::string_view bytes = payload.text();
      Json shown = {{"bytes", bytes.size()}, {"hex", hex_of(bytes.substr(0, shown_bytes))}};
      if (is_text(bytes)) shown["text"] = (*this)(std::string(bytes));
      return shown;
    }
  };
  return std::visit(Show{shown_bytes}, value);
}

}  // namespace

std::string describe(const Runtime& runtime, const std::string& worker, const std::vector<BrokerWatch::Link>& brokers,
                     const std::map<std::string, std::shared_ptr<const Arrivals>>& arrivals) {
  const Snapshot now = runtime.snapshot();
  Json components = Json::array();
  for (const ComponentSpec& component : runtime.topology().components) {
    components.push_back(to_json(component, runtime.topology(), now));
  }
  Json tasks = Json::array();
  for (const TaskSnapshot& task : now.tasks) tasks.push_back(to_json(task));
  Json links = Json::array();
  for (const BrokerWatch::Link& link : brokers) {
    links.push_back({{"broker", link.broker},
                     {"url", link.url},
                     {"state", to_string(link.state)},
                     {"since_ms", link.since_ms},
                     {"why", link.why}});
  }
  Json coming = Json::array();
  for (const auto& [component, of] : arrivals) coming.push_back(to_json(component, of->facts()));
  Json troubles = Json::array();
  for (const auto& [component, text] : now.troubles) troubles.push_back({{"component", component}, {"text", text}});
  return to_text({{"topology", now.topology},
                  {"worker", worker},
                  {"active", now.active},
                  {"brokers", links},
                  {"arrivals", coming},
                  {"troubles", troubles},
                  {"components", components},
                  {"tasks", tasks}});
}

std::string describe(const Tuple& tuple, int task, std::int64_t wall_ms, std::size_t shown_bytes) {
  Json fields = Json::object();
  for (std::size_t i = 0; i < tuple.size(); ++i) {
    fields[i < tuple.fields().size() ? tuple.fields()[i] : std::to_string(i)] = to_json(tuple.at(i), shown_bytes);
  }
  return to_text({{"time_ms", wall_ms},
                  {"task", task},
                  {"source", tuple.source_component()},
                  {"stream", tuple.source_stream()},
                  {"fields", fields}});
}

/// One tap. The runtime's call and the polls share it; `tap` is destroyed first, so that no call comes any more.
struct TapDesk::Entry {
  config::Mutex mutex;
  std::deque<std::string> samples IOTCLOUD_GUARDED_BY(mutex);
  std::size_t bytes IOTCLOUD_GUARDED_BY(mutex) = 0;  ///< of the samples
  std::uint64_t missed IOTCLOUD_GUARDED_BY(mutex) = 0;
  config::Clock::Instant last_poll{};  ///< guarded by the desk's mutex
  /// For a tap of one stream: when each task's next sample is due.
  std::map<int, config::Clock::Instant> next IOTCLOUD_GUARDED_BY(mutex);
  std::unique_ptr<Tap> tap;
};

TapDesk::TapDesk(Runtime& runtime, Options options)
    : runtime_(runtime),
      options_(options),
      clock_(options.clock != nullptr ? *options.clock : config::system_clock()),
      sweeper_([this](const std::stop_token& stop) {
        while (!stop.stop_requested()) {
          {
            const config::MutexLock lock(mutex_);
            changed_.wait(mutex_, stop, [this]() IOTCLOUD_REQUIRES(mutex_) { return !taps_.empty(); });
            changed_.wait_for(mutex_, stop, sweep_period, [] { return false; });
          }
          expire();
        }
      }) {}

TapDesk::~TapDesk() {
  sweeper_.request_stop();
  sweeper_.join();
}

std::string TapDesk::poll(const std::string& id, const std::string& component, const std::string& stream,
                          double per_second, std::size_t shown_bytes) {
  const EntryPtr entry = find(id, component, stream, per_second, shown_bytes);
  std::deque<std::string> samples;
  std::uint64_t missed = 0;
  {
    const config::MutexLock lock(entry->mutex);
    samples.swap(entry->samples);
    entry->bytes = 0;
    missed = std::exchange(entry->missed, 0);
  }
  return fmt::format("{{\"samples\":[{}],\"missed\":{}}}", fmt::join(samples, ","), missed);
}

TapDesk::EntryPtr TapDesk::find(const std::string& id, const std::string& component, const std::string& stream,
                                double per_second, std::size_t shown_bytes) {
  const config::MutexLock lock(mutex_);
  EntryPtr& entry = taps_[id];
  if (entry) {
    entry->last_poll = clock_.now();
    return entry;
  }
  try {
    if (id.empty()) throw std::invalid_argument("a tap has an id");
    if (!(per_second > 0)) throw std::invalid_argument("the rate of a tap is above 0");
    if (taps_.size() > options_.most_taps)
      throw std::invalid_argument(fmt::format("{} taps are open, which is the limit", options_.most_taps));
    auto made = std::make_shared<Entry>();
    made->last_poll = clock_.now();
    const auto call = [this, to = made.get(), stream, per_second, shown_bytes](const Tuple& tuple, int task) {
      if (!stream.empty()) {
        if (tuple.source_stream() != stream) return;
        const auto now = clock_.now();
        const config::MutexLock next_lock(to->mutex);
        if (now < to->next[task]) return;
        to->next[task] =
            now + std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::duration<double>(1 / per_second));
      }
      std::string sample = describe(tuple, task, clock_.wall_ms(), shown_bytes);
      const config::MutexLock sample_lock(to->mutex);
      to->bytes += sample.size();
      to->samples.push_back(std::move(sample));
      while (to->samples.size() > options_.most_samples ||
             (to->bytes > options_.most_sample_bytes && to->samples.size() > 1)) {
        to->bytes -= to->samples.front().size();
        to->samples.pop_front();
        ++to->missed;
      }
    };
    // The runtime limits the rate of all streams together. For a tap of one stream this class does it, so that other
    // streams' tuples do not use the rate up.
    const double rate = stream.empty() ? per_second : std::numeric_limits<double>::infinity();
    made->tap = runtime_.tap(component, rate, call);
    entry = std::move(made);
  } catch (...) {
    taps_.erase(id);
    throw;
  }
  changed_.notify_all();
  return entry;
}

void TapDesk::end(const std::string& id) {
  EntryPtr ended;
  const config::MutexLock lock(mutex_);
  const auto found = taps_.find(id);
  if (found == taps_.end()) return;
  ended = std::move(found->second);
  taps_.erase(found);
}

void TapDesk::expire() {
  std::vector<EntryPtr> ended;  // destroyed after the lock is released
  const config::MutexLock lock(mutex_);
  const auto oldest = clock_.now() - options_.patience;
  for (auto tap = taps_.begin(); tap != taps_.end();) {
    if (tap->second->last_poll >= oldest) {
      ++tap;
      continue;
    }
    ended.push_back(std::move(tap->second));
    tap = taps_.erase(tap);
  }
}

std::size_t TapDesk::open() const {
  const config::MutexLock lock(mutex_);
  return taps_.size();
}

}  // namespace iotcloud::topology

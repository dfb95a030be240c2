#include <algorithm>
#include <charconv>
#include <stdexcept>

#include <nlohmann/json.hpp>

#include <iotcloud/config/clock_name.h>
#include <iotcloud/config/exposure.h>
#include <iotcloud/topology/endpoints/receiving/arrivals.h>
#include <iotcloud/topology/endpoints/receiving/message_traces.h>
#include <iotcloud/topology/worker/page_requests.h>

namespace iotcloud::topology {

namespace {

using Json = nlohmann::ordered_json;

/// More samples of a tap would slow the topology down.
constexpr double most_samples_a_second = 1000;
constexpr std::size_t most_shown_bytes = 262'144;
constexpr std::int64_t longest_pause_ms = 3'600'000;

std::string word(const PageQuery& query, const char* key) {
  const auto found = query.find(key);
  return found == query.end() ? std::string() : found->second;
}

template <typename Number>
Number number(const PageQuery& query, const char* key, Number otherwise) {
  const std::string text = word(query, key);
  if (text.empty()) return otherwise;
  Number value{};
  const auto [end, problem] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (problem != std::errc() || end != text.data() + text.size())
    throw std::invalid_argument(std::string(key) + " is no number: \"" + text.substr(0, 40) + "\"");
  return value;
}

double us(std::int64_t ns) {
  return static_cast<double>(ns) / 1000;
}

Json to_json(const MessageWay::Step& step) {
  return {{"component", step.component},
          {"task", step.task},
          {"from", step.from},
          {"stream", step.stream},
          {"emitted_us", us(step.emitted_ns)},
          {"begin_us", us(step.begin_ns)},
          {"end_us", us(step.end_ns)},
          {"settled_us", us(step.settled_ns)},
          {"acked", step.acked}};
}

Json to_json(const MessageWay& way) {
  Json steps = Json::array();
  for (const auto& step : way.steps) steps.push_back(to_json(step));
  return {{"driver", way.driver},         {"gateway", way.gateway},       {"time_ms", way.time_ms},
          {"topic", way.topic},           {"spout", way.spout},           {"came_us", us(way.came_ns)},
          {"taken_us", us(way.taken_ns)}, {"done_us", us(way.done_ns)},   {"outcome", way.outcome},
          {"tries", way.tries},           {"more_steps", way.more_steps}, {"steps", std::move(steps)}};
}

}  // namespace

std::string tap_page(Worker& worker, const PageQuery& query) {
  if (!word(query, "end").empty()) {
    worker.taps().end(word(query, "id"));
    return "{}";
  }
  const double per_second = std::min(number(query, "rate", 10.0), most_samples_a_second);
  const auto bytes = std::min(number(query, "bytes", usual_shown_bytes), most_shown_bytes);
  return worker.taps().poll(word(query, "id"), word(query, "component"), word(query, "stream"), per_second, bytes);
}

std::string trace_page(Worker& worker, const PageQuery& query) {
  if (!word(query, "end").empty()) {
    worker.traces().end(word(query, "id"));
    return "{}";
  }
  const auto every = std::min(number(query, "every_ms", std::int64_t{200}), longest_pause_ms);
  const auto answer = worker.traces().poll({word(query, "id"), word(query, "driver"), every});
  const config::Clock& clock = worker.clock();
  const std::int64_t now_us =
      std::chrono::duration_cast<std::chrono::microseconds>(clock.now().time_since_epoch()).count();
  Json ways = Json::array();
  for (const auto& way : answer.ways) ways.push_back(to_json(way));
  const Json page{{"topology", worker.topology()},
                  {"worker", worker.name()},
                  {"host", config::host_name()},
                  {"clock", config::system_clock_name()},
                  {"wall_us", clock.wall_ms() * 1000 - now_us},
                  {"missed", answer.missed},
                  {"ways", std::move(ways)}};
  return page.dump(-1, ' ', false, Json::error_handler_t::replace);
}

std::string units_page(const Worker& worker) {
  Json spouts = Json::array();
  for (const auto& [component, arrivals] : worker.arrivals()) {
    const ReadUnits read = arrivals->units();
    Json units = Json::array();
    for (const auto& [name, task] : read.units) units.push_back({{"unit", name}, {"task", task}});
    spouts.push_back({{"component", component}, {"units", std::move(units)}, {"more", read.more}});
  }
  const Json page{{"topology", worker.topology()}, {"worker", worker.name()}, {"spouts", std::move(spouts)}};
  return page.dump(-1, ' ', false, Json::error_handler_t::replace);
}

}  // namespace iotcloud::topology

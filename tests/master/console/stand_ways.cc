#include <atomic>
#include <cstdint>

#include <nlohmann/json.hpp>

#include <iotcloud/tests/master/console/stand_ways.h>

namespace iotcloud::master {

namespace {

using Json = nlohmann::json;

constexpr std::int64_t begun_ms = 1'790'000'000'000;
constexpr std::int64_t wall_us = 1'789'000'000'000'000;  ///< of the driver hosts' machine
std::atomic<std::int64_t> number{0};                     ///< of the latest message

std::int64_t time_ms() {
  return begun_ms + 200 * number.load();
}
/// When the message was published, by the driver hosts' machine.
std::int64_t published_us() {
  return time_ms() * 1000 - wall_us + 400;
}

}  // namespace

Json timed_look(bool incoming, const std::string& hostile) {
  const std::int64_t from = published_us();
  Json message{
      {"number", number.load()}, {"seen_ms", time_ms()}, {"time_ms", time_ms()}, {"size", 61'440}, {"payload", ""}};
  if (incoming) {
    message.update({{"came_us", from + 5000}, {"begin_us", from + 5200}, {"end_us", from + 5300}, {"fate", "handled"}});
  } else {
    message.update(
        {{"begin_us", from}, {"end_us", from + 700}, {"fate", number % 2 == 0 ? "confirmed" : "dropped: " + hostile}});
  }
  return Json{
      {"state", "active"}, {"elapsed_us", 1},    {"count", number.load()}, {"bytes", 1},
      {"missed", 0},       {"smallest", 1},      {"largest", 1},           {"channels", Json::array()},
      {"host", "lab1"},    {"clock", "of lab1"}, {"wall_us", wall_us},     {"messages", Json::array({message})}};
}

Json trace_page(bool near, const std::string& hostile) {
  ++number;
  // A far worker's clock counts from another time, and is 2 ms ahead.
  const std::int64_t offset = near ? 0 : 77'000'000;
  const auto at = [&](std::int64_t after) { return static_cast<double>(published_us() + after - offset); };
  const auto step = [&](const std::string& component, const std::string& from, std::int64_t emitted, bool later) {
    return Json{{"component", component},
                {"task", 3},
                {"from", from},
                {"stream", "default"},
                {"emitted_us", at(emitted)},
                {"begin_us", at(emitted + 100)},
                {"end_us", at(emitted + 900)},
                {"settled_us", at(emitted + (later ? 1500 : 900))},
                {"acked", true}};
  };
  const Json way{{"driver", "1"},
                 {"gateway", "gateway-2"},
                 {"time_ms", time_ms()},
                 {"topic", "gateway-2.meter.1.data"},
                 {"spout", "kinect"},
                 {"came_us", at(1000)},
                 {"taken_us", at(1050)},
                 {"done_us", at(4600)},
                 {"outcome", "acked"},
                 {"tries", 1},
                 {"more_steps", 0},
                 {"steps",
                  {step("decode", "kinect", 1060, false), step(hostile, "decode", 1900, false),
                   step("commands", hostile, 2800, true)}}};
  return Json{{"topology", "follow"},
              {"worker", "lab1-4711"},
              {"host", near ? "lab1" : hostile},
              {"clock", near ? "of lab1" : "of lab2"},
              {"wall_us", wall_us + offset + (near ? 0 : 2000)},
              {"missed", 0},
              {"ways", {way}}};
}

Json units_page(const std::string& hostile) {
  return Json{{"topology", "follow"},
              {"worker", "lab1-4711"},
              {"spouts",
               {{{"component", "kinect"},
                 {"units", {{{"unit", "gateway-1.turtle"}, {"task", 0}}, {{"unit", hostile}, {"task", 1}}}},
                 {"more", 4}}}}};
}

}  // namespace iotcloud::master

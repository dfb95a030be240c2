#include <algorithm>
#include <charconv>
#include <cmath>
#include <map>
#include <string>

#include <fmt/format.h>

#include <iotcloud/gateway/host/round_trips.h>

namespace iotcloud::gateway {

namespace {

constexpr const char* bucket_metric = "iotcloud_driver_round_trip_seconds_bucket";
constexpr const char* help = "Messages of drivers that were answered within so many seconds";
constexpr const char* end_label = "le";
constexpr const char* no_end = "+Inf";
/// The upper ends are quarters of the octaves from 33 us to 69 s.
constexpr int first_octave = 15, last_octave = 35, quarters = 4;
constexpr double ns_per_s = 1e9, us_per_s = 1e6, ms_per_s = 1e3;

double number_of(const std::string& end) {
  double number = HUGE_VAL;  // of +Inf, too
  std::from_chars(end.data(), end.data() + end.size(), number);
  return number;
}

}  // namespace

bool RoundTrips::is_before(std::int64_t time_ms, const Sent& sent) {
  return time_ms < sent.time_ms;
}

void RoundTrips::sent(std::int64_t time_ms, config::Clock::Instant now) {
  const config::MutexLock lock(mutex_);
  while (!sent_.empty() && (sent_.front().answered || sent_.size() >= most || now - sent_.front().at > longest))
    sent_.pop_front();
  sent_.insert(std::upper_bound(sent_.begin(), sent_.end(), time_ms, is_before), {time_ms, now, false});
}

void RoundTrips::refused(std::int64_t time_ms) {
  const config::MutexLock lock(mutex_);
  const auto behind = std::upper_bound(sent_.begin(), sent_.end(), time_ms, is_before);
  if (behind != sent_.begin() && std::prev(behind)->time_ms == time_ms) sent_.erase(std::prev(behind));
}

std::optional<config::Clock::Instant::duration> RoundTrips::came(std::int64_t time_ms, config::Clock::Instant now) {
  const config::MutexLock lock(mutex_);
  auto found = std::lower_bound(sent_.begin(), sent_.end(), time_ms,
                                [](const Sent& sent, std::int64_t time) { return sent.time_ms < time; });
  while (found != sent_.end() && found->time_ms == time_ms && found->answered) ++found;
  if (found == sent_.end() || found->time_ms != time_ms || now - found->at > longest) return std::nullopt;
  found->answered = true;
  const auto took = now - found->at;
  while (!sent_.empty() && sent_.front().answered) sent_.pop_front();
  return took;
}

void append_round_trips(const config::Histogram& round_trips, const std::string& plugin,
                        std::vector<config::Sample>& samples) {
  const auto spread = round_trips.spread();
  if (spread.empty()) return;
  auto next = spread.begin();
  std::uint64_t count = 0;
  const auto add = [&](double end_ns, std::string end) {
    for (; next != spread.end() && next->first <= end_ns; ++next) count += next->second;
    config::Sample sample;
    sample.name = bucket_metric;
    sample.help = help;
    sample.labels = {{"plugin", plugin}, {end_label, std::move(end)}};
    sample.value = static_cast<double>(count);
    samples.push_back(std::move(sample));
  };
  for (int octave = first_octave; octave <= last_octave; ++octave) {
    for (int quarter = 1; quarter <= quarters; ++quarter) {
      const double end = std::ldexp(quarters + quarter, octave) / quarters;
      add(end, fmt::format("{}", end / ns_per_s));
    }
  }
  add(HUGE_VAL, no_end);
}

std::vector<discovery::CarriedMessages> carried_messages(const std::vector<config::Sample>& samples) {
  struct Host {
    discovery::CarriedMessages carried;
    std::map<double, double> within;  ///< by upper end in seconds: what took no longer
  };
  std::map<std::string, Host> hosts;
  const auto label = [](const config::Sample& sample, const char* name) {
    const auto found = sample.labels.find(name);
    return found == sample.labels.end() ? std::string() : found->second;
  };
  const auto of = [&](const config::Sample& sample) -> Host& { return hosts[label(sample, "host")]; };
  for (const auto& sample : samples) {
    const auto count = static_cast<std::uint64_t>(sample.value);
    if (sample.name == "iotcloud_driver_messages_total" && label(sample, "outcome") == "confirmed") {
      of(sample).carried.sent += count;
    } else if (sample.name == "iotcloud_driver_received_total") {
      of(sample).carried.received += count;
    } else if (sample.name == bucket_metric) {
      of(sample).within[number_of(label(sample, end_label))] += sample.value;
    } else if (sample.name == samples_age_metric) {
      of(sample).carried.age = std::chrono::milliseconds(std::llround(sample.value * ms_per_s));
    }
  }
  std::vector<discovery::CarriedMessages> all;
  for (auto& [name, host] : hosts) {
    host.carried.host = name;
    double before = 0;
    for (const auto& [end, count] : host.within) {
      if (count > before) host.carried.round_trips[end * us_per_s] = static_cast<std::uint64_t>(count - before);
      before = count;
    }
    if (host.carried.sent > 0 || host.carried.received > 0) all.push_back(std::move(host.carried));
  }
  return all;
}

}  // namespace iotcloud::gateway

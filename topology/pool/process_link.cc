#include <utility>

#include <fmt/format.h>

#include <iotcloud/topology/pool/process_link.h>

namespace iotcloud::topology {

using std::chrono::milliseconds;

namespace {

constexpr milliseconds stop_margin{2000};

}  // namespace

ProcessLink::ProcessLink(Options options, const processes::VitalLimits& limits, processes::ChildProcess process,
                         WorkerEvents events)
    : options_(std::move(options)),
      events_(std::move(events)),
      watch_({options_.folder, pooled::socket_name, options_.ping_period, options_.hang_limit, stop_margin, limits, ""},
             std::move(process),
             {[this](const std::string& body) { heard(pooled::decode_report(body)); },
              [this] {
                if (options_.keep_log) options_.keep_log();
                watch_.send(pooled::encode(pooled::PoolCommand{}));
              },
              [this](const processes::WatchedEnd& end) { ended(end); }}) {}

void ProcessLink::stop(milliseconds limit) {
  watch_.stop(pooled::encode(pooled::PoolCommand{true}), limit);
}

/// Kills the worker if one call of a component takes too long. The worker says so twice, because a machine that stood
/// still makes a short call look long, once.
void ProcessLink::heard(const pooled::WorkerReport& report) {
  const bool is_long = options_.call_limit.count() > 0 && report.call_ms > options_.call_limit.count();
  long_calls_ = is_long ? long_calls_ + 1 : 0;
  if (long_calls_ >= 2) {
    watch_.kill(
        fmt::format("hung: {}/{} did not return from a call for {} ms", report.component, report.task, report.call_ms));
  }
  events_.on_report(report);
}

void ProcessLink::ended(const processes::WatchedEnd& end) {
  const auto word = pooled::read_end(options_.folder);
  pooled::remove_worker(options_.folder);
  if (end.told) {
    events_.on_ended({WorkerEnding::How::stopped, end.killed});
  } else if (!end.killed.empty()) {
    events_.on_ended({WorkerEnding::How::failed, end.killed});
  } else if (word) {
    events_.on_ended({word->refused ? WorkerEnding::How::refused : WorkerEnding::How::failed, word->reason});
  } else {
    events_.on_ended({WorkerEnding::How::failed, end.how});
  }
}

}  // namespace iotcloud::topology

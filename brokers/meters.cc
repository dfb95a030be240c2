#include "iotcloud/brokers/meters.h"

namespace iotcloud::brokers {
namespace {

constexpr const char* outcomes_name = "iotcloud_broker_outcomes_total";
constexpr const char* outcomes_help = "What became of messages that publishers accepted";

const char* word(Outcome outcome) {
  switch (outcome) {
    case Outcome::confirmed:
      return "confirmed";
    case Outcome::refused:
      return "refused";
    case Outcome::dropped:
      return "dropped";
    case Outcome::unknown:
      return "unknown";
  }
  return "unknown";
}

}  // namespace

Meters::Meters(config::Metrics* metrics, const std::string& kind)
    : metrics_(metrics != nullptr ? *metrics : config::process_metrics()),
      kind_(kind),
      confirmed_(metrics_.counter(outcomes_name, outcomes_help,
                                  {{"broker", kind}, {"outcome", word(Outcome::confirmed)}, {"reason", ""}})),
      received_(
          metrics_.counter("iotcloud_broker_received_total", "Messages handed to subscriptions", {{"broker", kind}})),
      redelivered_(metrics_.counter("iotcloud_broker_redelivered_total",
                                    "Of those received: possibly not the first time", {{"broker", kind}})),
      conflated_(metrics_.counter("iotcloud_broker_conflated_total", "Deliveries skipped for newer ones (keep_last)",
                                  {{"broker", kind}})) {}

void Meters::outcome(Outcome outcome, const std::string& reason) {
  if (outcome == Outcome::confirmed) {
    confirmed_.add();
    return;
  }
  // A server's own text for a refusal goes to the log and the callback, not into a label.
  const std::string label = outcome == Outcome::dropped ? reason : std::string();
  metrics_.counter(outcomes_name, outcomes_help, {{"broker", kind_}, {"outcome", word(outcome)}, {"reason", label}})
      .add();
}

void Meters::received(bool redelivered) {
  received_.add();
  if (redelivered) redelivered_.add();
}

void Meters::conflated() {
  conflated_.add();
}

void Meters::overtook() {
  metrics_
      .counter("iotcloud_broker_overtook_total",
               "Messages that the server confirmed before earlier ones of their topic", {{"broker", kind_}})
      .add();
}

void Meters::skipped(const std::string& reason) {
  metrics_
      .counter("iotcloud_broker_skipped_total", "Received records that no handler got",
               {{"broker", kind_}, {"reason", reason}})
      .add();
}

}  // namespace iotcloud::brokers

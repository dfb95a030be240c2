#include "iotcloud/brokers/client/outcome_reporter.h"

#include <algorithm>
#include <exception>
#include <utility>
#include <vector>

#include <iotcloud/config/log.h>

namespace iotcloud::brokers::client {
namespace {

const config::Logger logger{"brokers"};

}  // namespace

void OutcomeReporter::note(const std::shared_ptr<Outbox>& outbox) {
  if (outbox->in_report || !outbox->has_report()) return;
  outbox->in_report = true;
  to_report_.push_back(outbox);
}

void OutcomeReporter::report(const std::shared_ptr<Outbox>& outbox, Lock& lock) {
  changed_.wait(lock, [&] { return !outbox->reporting; });
  if (std::exchange(outbox->in_report, false)) std::erase(to_report_, outbox);
  bool writable = false;
  const std::vector<Outbox::Event> events = outbox->take_events(writable);
  if (events.empty() && !writable) return;
  outbox->reporting = true;
  lock.unlock();
  for (const auto& event : events) meters_.outcome(event.outcome, event.reason);
  try {
    if (outbox->options.on_outcome) {
      for (const auto& event : events) outbox->options.on_outcome(event.number, event.outcome, event.reason);
    }
    if (writable && outbox->options.on_writable) outbox->options.on_writable();
  } catch (const std::exception& error) {
    logger.error("a callback of the publisher of topic {} threw: {}", outbox->topic.name, error.what());
  } catch (...) {
    logger.error("a callback of the publisher of topic {} threw", outbox->topic.name);
  }
  lock.lock();
  outbox->reporting = false;
  outbox->reported(events.size());
  changed_.notify_all();
}

void OutcomeReporter::report_all(Lock& lock) {
  while (!to_report_.empty()) {
    const std::shared_ptr<Outbox> outbox = to_report_.front();
    report(outbox, lock);
  }
}

bool OutcomeReporter::drain(const std::shared_ptr<Outbox>& outbox, std::chrono::milliseconds limit, Lock& lock) {
  const auto end = std::chrono::system_clock::now() + limit;
  while (outbox->pending() > 0) {
    if (outbox->has_report() && !outbox->reporting) {
      report(outbox, lock);
    } else if (changed_.wait_until(lock, end) == std::cv_status::timeout) {
      return outbox->pending() == 0;
    }
  }
  return true;
}

}  // namespace iotcloud::brokers::client

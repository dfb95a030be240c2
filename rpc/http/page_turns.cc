#include <algorithm>

#include <iotcloud/rpc/http/page_turns.h>

namespace iotcloud::rpc {

using config::Clock;

namespace {

/// One reader has one of so many parts of the thread's time.
constexpr int parts = 4;
/// After a pause so much of the thread's time is a reader's at once.
constexpr std::chrono::seconds at_once{1};
/// What each answer costs besides its page: to read the request, and to encrypt and send.
constexpr std::chrono::milliseconds of_each{1};
constexpr std::size_t few_readers = 1'000;

}  // namespace

Clock::Instant::duration PageTurns::wait(const std::string& reader) const {
  const auto due = due_.find(reader);
  if (due == due_.end()) return Clock::Instant::duration::zero();
  return std::max(due->second - at_once * parts - clock_.now(), Clock::Instant::duration::zero());
}

void PageTurns::took(const std::string& reader, Clock::Instant::duration time) {
  const auto now = clock_.now();
  if (due_.size() >= few_readers) std::erase_if(due_, [&](const auto& one) { return one.second <= now; });
  auto& due = due_[reader];
  due = std::max(due, now) + (time + of_each) * parts;
}

}  // namespace iotcloud::rpc

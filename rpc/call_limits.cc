#include <algorithm>

#include <iotcloud/rpc/call_limits.h>

namespace iotcloud::rpc {

using config::Clock;

namespace {

constexpr std::size_t few_accounts = 1'000;

}  // namespace

std::shared_ptr<CallLimits::Account> CallLimits::account(const std::string& identity) {
  const config::MutexLock lock(mutex_);
  if (accounts_.size() >= forget_at_ && !accounts_.contains(identity)) forget_idle();
  auto& account = accounts_[identity];
  if (!account) account = std::make_shared<Account>();
  return account;
}

/// Removes accounts that say nothing which a new one would not say: none of their calls runs or waits, and none is
/// owed.
void CallLimits::forget_idle() {
  const auto now = clock_.now();
  std::erase_if(accounts_, [&](const auto& entry) {
    Account& account = *entry.second;
    if (entry.second.use_count() > 1) return false;  // of a call
    const config::MutexLock lock(account.mutex);
    return account.due <= now;
  });
  forget_at_ = 2 * accounts_.size() + few_accounts;
}

std::size_t CallLimits::remembered() const {
  const config::MutexLock lock(mutex_);
  return accounts_.size();
}

std::shared_ptr<void> CallLimits::enter(const std::string& identity) {
  auto of_identity = account(identity);
  Account& of = *of_identity;
  const auto period =
      std::chrono::duration_cast<Clock::Instant::duration>(std::chrono::duration<double>(1 / options_.per_second));
  const auto ahead = options_.saved - period;
  const auto now = clock_.now();
  const auto end = now + options_.longest_wait;
  const config::MutexLock lock(of.mutex);
  const auto due = std::max(of.due, now);
  const auto turn = due - ahead;
  if (turn > end) return nullptr;
  of.due = due + period;
  while (clock_.now() < turn) of.changed.wait_until(of.mutex, clock_, turn);
  while (of.running >= options_.at_once) {
    if (clock_.now() >= end) return nullptr;
    of.changed.wait_until(of.mutex, clock_, end);
  }
  ++of.running;
  return {static_cast<void*>(&of), [of_identity](void*) {
            Account& left = *of_identity;
            {
              const config::MutexLock held(left.mutex);
              --left.running;
            }
            left.changed.notify_all();
          }};
}

CallsByRole usual_calls() {
  using security::Role;
  // Orders wait for their outcome, each on a connection of its own: a server's limit of connections is theirs, too.
  const CallLimits::Options acting{.at_once = 1'000, .per_second = 1'000};
  return {{Role::viewer, {}}, {Role::master, acting}, {Role::operating, acting}, {Role::admin, acting}};
}

CallLimits::Options usual_token_tries(std::chrono::milliseconds longest_wait) {
  return {.at_once = 1, .per_second = 2, .saved = std::chrono::seconds{10}, .longest_wait = longest_wait};
}

RoleLimits::RoleLimits(const CallsByRole& calls) {
  for (const auto& [role, options] : calls) limits_.try_emplace(role, options);
  limits_.try_emplace(security::Role::anyone, CallLimits::Options{.at_once = 64});
}

std::shared_ptr<void> RoleLimits::enter(security::Role role, const std::string& identity) {
  const auto limits = limits_.find(role);
  return limits == limits_.end() ? unlimited_ : limits->second.enter(identity);
}

}  // namespace iotcloud::rpc

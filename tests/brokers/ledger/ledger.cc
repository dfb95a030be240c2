#include "iotcloud/tests/brokers/ledger/ledger.h"

#include <atomic>
#include <charconv>
#include <iostream>
#include <mutex>
#include <semaphore>
#include <string_view>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

#include "iotcloud/tests/eventually.h"

namespace iotcloud::brokers {
namespace {

using Clock = std::chrono::steady_clock;

constexpr std::size_t topics = 3;
constexpr std::size_t keys = 4;
constexpr std::chrono::microseconds period{2500};  // between two messages of a topic
using tests::patience;

std::string body_of(std::uint64_t number) {
  constexpr std::size_t large = 60'000;
  const std::size_t size = number % 50 == 0 ? large : 20 + number * 37 % 500;
  std::string body = std::to_string(number) + " ";
  body.resize(std::max(size, body.size()), static_cast<char>('a' + number % 26));
  return body;
}

/// One topic: what its publisher sent and its reader received. Message number n (1, 2, ...) has the key n % keys.
class Account {
 public:
  explicit Account(std::size_t gaps_from_bytes) : gaps_from_bytes_(gaps_from_bytes) {}

  void outcome(std::uint64_t number, Outcome outcome) {
    const std::lock_guard lock(mutex_);
    Entry& entry = at(number);
    if (outcome == Outcome::confirmed) entry.confirmed = true;
    if (outcome == Outcome::refused || outcome == Outcome::dropped) ++refused_;
  }

  void received(const Delivery& delivery) {
    const std::string_view body = delivery.message.payload.text();
    std::uint64_t number = 0;
    std::from_chars(body.data(), body.data() + body.size(), number);
    const std::lock_guard lock(mutex_);
    if (number == 0 || number > 100'000'000 || body != body_of(number) ||
        delivery.message.driver_id != key_of(number)) {
      ++damaged_;
      return;
    }
    Entry& entry = at(number);
    if (entry.received++ > 0) {
      ++(delivery.redelivered ? duplicated_ : duplicated_unmarked_);
      return;
    }
    std::uint64_t& last = last_[number % keys];
    if (number < last) ++(delivery.redelivered && body.size() >= gaps_from_bytes_ ? gaps_ : out_of_order_);
    last = std::max(last, number);
  }

  static std::string key_of(std::uint64_t number) { return "driver-" + std::to_string(number % keys); }

  bool complete() const {
    const std::lock_guard lock(mutex_);
    for (const Entry& entry : entries_) {
      if (entry.confirmed && entry.received == 0) return false;
    }
    return true;
  }

  void add_to(Ledger& ledger, std::uint64_t sent) const {
    const std::lock_guard lock(mutex_);
    ledger.sent += sent;
    std::uint64_t confirmed = 0;
    for (const Entry& entry : entries_) {
      confirmed += entry.confirmed ? 1 : 0;
      ledger.received += entry.received > 0 ? 1 : 0;
      ledger.lost += entry.confirmed && entry.received == 0 ? 1 : 0;
    }
    ledger.confirmed += confirmed;
    ledger.unanswered += sent - confirmed - refused_;
    ledger.refused += refused_;
    ledger.duplicated += duplicated_;
    ledger.duplicated_unmarked += duplicated_unmarked_;
    ledger.out_of_order += out_of_order_;
    ledger.gaps += gaps_;
    ledger.damaged += damaged_;
  }

 private:
  struct Entry {
    bool confirmed = false;
    std::uint32_t received = 0;
  };
  Entry& at(std::uint64_t number) {
    if (entries_.size() < number) entries_.resize(number);
    return entries_[number - 1];
  }

  const std::size_t gaps_from_bytes_;
  mutable std::mutex mutex_;
  std::vector<Entry> entries_;
  std::uint64_t last_[keys] = {};
  std::uint64_t refused_ = 0;
  std::uint64_t duplicated_ = 0;
  std::uint64_t duplicated_unmarked_ = 0;
  std::uint64_t out_of_order_ = 0;
  std::uint64_t gaps_ = 0;
  std::uint64_t damaged_ = 0;
};

/// Sends at a steady pace until told to stop; waits when the publisher is full.
class Sender {
 public:
  Sender(Broker& broker, const Topic& topic, Account& account) {
    PublisherOptions options;
    options.capacity = 2000;
    options.on_outcome = [&account](std::uint64_t number, Outcome outcome, const std::string&) {
      account.outcome(number, outcome);
    };
    options.on_writable = [this] { writable_.release(); };
    publisher_ = broker.publisher(topic, options);
    thread_ = std::jthread([this](const std::stop_token& stop) { run(stop); });
  }

  void stop() {
    thread_.request_stop();
    thread_.join();
  }
  bool drain() { return publisher_->drain(patience); }
  std::uint64_t sent() const { return sent_; }

 private:
  void run(const std::stop_token& stop) {
    Clock::time_point due = Clock::now();
    while (!stop.stop_requested()) {
      Message message;
      message.payload = Payload::copy(body_of(sent_ + 1));
      message.driver_id = Account::key_of(sent_ + 1);
      if (publisher_->publish(message) == PublishStatus::accepted) {
        ++sent_;
        due = std::max(due + period, Clock::now() - 10 * period);  // after a wait it catches up on some
        std::this_thread::sleep_until(due);
      } else {
        static_cast<void>(writable_.try_acquire_for(std::chrono::milliseconds(100)));
      }
    }
  }

  std::counting_semaphore<> writable_{0};
  std::uint64_t sent_ = 0;  ///< only used by the thread until it has ended
  std::unique_ptr<Publisher> publisher_;
  std::jthread thread_;  ///< destroyed first
};

void torment(const Victim& victim, const LedgerOptions& options, Ledger& ledger) {
  const Clock::time_point end = Clock::now() + options.duration;
  const auto wait = [](std::chrono::milliseconds time) { std::this_thread::sleep_for(time); };
  for (int turn = 0; Clock::now() < end; ++turn) {
    wait(options.calm);
    if (turn % 2 == 0 || !victim.pause) {
      victim.kill();
      ++ledger.kills;
      wait(options.calm / 2);
      victim.start();
    } else {
      victim.pause();
      ++ledger.pauses;
      wait(options.pause);
      victim.resume();
    }
  }
}

}  // namespace

std::ostream& operator<<(std::ostream& out, const Ledger& ledger) {
  return out << "sent " << ledger.sent << ", confirmed " << ledger.confirmed << ", received " << ledger.received
             << ", lost = " << ledger.lost << ", duplicated " << ledger.duplicated << " (and "
             << ledger.duplicated_unmarked << " not marked), out of order = " << ledger.out_of_order << ", gaps "
             << ledger.gaps << ", unanswered " << ledger.unanswered << ", refused " << ledger.refused << ", damaged "
             << ledger.damaged << " (" << ledger.kills << " kills, " << ledger.pauses << " pauses)";
}

Ledger run_ledger(const std::string& kind, const LedgerOptions& options) {
  const Victim victim = make_victim(kind);
  Ledger ledger;
  const auto sending = make_broker(victim.options);
  const auto reading = make_broker(victim.options);
  std::vector<std::unique_ptr<Account>> accounts;
  std::vector<std::unique_ptr<Subscription>> subscriptions;
  std::vector<std::unique_ptr<Sender>> senders;
  SubscriptionOptions group;
  group.group = "ledger";
  for (std::size_t i = 0; i < topics; ++i) {
    const Topic topic{"ledger", "gw.ledger." + std::to_string(i), true};
    accounts.push_back(std::make_unique<Account>(victim.gaps_from_bytes));
    subscriptions.push_back(reading->subscribe(topic, group, [account = accounts.back().get()](Delivery delivery) {
      account->received(delivery);
      delivery.settle(Settlement::accept);
    }));
    EXPECT_TRUE(tests::eventually([&] { return subscriptions.back()->active(); }));
    senders.push_back(std::make_unique<Sender>(*sending, topic, *accounts.back()));
  }
  torment(victim, options, ledger);
  for (const auto& sender : senders) sender->stop();
  for (const auto& sender : senders) EXPECT_TRUE(sender->drain()) << "not everything was answered";
  for (const auto& account : accounts) {
    static_cast<void>(tests::eventually([&] { return account->complete(); }));
  }
  subscriptions.clear();
  for (std::size_t i = 0; i < topics; ++i) accounts[i]->add_to(ledger, senders[i]->sent());
  std::cout << kind << ": " << ledger << std::endl;
  EXPECT_GT(ledger.confirmed, 0U);
  EXPECT_EQ(ledger.lost, 0U);
  EXPECT_EQ(ledger.out_of_order, 0U);
  EXPECT_EQ(ledger.duplicated_unmarked, 0U);
  EXPECT_EQ(ledger.refused, 0U);
  EXPECT_EQ(ledger.damaged, 0U);
  EXPECT_EQ(ledger.unanswered, 0U);
  return ledger;
}

}  // namespace iotcloud::brokers

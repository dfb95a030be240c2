#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "iotcloud/tests/servers/private_server.h"
#include <iotcloud/brokers/broker.h>
#include <iotcloud/tests/eventually.h>

namespace iotcloud::brokers {

/// How long a test waits for something that must come; under sanitizers on a busy machine it may take long.
using tests::patience;
/// How long a test checks that something forbidden does not come.
inline constexpr std::chrono::milliseconds moment{300};
/// Of BrokerContract::broker(). A server gives a silent client up after two heartbeats, and looks once in each.
inline constexpr std::chrono::seconds contract_heartbeat{2};
inline constexpr std::chrono::milliseconds given_up_after = 3 * contract_heartbeat;

/// A server of one kind that a test can stop and start again.
class TestServer {
 public:
  virtual ~TestServer() = default;
  virtual std::string url() const = 0;
  virtual void kill() = 0;
  virtual void start() = 0;
  /// Whether the server confirms and keeps messages that nobody reads; otherwise they wait at the publisher.
  virtual bool keeps_unread() const { return false; }
  /// Options that let several readers share a topic; they share it by key.
  virtual std::map<std::string, std::string> sharing_properties() const { return {}; }
  /// The server's process; null if the server is in this process.
  virtual tests::PrivateServer* process() { return nullptr; }
};

/// Stops the server. The destructor starts it again if the test has not, because other tests share the server.
class Outage {
 public:
  explicit Outage(TestServer& server) : server_(server) { server_.kill(); }
  Outage(const Outage&) = delete;
  Outage& operator=(const Outage&) = delete;
  ~Outage() { end(); }
  void end() {
    if (!std::exchange(ended_, true)) server_.start();
  }

 private:
  TestServer& server_;
  bool ended_ = false;
};

/// Collects deliveries, and accepts each unless the test's Verdict decides otherwise. Thread safe.
class Inbox {
 public:
  struct Received {
    std::string body;
    Message message;
    bool redelivered = false;
  };
  /// Decides how a delivery is settled; called before it is stored.
  using Verdict = std::function<Settlement(const Received&)>;
  explicit Inbox(Verdict verdict = {}) : verdict_(std::move(verdict)) {}

  Handler handler();
  bool wait_for(std::size_t count, std::chrono::milliseconds limit = patience);
  /// Waits until the newest delivery has this body.
  bool wait_for_last(const std::string& body, std::chrono::milliseconds limit = patience);
  bool wait_until(const std::function<bool(const std::vector<Received>&)>& enough,
                  std::chrono::milliseconds limit = patience);
  std::vector<Received> all() const;
  std::vector<std::string> bodies() const;
  std::size_t size() const;

 private:
  mutable std::mutex mutex_;
  std::condition_variable more_;
  std::vector<Received> received_;
  Verdict verdict_;
};

/// Each body once, in the order of first arrival. After a fault a broker may deliver messages again, even several times
/// if the connection is lost again during recovery. Fails the test if such a copy is not marked as redelivered.
std::vector<std::string> firsts(const Inbox& inbox);

/// Keeps deliveries unsettled until the test settles them. Thread safe.
class Holder {
 public:
  Handler handler();
  bool wait_for(std::size_t count, std::chrono::milliseconds limit = patience);
  std::size_t size() const;
  std::string body(std::size_t index) const;
  void settle(std::size_t index, Settlement settlement);
  void drop_all();

 private:
  mutable std::mutex mutex_;
  std::condition_variable more_;
  std::vector<Delivery> held_;
};

/// Collects outcomes by publish number. Thread safe.
class Outcomes {
 public:
  std::function<void(std::uint64_t, Outcome, const std::string&)> callback();
  bool wait_for(std::size_t count, std::chrono::milliseconds limit = patience);
  /// The only outcome of a message; fails the test if there is none or more than one.
  Outcome of(std::uint64_t number) const;
  std::string reason(std::uint64_t number) const;
  std::size_t size() const;  ///< messages with an outcome
  std::size_t count(Outcome outcome) const;
  bool each_once() const;

 private:
  mutable std::mutex mutex_;
  std::condition_variable more_;
  std::map<std::uint64_t, std::vector<std::pair<Outcome, std::string>>> outcomes_;
};

using tests::eventually;  // for the tests that include this: NOLINT(misc-unused-using-decls)

/// "1", "2", ... for messages' bodies, from `from` to `to` inclusive.
std::vector<std::string> numbered(int from, int to);
Message text_message(const std::string& body);
/// Publishes messages with the bodies `numbered(from, to)`; each must be accepted at once.
void publish_numbers(Publisher& publisher, int from, int to);
/// Publishes three numbered messages, and checks that the inbox gets these and has no others.
void expect_arrivals(Publisher& publisher, Inbox& inbox, int from);

/// Every test runs on each kind of broker; all tests of a kind share one server, which runs when a test starts.
class BrokerContract : public testing::TestWithParam<std::string> {
 protected:
  void SetUp() override;
  static void TearDownTestSuite();

  TestServer& server() const;
  std::unique_ptr<Broker> broker(std::map<std::string, std::string> properties = {}) const;
  /// Makes published messages wait at their publisher, until a reader subscribes and the returned object is destroyed.
  /// A server that keeps unread messages is stopped for that time.
  std::unique_ptr<Outage> hold_up(const Broker& broker) const;
  /// A topic that no other test uses.
  Topic topic(bool durable = false) const;
  /// Waits until a subscription is active.
  static void await_active(const Subscription& subscription);
};

}  // namespace iotcloud::brokers

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

/// How long a test waits for what must come; under sanitizers on a busy machine it may take long.
inline constexpr std::chrono::seconds patience{60};
/// How long a test watches that nothing comes which must not come.
inline constexpr std::chrono::milliseconds moment{300};

/// A server of one kind that can be taken away and brought back.
class TestServer {
 public:
  virtual ~TestServer() = default;
  virtual std::string url() const = 0;
  virtual void kill() = 0;
  virtual void start() = 0;
  /// Whether it confirms and keeps what nobody reads yet; otherwise that waits at the publisher.
  virtual bool keeps_unread() const { return false; }
  /// What a broker object needs so that several readers can share a topic; they share it by key.
  virtual std::map<std::string, std::string> sharing_properties() const { return {}; }
  /// The private server behind it; null for one in process.
  virtual tests::PrivateServer* process() { return nullptr; }
};

/// Takes the server away and brings it back at the end in any case: other tests share it.
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

/// Collects deliveries; the handler accepts each unless told otherwise. Thread safe.
class Inbox {
 public:
  struct Received {
    std::string body;
    Message message;
    bool redelivered = false;
  };
  /// Decides what becomes of a delivery; called before it is stored.
  using Verdict = std::function<Settlement(const Received&)>;
  explicit Inbox(Verdict verdict = {}) : verdict_(std::move(verdict)) {}

  Handler handler();
  bool wait_for(std::size_t count, std::chrono::milliseconds limit = patience);
  /// Waits until this body is the newest that came.
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

/// Each body once, in the order in which they came first. After a fault a broker may deliver again what it had
/// delivered, also because the connection is lost once more on its way back: fails the test for a copy without a mark.
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
  /// The only outcome of one message; fails the test when there is none or more than one.
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

using tests::eventually;

/// "1", "2", ... for messages' bodies; both ends included.
std::vector<std::string> numbered(int from, int to);
Message text_message(const std::string& body);

/// Every test runs on each kind of broker; all tests of a kind share one server, which is up at a test's start.
class BrokerContract : public testing::TestWithParam<std::string> {
 protected:
  void SetUp() override;
  static void TearDownTestSuite();

  TestServer& server() const;
  std::unique_ptr<Broker> broker(std::map<std::string, std::string> properties = {}) const;
  /// From here on what is published waits at its publisher, until a reader subscribes and the result ends: a server
  /// that keeps what nobody reads is away meanwhile.
  std::unique_ptr<Outage> hold_up(const Broker& broker) const;
  /// A topic that no other test uses.
  Topic topic(bool durable = false) const;
  /// Waits until a subscription reads.
  static void await_active(const Subscription& subscription);
};

}  // namespace iotcloud::brokers

// A process with a spooled publisher is killed (SIGKILL) again and again, at random points, while its broker is up,
// away, or killed too: every message that publish() accepted arrives, in order, and duplicates are marked.
#include <algorithm>
#include <array>
#include <filesystem>
#include <iostream>
#include <map>
#include <memory>
#include <mutex>
#include <random>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include "iotcloud/tests/brokers/spool/spool_fixture.h"
#include "iotcloud/tests/servers/private_server.h"
#include <iotcloud/brokers/broker.h>
#include <iotcloud/tests/eventually.h>
#include <iotcloud/tests/long.h>
#include <iotcloud/tests/temporary_folder.h>

namespace iotcloud::brokers::spool {
namespace {

using tests::eventually;

using tests::patience;
// No process listens there.
constexpr const char* nowhere = "amqp://guest:guest@127.0.0.1:9/";

/// The writer (writer.cc), as a process.
class Writer {
 public:
  explicit Writer(const std::vector<std::string>& arguments) {
    std::array<int, 2> pipe{};
    if (::pipe2(pipe.data(), O_CLOEXEC) != 0) throw std::runtime_error("no pipe");
    posix_spawn_file_actions_t actions;
    posix_spawn_file_actions_init(&actions);
    posix_spawn_file_actions_adddup2(&actions, pipe[1], STDOUT_FILENO);
    std::vector<std::string> words = {SPOOL_WRITER};
    words.insert(words.end(), arguments.begin(), arguments.end());
    std::vector<char*> argv;
    argv.reserve(words.size() + 1);
    for (auto& word : words) argv.push_back(word.data());
    argv.push_back(nullptr);
    const int error = ::posix_spawn(&process_, SPOOL_WRITER, &actions, nullptr, argv.data(), environ);
    posix_spawn_file_actions_destroy(&actions);
    ::close(pipe[1]);
    output_ = pipe[0];
    if (error != 0) throw std::runtime_error("the writer cannot be started");
  }
  Writer(const Writer&) = delete;
  Writer& operator=(const Writer&) = delete;
  ~Writer() {
    kill();
    ::close(output_);
  }

  /// Reads until `count` messages were accepted, or the process ended. \return the number accepted
  int accepted(int count) {
    std::array<char, 4096> buffer{};
    while (lines_ < count) {
      const ssize_t got = ::read(output_, buffer.data(), buffer.size());
      if (got <= 0) break;
      lines_ += static_cast<int>(std::count(buffer.begin(), buffer.begin() + got, '\n'));
    }
    return lines_;
  }
  void kill() {
    if (process_ <= 0) return;
    ::kill(process_, SIGKILL);
    wait();
  }
  int wait() {
    int status = 0;
    ::waitpid(std::exchange(process_, -1), &status, 0);
    return status;
  }

 private:
  pid_t process_ = -1;
  int output_ = -1;
  int lines_ = 0;
};

/// The messages that arrived, by round and number; fails the test for impossible ones.
class Ledger {
 public:
  void take(const std::string& body, bool redelivered) {
    const auto dot = body.find('.');
    const std::pair<int, int> id(std::stoi(body.substr(0, dot)), std::stoi(body.substr(dot + 1)));
    const std::lock_guard lock(mutex_);
    if (++arrived_[id] > 1) {
      ++duplicates_;
      EXPECT_TRUE(redelivered) << "a second " << id.first << "." << id.second << " that is not marked";
      return;
    }
    EXPECT_LT(last_, id) << "not in order";
    last_ = id;
  }
  bool has(int round, int number) const {
    const std::lock_guard lock(mutex_);
    return arrived_.contains({round, number});
  }
  std::size_t distinct() const {
    const std::lock_guard lock(mutex_);
    return arrived_.size();
  }
  std::size_t duplicates() const {
    const std::lock_guard lock(mutex_);
    return duplicates_;
  }

 private:
  mutable std::mutex mutex_;
  std::map<std::pair<int, int>, int> arrived_;
  std::pair<int, int> last_{0, 0};
  std::size_t duplicates_ = 0;
};

TEST(SpoolKillTest, NothingThatWasAcceptedIsLostWhenTheProcessIsKilledAtAnyPoint) {
  const unsigned seed = std::random_device()();
  SCOPED_TRACE("seed " + std::to_string(seed));
  std::mt19937 random(seed);
  const auto up_to = [&random](int most) { return std::uniform_int_distribution<int>(0, most)(random); };

  tests::TemporaryFolder folder;
  tests::PrivateServer server("rabbitmq.py");
  const std::string topic = "spool.kill.test";
  BrokerOptions options;
  options.urls = {server.url()};
  const auto broker = make_broker(options);
  Ledger ledger;
  SubscriptionOptions reading;
  reading.group = "readers";
  const auto subscription = broker->subscribe({"spool.kill", topic, true}, reading, [&](Delivery delivery) {
    ledger.take(std::string(delivery.message.payload.text()), delivery.redelivered);
    delivery.settle(Settlement::accept);
  });
  ASSERT_TRUE(eventually([&] { return subscription->active(); }));

  const int rounds = tests::long_run() ? 120 : 15;
  std::vector<int> accepted(rounds + 1, 0);
  for (int round = 1; round <= rounds; ++round) {
    const bool away = up_to(2) == 0;
    Writer writer({away ? nowhere : server.url(), topic, folder / "spool", std::to_string(round)});
    writer.accepted(up_to(5) == 0 ? 0 : up_to(1500));
    if (round % 10 == 5) {  // the server dies first, and the process while it waits for the server
      server.kill();
      writer.accepted(1600 + up_to(500));
      writer.kill();
      server.start();
    }
    writer.kill();
    accepted[static_cast<std::size_t>(round)] = writer.accepted(1 << 30);
  }
  Writer last({server.url(), topic, folder / "spool", "0"});
  ASSERT_EQ(last.wait(), 0) << "what is in the spool is sent in the end";
  EXPECT_FALSE(std::filesystem::exists(folder / "spool")) << "nothing is left";

  std::size_t total = 0;
  for (int round = 1; round <= rounds; ++round) {
    const int count = accepted[static_cast<std::size_t>(round)];
    total += static_cast<std::size_t>(count);
    if (count == 0) continue;
    ASSERT_TRUE(eventually([&] { return ledger.has(round, count); }, patience))
        << "round " << round << ": " << count << " were accepted and the last did not arrive";
    for (int i = 1; i <= count; ++i) ASSERT_TRUE(ledger.has(round, i)) << round << "." << i << " was lost";
  }
  std::cout << rounds << " kills: " << total << " messages accepted, " << ledger.distinct() << " arrived, "
            << ledger.duplicates() << " of them again (marked), lost 0, out of order 0\n";
  // In each round one message may have been accepted that the writer had no time to report.
  EXPECT_LE(ledger.distinct(), total + rounds);
}

}  // namespace
}  // namespace iotcloud::brokers::spool

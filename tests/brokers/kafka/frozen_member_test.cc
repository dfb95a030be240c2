// Members of a group that stand still for longer than their session, and a server that does, too.
#include <filesystem>
#include <fstream>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include "iotcloud/tests/brokers/contract_fixture.h"
#include "iotcloud/tests/servers/private_server.h"

namespace iotcloud::brokers {
namespace {

constexpr int driver_count = 12;

/// A process that reads (group_member.cc). Ends with this object.
class MemberProcess {
 public:
  MemberProcess(const tests::PrivateServer& server, const std::string& name)
      : file_(server.folder() / (name + ".read")) {
    std::string program = IOTCLOUD_GROUP_MEMBER;
    std::string file = file_.string();
    std::string url = server.url();
    std::string group = "group";
    std::string topic = "topic";
    char* words[] = {program.data(), file.data(), url.data(), group.data(), topic.data(), nullptr};
    EXPECT_EQ(::posix_spawn(&pid_, program.c_str(), nullptr, nullptr, words, environ), 0) << program;
  }
  ~MemberProcess() {
    ::kill(pid_, SIGKILL);
    ::waitpid(pid_, nullptr, 0);
  }
  MemberProcess(const MemberProcess&) = delete;
  MemberProcess& operator=(const MemberProcess&) = delete;

  void freeze() const { ::kill(pid_, SIGSTOP); }
  void thaw() const { ::kill(pid_, SIGCONT); }
  bool lives() const {
    siginfo_t ended{};
    return ::waitid(P_PID, static_cast<id_t>(pid_), &ended, WEXITED | WNOHANG | WNOWAIT) == 0 && ended.si_pid == 0;
  }
  /// What it has read, a line "DRIVER BODY" for each message.
  std::set<std::string> read() const {
    std::set<std::string> lines;
    std::ifstream file(file_);
    for (std::string line; std::getline(file, line);) lines.insert(line);
    return lines;
  }

 private:
  const std::filesystem::path file_;
  pid_t pid_ = 0;
};

/// With a cooperative group and librdkafka before 2.3.0 a leader that comes back to a server that stands still ends its
/// process.
TEST(KafkaFrozen, AMemberThatWasAwayForLongerThanItsSessionOutlivesAServerThatStandsStill) {
  tests::PrivateServer server("kafka.py");
  BrokerOptions options;
  options.urls = {server.url()};
  options.properties["partitions"] = "4";
  const auto broker = make_broker(options);
  const auto publisher = broker->publisher({"", "topic", false}, {});
  int round = 0;
  const auto publish = [&] {
    ++round;
    for (int driver = 0; driver < driver_count; ++driver) {
      Message message = text_message(std::to_string(round));
      message.driver_id = std::to_string(driver);
      publisher->publish(std::move(message));
    }
  };
  const auto this_round = [&](const std::vector<const MemberProcess*>& members) {
    std::size_t count = 0;
    for (int driver = 0; driver < driver_count; ++driver) {
      const std::string line = std::to_string(driver) + ' ' + std::to_string(round);
      for (const MemberProcess* const member : members) {
        if (member->read().contains(line)) {
          ++count;
          break;
        }
      }
    }
    return count == driver_count;
  };
  const MemberProcess first(server, "first");
  publish();
  ASSERT_TRUE(eventually([&] { return this_round({&first}); }, patience));
  const MemberProcess second(server, "second");
  for (int turn = 0; turn < 4; ++turn) {
    const MemberProcess& away = turn % 2 == 0 ? first : second;
    const MemberProcess& stays = turn % 2 == 0 ? second : first;
    away.freeze();
    publish();
    ASSERT_TRUE(eventually([&] { return this_round({&stays}); }, patience)) << "the other one reads all";
    server.pause();
    away.thaw();
    // Longer than its requests may take, so that it sees more than one of them fail.
    EXPECT_FALSE(eventually([&] { return !first.lives() || !second.lives(); }, std::chrono::milliseconds(3000)))
        << "a member died in turn " << turn;
    server.resume();
    publish();
    ASSERT_TRUE(eventually([&] { return this_round({&first, &second}); }, patience));
    ASSERT_TRUE(first.lives() && second.lives());
  }
}

}  // namespace
}  // namespace iotcloud::brokers

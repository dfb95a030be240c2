// Every broker with a server, behind TLS with client certificates, users and passwords.
#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <memory>
#include <ostream>
#include <semaphore>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "iotcloud/tests/brokers/contract_fixture.h"
#include "iotcloud/tests/captured_log.h"
#include "iotcloud/tests/servers/private_server.h"

namespace iotcloud::brokers {
namespace {

using testing::HasSubstr;
using testing::Not;

/// A kind of server, and the words of its client library for failures.
struct Secured {
  std::string name;
  std::string on_wrong_password;
  std::string on_unknown_authority;
  /// The text for an unreadable file of authorities.
  std::string on_missing_authorities;
  /// The text for an unusable certificate or key.
  std::string on_unusable_key;
  /// The text for a list of revocations that is none.
  std::string on_list_of_another_kind;
  friend void PrintTo(const Secured& kind, std::ostream* out) { *out << kind.name; }
};

const Secured kinds[] = {
    {"rabbitmq", "ACCESS_REFUSED", "certificate", "no-such.pem", "client.pem", "list of revoked certificates"},
    {"kafka", "cannot connect", "cannot connect", "ca.location", "key", "cannot connect"},
    {"activemq", "cannot connect", "certificate", "cannot connect", "cannot connect", "list of revoked certificates"}};

std::size_t count(const std::string& text, const std::string& word) {
  std::size_t found = 0;
  for (auto at = text.find(word); at != std::string::npos; at = text.find(word, at + 1)) ++found;
  return found;
}

class BrokerSecurity : public testing::TestWithParam<Secured> {
 protected:
  /// The tests of one kind follow one another and share its server.
  void SetUp() override {
    if (served_ == GetParam().name) return;
    server_.reset();
    server_ = std::make_unique<tests::PrivateServer>(GetParam().name + ".py", std::vector<std::string>{"--tls"});
    served_ = GetParam().name;
  }
  static void TearDownTestSuite() {
    server_.reset();
    served_.clear();
  }

  static std::string file(const char* name) { return (server_->folder() / name).string(); }
  static void write_password(const BrokerOptions& options, const char* password) {
    std::ofstream(options.password_file) << password << "\n";
  }
  /// Options that the server accepts.
  static BrokerOptions options() {
    BrokerOptions options;
    options.urls = {server_->url()};
    options.user = tests::server_user;
    options.password_file = file("password");
    write_password(options, tests::server_password);
    options.tls = {file("ca.pem"), file("client.pem"), file("client.key")};
    options.heartbeat = std::chrono::seconds(2);
    return options;
  }
  static Topic topic() {
    const std::string test = testing::UnitTest::GetInstance()->current_test_info()->name();
    return {"tls", "gw.driver." + test.substr(0, test.find('/')), false};
  }
  static bool gets_in(const Broker& broker, std::chrono::milliseconds limit = patience) {
    return eventually([&] { return broker.state() == ConnectionState::connected; }, limit);
  }
  /// The log while a broker with these options is refused: until it has these words, and long enough for more attempts.
  static std::string complaint(const BrokerOptions& options, const std::string& words) {
    const tests::CapturedLog log;
    {
      const auto broker = make_broker(options);
      const auto publisher = broker->publisher(topic(), {});
      publisher->publish(text_message("x"));
      EXPECT_FALSE(publisher->drain(std::chrono::seconds(2)));
      EXPECT_TRUE(eventually([&] { return log.contains(words); })) << "nobody says: " << words;
      EXPECT_EQ(broker->state(), ConnectionState::connecting);
    }
    return log.text();
  }

  static void run_python(const std::string& program) {
    const std::string command =
        "/usr/bin/python3 -c '" + program + "' '" IOTCLOUD_TEST_SERVERS "' '" + server_->folder().string() + "'";
    ASSERT_EQ(std::system(command.c_str()), 0);
  }
  /// What the authority has revoked from now on, in the file that options_with_list() name: `names`, quoted.
  static void revoke(const std::string& names) {
    run_python(
        "import sys; sys.path.insert(0, sys.argv[1]); import certificates; "
        "certificates.Certificates(sys.argv[2]).revoke(" +
        names + ")");
  }
  static BrokerOptions options_with_list() {
    BrokerOptions with_list = options();
    with_list.tls.revoked_file = file("revoked.pem");
    return with_list;
  }

  static std::unique_ptr<tests::PrivateServer> server_;
  static std::string served_;
};

std::unique_ptr<tests::PrivateServer> BrokerSecurity::server_;
std::string BrokerSecurity::served_;

TEST_P(BrokerSecurity, CarriesMessagesOfEverySizeInOrder) {
  const auto broker = make_broker(options());
  Inbox inbox;
  const auto subscription = broker->subscribe(topic(), {}, inbox.handler());
  const auto publisher = broker->publisher(topic(), {});
  std::vector<std::string> sent;
  for (const std::size_t size : {0, 1, 16'384, 131'064, 262'128, 1'000'000, 8'388'608}) {
    sent.emplace_back(size, static_cast<char>('a' + sent.size()));
    ASSERT_EQ(publisher->publish(text_message(sent.back())), PublishStatus::accepted);
  }
  for (int i = 0; i < 500; ++i) {
    sent.push_back(std::to_string(i));
    publisher->publish(text_message(sent.back()));
  }
  ASSERT_TRUE(inbox.wait_for(sent.size()));
  EXPECT_TRUE(inbox.bodies() == sent);
  EXPECT_TRUE(publisher->drain(patience));
}

TEST_P(BrokerSecurity, ABurstFromTheServerIsReadToItsEnd) {
  const auto sender = make_broker(options());
  const auto reader = make_broker(options());
  Inbox inbox;
  SubscriptionOptions one_by_one;
  one_by_one.prefetch = 1;  // the server sends the next one only after what came was settled
  const auto subscription = reader->subscribe(topic(), one_by_one, inbox.handler());
  const auto publisher = sender->publisher(topic(), {});
  for (int i = 0; i < 300; ++i) {
    ASSERT_EQ(publisher->publish(text_message(std::string(static_cast<std::size_t>(i) * 97, 'x'))),
              PublishStatus::accepted);
  }
  EXPECT_TRUE(inbox.wait_for(300));
}

TEST_P(BrokerSecurity, LosesNothingWhenTheServerIsKilled) {
  const auto broker = make_broker(options());
  Topic topic = this->topic();
  topic.durable = true;
  topic.exchange = "tls_durable";
  Inbox inbox;
  const auto subscription = broker->subscribe(topic, {}, inbox.handler());
  const auto publisher = broker->publisher(topic, {});
  publisher->publish(text_message("1"));
  ASSERT_TRUE(inbox.wait_for(1));
  server_->kill();
  publisher->publish(text_message("2"));
  server_->start();
  ASSERT_TRUE(inbox.wait_until([](const auto& received) { return received.back().body == "2"; }));
}

TEST_P(BrokerSecurity, APasswordMayComeFromTheEnvironment) {
  BrokerOptions from_environment = options();
  from_environment.password_file.clear();
  from_environment.password_variable = "IOTCLOUD_TEST_PASSWORD";
  ::setenv("IOTCLOUD_TEST_PASSWORD", tests::server_password, 1);
  EXPECT_TRUE(gets_in(*make_broker(from_environment)));
}

TEST_P(BrokerSecurity, APasswordThatChangesIsTakenAtTheNextConnection) {
  const BrokerOptions changing = options();
  write_password(changing, "not yet");
  const auto broker = make_broker(changing);
  EXPECT_FALSE(gets_in(*broker, std::chrono::seconds(1)));
  write_password(changing, tests::server_password);
  EXPECT_TRUE(gets_in(*broker));
}

TEST_P(BrokerSecurity, APasswordFileThatAppearsIsReadAtTheNextConnection) {
  const BrokerOptions late = options();
  std::filesystem::remove(late.password_file);
  const auto broker = make_broker(late);
  const auto publisher = broker->publisher(topic(), {});
  publisher->publish(text_message("x"));
  EXPECT_FALSE(gets_in(*broker, moment));
  write_password(late, tests::server_password);
  EXPECT_TRUE(gets_in(*broker));
}

TEST_P(BrokerSecurity, AWrongPasswordIsSaidOnceAndNotShown) {
  const BrokerOptions wrong = options();
  write_password(wrong, "hush-hush");
  const std::string said = complaint(wrong, GetParam().on_wrong_password);
  EXPECT_EQ(count(said, "cannot connect"), 1U) << said;
  EXPECT_THAT(said, Not(HasSubstr("hush-hush")));
}

TEST_P(BrokerSecurity, AnAuthorityThatDidNotSignTheServersCertificateIsSaidOnce) {
  BrokerOptions wrong = options();
  wrong.tls.ca_file = file("client.pem");
  const std::string said = complaint(wrong, GetParam().on_unknown_authority);
  EXPECT_EQ(count(said, "cannot connect"), 1U) << said;
}

TEST_P(BrokerSecurity, WithoutAFileTheSystemsAuthoritiesAreAsked) {
  BrokerOptions wrong = options();
  wrong.tls.ca_file.clear();
  complaint(wrong, GetParam().on_unknown_authority);
}

TEST_P(BrokerSecurity, AHostNameThatIsNotInTheCertificateIsRefused) {
  BrokerOptions wrong = options();
  wrong.urls.front().replace(wrong.urls.front().find("localhost"), 9, "127.0.0.2");
  complaint(wrong, "cannot connect");
}

TEST_P(BrokerSecurity, WithoutAClientCertificateNobodyGetsIn) {
  BrokerOptions bare = options();
  bare.tls.certificate_file.clear();
  bare.tls.key_file.clear();
  const std::string said = complaint(bare, "cannot connect");
  EXPECT_EQ(count(said, "cannot connect"), 1U) << said;
}

TEST_P(BrokerSecurity, AServerWhoseCertificateIsRevokedGetsNoPassword) {
  revoke("\"server\"");
  EXPECT_TRUE(gets_in(*make_broker(options()))) << "the attack, with a client that has no list";
  complaint(options_with_list(), GetParam().on_unknown_authority);
  revoke("\"client\"");
  EXPECT_TRUE(gets_in(*make_broker(options_with_list()))) << "another's";
}

TEST_P(BrokerSecurity, AServerThatIsRevokedMeanwhileIsLeftAtTheNextConnectionWithoutARestart) {
  revoke("");
  const tests::CapturedLog log;
  const auto broker = make_broker(options_with_list());
  Topic durable = topic();
  durable.durable = true;
  durable.exchange = "tls_durable";
  Inbox inbox;
  const auto subscription = broker->subscribe(durable, {}, inbox.handler());
  const auto publisher = broker->publisher(durable, {});
  publisher->publish(text_message("1"));
  ASSERT_TRUE(inbox.wait_for(1));
  server_->kill();
  revoke("\"server\"");
  server_->start();
  publisher->publish(text_message("2"));
  EXPECT_TRUE(eventually([&] { return log.contains(GetParam().on_unknown_authority); })) << log.text();
  EXPECT_FALSE(publisher->drain(std::chrono::seconds(2)));
  EXPECT_EQ(broker->state(), ConnectionState::connecting);
  revoke("");
  EXPECT_TRUE(inbox.wait_until([](const auto& received) { return received.back().body == "2"; }));
}

TEST_P(BrokerSecurity, FilesThatCannotBeUsedAreNamed) {
  BrokerOptions missing = options();
  missing.tls.ca_file = file("no-such.pem");
  complaint(missing, GetParam().on_missing_authorities);
  missing = options();
  missing.tls.key_file = file("ca.pem");
  complaint(missing, GetParam().on_unusable_key);
  missing = options();
  missing.tls.revoked_file = file("ca.pem");
  complaint(missing, GetParam().on_list_of_another_kind);
  missing = options();
  missing.password_file = file("no-such-password");
  complaint(missing, "no-such-password");
}

INSTANTIATE_TEST_SUITE_P(On, BrokerSecurity, testing::ValuesIn(kinds),
                         [](const auto& kind) { return kind.param.name; });

/// A server whose certificates, those of its clients and their authority are all made anew while messages flow.
class BrokerRenewal : public BrokerSecurity {
 protected:
  /// Nothing that was signed before is worth anything afterwards, once the server has started again.
  static void renew_everything() {
    for (const char* name : {"ca.pem", "client.pem", "client.key"})
      std::filesystem::copy_file(file(name), file((std::string("old-") + name).c_str()),
                                 std::filesystem::copy_options::overwrite_existing);
    std::filesystem::remove(file("complete"));
    const std::string make =
        "import sys; sys.path.insert(0, sys.argv[1]); import certificates; "
        "certificates.Certificates(sys.argv[2]).server_chain()";
    const bool in_java = std::filesystem::remove(file("trust.p12"));  // ActiveMQ's
    run_python(make + (in_java ? "; made = certificates.Certificates(sys.argv[2]); made.key_store(); made.trust_store()"
                               : ""));
  }
  /// Renews everything, as often as this, while messages flow.
  static void check_that_nothing_is_lost(int renewals);
  /// What the authority signs for the same client once more, with another key: key and certificate fit each other only
  /// when both are written.
  static void renew_client() {
    run_python(
        "import sys; sys.path.insert(0, sys.argv[1]); import certificates; "
        "certificates.Certificates(sys.argv[2]).make(\"client\", \"DNS:client\", \"clientAuth\")");
  }
  /// An authority that the server does not know, with a client, in the folder `other`.
  static void make_other_authority() {
    run_python(
        "import os, sys; sys.path.insert(0, sys.argv[1]); import certificates; os.mkdir(sys.argv[2] + \"/other\"); "
        "certificates.Certificates(sys.argv[2] + \"/other\")");
  }
  static void take(const char* from, const char* to) {
    std::filesystem::copy_file(file(from), file(to), std::filesystem::copy_options::overwrite_existing);
  }
  static bool has_after(Inbox& inbox, int number) {
    return inbox.wait_until(
        [&](const auto& received) { return !received.empty() && std::stoi(received.back().body) > number; });
  }
};

void BrokerRenewal::check_that_nothing_is_lost(int renewals) {
  const auto broker = make_broker(options());
  Topic durable = topic();
  durable.durable = true;
  durable.exchange = "tls_renewal";
  Inbox inbox;
  const auto subscription = broker->subscribe(durable, {}, inbox.handler());
  std::counting_semaphore<> writable{0};
  PublisherOptions few;
  few.capacity = 16;
  few.on_writable = [&] { writable.release(); };
  const auto publisher = broker->publisher(durable, few);
  std::atomic<int> sent{0};
  {
    std::jthread sender([&](const std::stop_token& stop) {
      while (!stop.stop_requested()) {
        if (publisher->publish(text_message(std::to_string(sent + 1))).status == PublishStatus::accepted) {
          ++sent;
        } else {
          static_cast<void>(writable.try_acquire_for(patience));  // it is full while the server is away
        }
      }
    });
    for (int round = 0; round < renewals; ++round) {
      ASSERT_TRUE(has_after(inbox, sent));
      server_->kill();
      renew_everything();
      server_->start();
    }
    EXPECT_TRUE(has_after(inbox, sent + 100));
  }
  ASSERT_TRUE(publisher->drain(patience));
  ASSERT_TRUE(inbox.wait_until([&](const auto& all) { return !all.empty() && std::stoi(all.back().body) == sent; }));
  EXPECT_TRUE(firsts(inbox) == numbered(1, sent)) << sent;

  BrokerOptions old = options();
  old.tls.certificate_file = file("old-client.pem");
  old.tls.key_file = file("old-client.key");
  complaint(old, "cannot connect");
}

TEST_P(BrokerRenewal, LosesNothingWhileMessagesFlowAndRefusesTheOldCertificates) {
  check_that_nothing_is_lost(2);
}

INSTANTIATE_TEST_SUITE_P(On, BrokerRenewal, testing::Values(kinds[0]),
                         [](const auto& kind) { return kind.param.name; });

/// A client of ActiveMQ reads its files for each connection.
class ActiveMqRenewal : public BrokerRenewal {};

TEST_P(ActiveMqRenewal, LosesNothingWhileMessagesFlowAndRefusesTheOldCertificates) {
  check_that_nothing_is_lost(1);
}

INSTANTIATE_TEST_SUITE_P(On, ActiveMqRenewal, testing::Values(kinds[2]),
                         [](const auto& kind) { return kind.param.name; });

/// A client of Kafka reads its files only once, so another one takes over.
class KafkaRenewal : public BrokerRenewal {};

TEST_P(KafkaRenewal, OpenConnectionsAreReplacedWithoutARestartOfTheServer) {
  tests::CapturedLog log;
  const std::string taken = "a client with the renewed TLS files takes over";
  const auto times_taken = [&] { return count(log.text(), taken); };
  const auto broker = make_broker(options());
  Inbox inbox;
  const auto subscription = broker->subscribe(topic(), {}, inbox.handler());
  const auto publisher = broker->publisher(topic(), {});
  int sent = 0;
  // Messages flow until the condition holds, each of them when the one before is there.
  const auto flows_until = [&](const auto& condition) {
    const auto end = std::chrono::steady_clock::now() + patience;
    while (!condition() && std::chrono::steady_clock::now() < end) {
      if (publisher->publish(text_message(std::to_string(++sent))).status != PublishStatus::accepted) return false;
      if (!has_after(inbox, sent - 1)) return false;
    }
    return condition();
  };
  ASSERT_TRUE(flows_until([&] { return sent >= 100; }));

  // A key that does not fit the certificate, as between the writing of the two: the present clients go on, and say why.
  make_other_authority();
  take("other/client.key", "client.key");
  ASSERT_TRUE(flows_until([&] { return log.contains("of no use yet: "); })) << log.text();
  // The server refuses a certificate of another authority: so they do.
  take("other/client.pem", "client.pem");
  ASSERT_TRUE(flows_until([&] { return log.contains("of no use yet: sasl_ssl"); })) << log.text();
  EXPECT_EQ(times_taken(), 0U);

  renew_client();
  ASSERT_TRUE(flows_until([&] { return times_taken() >= 2; })) << log.text();  // of the producer, and of the group
  const int before = sent;
  ASSERT_TRUE(flows_until([&] { return sent >= before + 100; }));
  EXPECT_TRUE(inbox.bodies() == numbered(1, sent)) << "lost, twice or out of order";
}

TEST_P(KafkaRenewal, OpenConnectionsToAServerThatIsRevokedEnd) {
  revoke("");
  tests::CapturedLog log;
  const auto broker = make_broker(options_with_list());
  Inbox inbox;
  const auto subscription = broker->subscribe(topic(), {}, inbox.handler());
  const auto publisher = broker->publisher(topic(), {});
  publisher->publish(text_message("1"));
  ASSERT_TRUE(inbox.wait_for(1));
  revoke("\"server\"");
  ASSERT_TRUE(eventually([&] { return broker->state() == ConnectionState::connecting; })) << log.text();
  publisher->publish(text_message("2"));
  EXPECT_FALSE(publisher->drain(std::chrono::seconds(2)));
  revoke("");
  EXPECT_TRUE(inbox.wait_until([](const auto& received) { return received.back().body == "2"; }));
  EXPECT_EQ(firsts(inbox), numbered(1, 2));
}

TEST_P(KafkaRenewal, LosesNothingWhileMessagesFlowAndRefusesTheOldCertificates) {
  check_that_nothing_is_lost(1);
}

INSTANTIATE_TEST_SUITE_P(On, KafkaRenewal, testing::Values(kinds[1]), [](const auto& kind) { return kind.param.name; });

}  // namespace
}  // namespace iotcloud::brokers

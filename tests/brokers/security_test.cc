// Every broker with a server, behind TLS with client certificates, users and passwords.
#include <algorithm>
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
#include <openssl/ssl.h>
#include <sys/socket.h>
#include <sys/time.h>
#include <unistd.h>

#include "iotcloud/tests/brokers/contract_fixture.h"
#include "iotcloud/tests/brokers/tampering_proxy.h"
#include "iotcloud/tests/captured_log.h"
#include "iotcloud/tests/files.h"
#include "iotcloud/tests/loopback_listener.h"
#include "iotcloud/tests/servers/free_port.h"
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

const Secured& kind_named(const std::string& name) {
  return *std::ranges::find(kinds, name, &Secured::name);
}

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
    std::vector<std::string> arguments{"--tls"};
    if (GetParam().name == "kafka") {
      telling_port_ = tests::free_port();
      told_port_ = tests::free_port();
      arguments.insert(arguments.end(),
                       {"--listener", std::to_string(telling_port_) + ":" + std::to_string(told_port_)});
    }
    server_ = std::make_unique<tests::PrivateServer>(GetParam().name + ".py", arguments);
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
    BrokerOptions patient = options;
    patient.rpc_timeout = patience;  // a slow attempt would have another reason
    {
      const auto broker = make_broker(patient);
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
  /// Where a Kafka tells its clients to go on at the other one.
  static int telling_port_, told_port_;
};

std::unique_ptr<tests::PrivateServer> BrokerSecurity::server_;
std::string BrokerSecurity::served_;
int BrokerSecurity::telling_port_ = 0;
int BrokerSecurity::told_port_ = 0;

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

/// Two servers with authorities of their own, and a client of each with one file of revocations for both.
class OpenConnections : public BrokerSecurity {
 protected:
  void SetUp() override {
    BrokerSecurity::SetUp();
    other_ = std::make_unique<tests::PrivateServer>(GetParam().name + ".py", std::vector<std::string>{"--tls"});
    run_python(
        "import sys; sys.path.insert(0, sys.argv[1]); import certificates; "
        "certificates.Certificates(\"" +
        other_->folder().string() + "\").revoke()");
  }
  /// What the first server's authority has revoked from now on; the other one's has revoked nothing.
  void revoke_of_both(const std::string& names) {
    revoke(names);
    std::ofstream(file("new")) << tests::read_file(file("revoked.pem"))
                               << tests::read_file(other_->folder() / "revoked.pem");
    std::filesystem::rename(file("new"), file("both.pem"));
  }
  static BrokerOptions options_with_both() {
    BrokerOptions both = options();
    both.tls.revoked_file = file("both.pem");
    both.heartbeat = std::chrono::seconds(30);  // a connection that is lost for silence is not one that was revoked
    return both;
  }
  BrokerOptions options_of_other() const {
    BrokerOptions other = options_with_both();
    other.urls = {other_->url()};
    const auto folder = other_->folder();
    other.tls.ca_file = folder / "ca.pem";
    other.tls.certificate_file = folder / "client.pem";
    other.tls.key_file = folder / "client.key";
    return other;
  }
  std::unique_ptr<tests::PrivateServer> other_;
};

TEST_P(OpenConnections, ToAServerThatIsRevokedEndByThemselvesAndThoseToOthersGoOn) {
  revoke_of_both("");
  const tests::CapturedLog log;
  const auto broker = make_broker(options_with_both());
  const auto other = make_broker(options_of_other());
  Inbox inbox;
  Inbox inbox_of_other;
  Topic durable = topic();
  durable.durable = true;
  durable.exchange = "tls_durable";
  const auto subscription = broker->subscribe(durable, {}, inbox.handler());
  const auto publisher = broker->publisher(durable, {});
  const auto subscription_of_other = other->subscribe(durable, {}, inbox_of_other.handler());
  const auto publisher_of_other = other->publisher(durable, {});
  publisher->publish(text_message("1"));
  publisher_of_other->publish(text_message("1"));
  ASSERT_TRUE(inbox.wait_for(1));
  ASSERT_TRUE(inbox_of_other.wait_for(1));

  // Both know what the files held before: a list with another's certificate ends neither.
  revoke_of_both("\"client\"");
  const std::string obeyed = "open connections obey it";
  ASSERT_TRUE(eventually([&] { return count(log.text(), obeyed) >= 2; })) << log.text();
  publisher->publish(text_message("2"));
  ASSERT_TRUE(inbox.wait_for(2));
  EXPECT_FALSE(log.contains("lost the connection")) << log.text();

  revoke_of_both("\"server\"");
  ASSERT_TRUE(eventually([&] { return count(log.text(), obeyed) >= 4; })) << log.text();
  ASSERT_TRUE(eventually([&] { return log.contains("the server's certificate has been revoked"); })) << log.text();
  ASSERT_TRUE(eventually([&] { return log.contains("cannot connect"); })) << log.text();
  int sent = 2;
  ASSERT_TRUE(eventually([&] {  // the connections of one broker are not left at the same moment
    publisher->publish(text_message(std::to_string(++sent)));
    return !publisher->drain(std::chrono::seconds(2));
  }));
  EXPECT_EQ(broker->state(), ConnectionState::connecting);
  publisher_of_other->publish(text_message("2"));
  EXPECT_TRUE(inbox_of_other.wait_for(2));
  EXPECT_EQ(count(log.text(), "lost the connection"), 1U) << log.text();

  revoke_of_both("");
  EXPECT_TRUE(inbox.wait_until([&](const auto& all) { return !all.empty() && std::stoi(all.back().body) == sent; }));
  EXPECT_EQ(firsts(inbox), numbered(1, sent));
  EXPECT_EQ(inbox_of_other.bodies(), numbered(1, 2));
}

INSTANTIATE_TEST_SUITE_P(On, OpenConnections, testing::Values(kind_named("rabbitmq"), kind_named("activemq")),
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
        "import os, sys; sys.path.insert(0, sys.argv[1]); import certificates; "
        "os.makedirs(sys.argv[2] + \"/other\", exist_ok=True); certificates.Certificates(sys.argv[2] + \"/other\")");
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

INSTANTIATE_TEST_SUITE_P(On, BrokerRenewal, testing::Values(kind_named("rabbitmq")),
                         [](const auto& kind) { return kind.param.name; });

/// A client of ActiveMQ reads its files for each connection.
class ActiveMqRenewal : public BrokerRenewal {};

TEST_P(ActiveMqRenewal, LosesNothingWhileMessagesFlowAndRefusesTheOldCertificates) {
  check_that_nothing_is_lost(1);
}

INSTANTIATE_TEST_SUITE_P(On, ActiveMqRenewal, testing::Values(kind_named("activemq")),
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
  EXPECT_TRUE(firsts(inbox) == numbered(1, sent)) << "lost or out of order";
  EXPECT_LE(inbox.size(), numbered(1, sent + 1).size()) << "more came again than the one message that is under way";
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

TEST_P(KafkaRenewal, OpenConnectionsToAServerOfAnAuthorityThatIsTakenOutEnd) {
  make_other_authority();
  const auto trust = [](const std::vector<const char*>& authorities) {
    std::ofstream out(file("new"));
    for (const char* authority : authorities) out << tests::read_file(file(authority));
    out.close();
    std::filesystem::rename(file("new"), file("trusted.pem"));
  };
  trust({"ca.pem"});
  tests::CapturedLog log;
  BrokerOptions trusting = options();
  trusting.tls.ca_file = file("trusted.pem");
  const auto broker = make_broker(trusting);
  Inbox inbox;
  const auto subscription = broker->subscribe(topic(), {}, inbox.handler());
  const auto publisher = broker->publisher(topic(), {});
  expect_arrivals(*publisher, inbox, 1);
  trust({"ca.pem", "other/ca.pem"});
  ASSERT_TRUE(eventually([&] { return count(log.text(), "takes over") >= 2; })) << log.text();
  publish_numbers(*publisher, 4, 6);
  ASSERT_TRUE(inbox.wait_for(6));
  EXPECT_FALSE(log.contains("cannot connect")) << log.text();

  trust({"other/ca.pem"});
  ASSERT_TRUE(eventually([&] { return broker->state() == ConnectionState::connecting; })) << log.text();
  publisher->publish(text_message("7"));
  EXPECT_FALSE(publisher->drain(moment));
  trust({"ca.pem"});
  EXPECT_TRUE(inbox.wait_until([](const auto& received) { return received.back().body == "7"; }));
  EXPECT_EQ(firsts(inbox), numbered(1, 7));
}

/// SECURITY.md: whoever has one server of a topology's file.
TEST_P(KafkaRenewal, FurtherServersThatOneTellsOfAreLoggedInToWithTheSameTlsOnly) {
  make_other_authority();
  BrokerOptions told = options();
  told.urls = {"kafkas://localhost:" + std::to_string(telling_port_)};
  {
    const tests::TamperingProxy further(static_cast<std::uint16_t>(telling_port_),
                                        static_cast<std::uint16_t>(told_port_));
    const auto broker = make_broker(told);
    Inbox inbox;
    const auto subscription = broker->subscribe(topic(), {}, inbox.handler());
    expect_arrivals(*broker->publisher(topic(), {}), inbox, 1);
    EXPECT_GT(further.connections(), 0) << "at an address that is not in the file";
    EXPECT_THAT(further.heard(), Not(HasSubstr(tests::server_password)));
  }
  // What a client says to a further server that shows this certificate; empty: it ends the handshake.
  const auto words_to = [&](const char* certificate, const char* key) {
    const tests::LoopbackListener stranger;
    const timeval limit{static_cast<time_t>(std::chrono::seconds(patience).count()), 0};
    ::setsockopt(stranger.socket(), SOL_SOCKET, SO_RCVTIMEO, &limit, sizeof limit);
    const tests::TamperingProxy further(stranger.port(), static_cast<std::uint16_t>(told_port_));
    const auto broker = make_broker(told);
    const auto publisher = broker->publisher(topic(), {});
    publisher->publish(text_message("4"));
    const std::unique_ptr<SSL_CTX, decltype(&SSL_CTX_free)> context(SSL_CTX_new(TLS_server_method()), SSL_CTX_free);
    EXPECT_EQ(SSL_CTX_use_certificate_file(context.get(), file(certificate).c_str(), SSL_FILETYPE_PEM), 1);
    EXPECT_EQ(SSL_CTX_use_PrivateKey_file(context.get(), file(key).c_str(), SSL_FILETYPE_PEM), 1);
    const std::unique_ptr<SSL, decltype(&SSL_free)> session(SSL_new(context.get()), SSL_free);
    const int client = stranger.accept();
    EXPECT_GE(client, 0) << "nobody came";
    SSL_set_fd(session.get(), client);
    std::string words(1000, '\0');
    const int size = SSL_accept(session.get()) == 1 ? SSL_read(session.get(), words.data(), 1000) : 0;
    ::close(client);
    words.resize(static_cast<std::size_t>(std::max(size, 0)));
    return words;
  };
  EXPECT_THAT(words_to("server.pem", "server.key"), HasSubstr("iotcloud")) << "the attack";
  EXPECT_EQ(words_to("other/server.pem", "other/server.key"), "");
}

TEST_P(KafkaRenewal, LosesNothingWhileMessagesFlowAndRefusesTheOldCertificates) {
  check_that_nothing_is_lost(1);
}

INSTANTIATE_TEST_SUITE_P(On, KafkaRenewal, testing::Values(kind_named("kafka")),
                         [](const auto& kind) { return kind.param.name; });

}  // namespace
}  // namespace iotcloud::brokers

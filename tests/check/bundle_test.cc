#include <fstream>

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <iotcloud/check/bundle.h>
#include <iotcloud/tests/temporary_folder.h>

namespace iotcloud::check {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

TEST(Redactor, HidesWhatLooksLikeASecretWhereverItStands) {
  const Redactor redactor;
  const std::string digits(64, 'a');
  const std::pair<std::string, std::string> texts[] = {
      {"amqp://guest:hunter22@host:5672/", "amqp://guest:***@host:5672/"},
      {"urls: [\"amqps://u:p/a@ss@h:1/\", kafka://h:2]", "urls: [\"amqps://u:***@h:1/\", kafka://h:2]"},
      {"password: hunter22", "password: ***"},
      {"  \"api_key\": \"hunter 22\", \"rate\": 5", "  \"api_key\": \"***\", \"rate\": 5"},
      {"DB_PASSWORD=hunter22 x=1", "DB_PASSWORD=*** x=1"},
      {"token: 'hunter22'", "token: '***'"},
      {"brokers:\n  - password: hunter 22, and 'more'\n    user: a", "brokers:\n  - password: ***\n    user: a"},
      {"a: 1\n  secret: |\n    hunter22\n\n    hunter23\n  user: a\n", "a: 1\n  secret: ***\n  user: a\n"},
      {"it says password: hunter22 of anna", "it says password: *** of anna"},
      {"amqp://u:hun,ter22@h:1", "amqp://u:***@h:1"},
      {"Authorization: Bearer hunter22", "Authorization: Bearer ***"},
      {"the token anna." + digits + " is there", "the token anna.*** is there"},
      {"-----BEGIN PRIVATE KEY-----\nhunter22\n-----END PRIVATE KEY-----\nrest", "(a private key)\nrest"}};
  for (const auto& [text, expected] : texts) EXPECT_EQ(redactor.redacted(text), expected);
}

TEST(Redactor, LetsStandWhatIsNoSecret) {
  const Redactor redactor;
  for (const char* text :
       {"password_file: /etc/iotcloud/broker.password", "http://127.0.0.1:9406/metrics", "kafka://host:9092",
        "time: 12:30", "rate=5", "-----BEGIN CERTIFICATE-----\nMIIB\n-----END CERTIFICATE-----\n", "iotcloud 0.1.0",
        "a user@host of 10.0.0.1", "tokens_total 5 of ours"}) {
    EXPECT_EQ(redactor.redacted(text), text);
  }
}

TEST(Redactor, HidesWhatTheFilesOfSecretsHold) {
  const tests::TemporaryFolder folder;
  std::ofstream(folder / "password") << "correct horse\nbattery staple \n";
  Redactor redactor;
  redactor.add_secret_file(folder / "password");
  redactor.add_secret("ab");  // would be everywhere
  EXPECT_EQ(redactor.redacted("it says correct horse, and battery staples"), "it says ***, and ***s");
  EXPECT_EQ(redactor.redacted("abc"), "abc");
}

TEST(Redactor, HidesAnotherKeyThanTheOneItKnows) {
  const tests::TemporaryFolder folder;
  std::ofstream(folder / "key.pem") << "-----BEGIN EC PRIVATE KEY-----\nMHcCAQEE\n-----END EC PRIVATE KEY-----\n";
  Redactor redactor;
  redactor.add_secret_file(folder / "key.pem");
  EXPECT_EQ(redactor.redacted("a\n-----BEGIN EC PRIVATE KEY-----\nanother\n-----END EC PRIVATE KEY-----\nMHcCAQEE\n"),
            "a\n(a private key)\n***\n");
}

TEST(Redactor, TakesLinesOfAnyLength) {
  const std::string text = "a=" + std::string(1'000'000, 'x') + " password=hunter22";
  EXPECT_THAT(Redactor().redacted(text), Not(HasSubstr("hunter22")));
}

TEST(Archive, IsReadByTar) {
  const tests::TemporaryFolder folder;
  std::ofstream(folder / "a.tar.gz", std::ios::binary) << archive_of(
      {{"b/empty.txt", ""}, {"a.txt", std::string(1000, 'x')}, {"c.txt", std::string(512, 'y')}}, 1'700'000'000);
  const std::string command =
      "cd '" + folder.path() + "' && tar xzf a.tar.gz && cat b/empty.txt a.txt c.txt | wc -c > size";
  ASSERT_EQ(std::system(command.c_str()), 0);
  int size = 0;
  std::ifstream(folder / "size") >> size;
  EXPECT_EQ(size, 1512);
}

}  // namespace
}  // namespace iotcloud::check

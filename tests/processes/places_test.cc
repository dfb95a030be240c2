#include <cstring>
#include <map>
#include <string>
#include <vector>

#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <netinet/in.h>

#include <iotcloud/config/error.h>
#include <iotcloud/processes/places.h>
#include <iotcloud/tests/config/hand_clock.h>

namespace iotcloud::processes {
namespace {

using namespace std::chrono_literals;
using ::testing::ElementsAre;

sockaddr_storage socket_address(const std::string& address, std::uint16_t port) {
  sockaddr_storage storage{};
  sockaddr_in ip4{};
  sockaddr_in6 ip6{};
  ip4.sin_family = AF_INET;
  ip6.sin6_family = AF_INET6;
  ip4.sin_port = ip6.sin6_port = htons(port);
  if (inet_pton(AF_INET, address.c_str(), &ip4.sin_addr) == 1) {
    std::memcpy(&storage, &ip4, sizeof ip4);
  } else if (inet_pton(AF_INET6, address.c_str(), &ip6.sin6_addr) == 1) {
    std::memcpy(&storage, &ip6, sizeof ip6);
  }
  return storage;
}

Endpoint at(const std::string& address, std::uint16_t port) {
  return endpoint_of(socket_address(address, port), sizeof(sockaddr_storage)).value();
}

IpAddress ip(const std::string& address) {
  return at(address, 1).address;
}

TEST(Place, IsAMachineAndAPort) {
  EXPECT_EQ(parse_place("camera-1:554"), (Place{"camera-1", 554}));
  EXPECT_EQ(parse_place("Camera-1.Lab.:554"), (Place{"camera-1.lab", 554}));
  EXPECT_EQ(parse_place("10.0.0.7:65535"), (Place{"10.0.0.7", 65535}));
  EXPECT_EQ(parse_place("[2001:DB8::7]:80"), (Place{"2001:db8::7", 80}));
  EXPECT_EQ(to_text(parse_place("[2001:DB8::7]:80")), "[2001:db8::7]:80");
  EXPECT_EQ(to_text(parse_place("camera-1:554")), "camera-1:554");
  EXPECT_THAT(parse_places(" a:1,b:2 , c:3"), ElementsAre(Place{"a", 1}, Place{"b", 2}, Place{"c", 3}));
  EXPECT_TRUE(parse_places(" , ").empty());
}

TEST(Place, IsNothingElse) {
  for (const char* text :
       {"",      ":",     "a",     "a:",  ":1",   "a:0",   "a:65536", "a:b",   "a:-1", "::1:80", "[a]:80",
        "[::1]", "a:1:2", "a..:1", ".:1", ".a:1", "a/b:1", "a b:1",   "a\n:1", "*:1",  "[]:1",   "10.0.0.0/8:1"}) {
    EXPECT_THROW(parse_place(text), config::Error) << text;
  }
}

TEST(Endpoint, IsTheSameHoweverAnAddressIsWritten) {
  EXPECT_EQ(ip("::ffff:10.0.0.7"), ip("10.0.0.7"));
  EXPECT_NE(ip("::10.0.0.7"), ip("10.0.0.7"));
  EXPECT_EQ(to_text(ip("::ffff:10.0.0.7")), "10.0.0.7");
  EXPECT_EQ(to_text(ip("2001:db8::7")), "2001:db8::7");
  auto short_one = socket_address("10.0.0.7", 1);
  EXPECT_FALSE(endpoint_of(short_one, sizeof(sockaddr_in) - 1));
  short_one.ss_family = AF_UNIX;
  EXPECT_FALSE(endpoint_of(short_one, sizeof(sockaddr_storage)));
}

class AllowedPlacesTest : public ::testing::Test {
 protected:
  AllowedPlaces places(const std::string& text) {
    return {parse_places(text),
            [this](const std::string& name, bool) {
              asked_.push_back(name);
              return names_[name];
            },
            clock_};
  }
  tests::HandClock clock_;
  std::map<std::string, std::vector<IpAddress>> names_;
  std::vector<std::string> asked_;
};

TEST_F(AllowedPlacesTest, AreAnAddressWithItsPortAndNoOther) {
  auto allowed = places("10.0.0.7:80, [2001:db8::7]:81");
  EXPECT_TRUE(allowed.allows(at("10.0.0.7", 80)));
  EXPECT_TRUE(allowed.allows(at("::ffff:10.0.0.7", 80)));
  EXPECT_TRUE(allowed.allows(at("2001:db8::7", 81)));
  EXPECT_FALSE(allowed.allows(at("10.0.0.7", 81)));
  EXPECT_FALSE(allowed.allows(at("10.0.0.8", 80)));
  EXPECT_FALSE(allowed.allows(at("2001:db8::7", 80)));
  EXPECT_TRUE(asked_.empty()) << "there is no name";
  auto elsewhere = at("2001:db8::7", 81);
  elsewhere.address.scope = 3;
  EXPECT_FALSE(allowed.allows(elsewhere));
}

TEST_F(AllowedPlacesTest, AreWhatANameStandsFor) {
  names_["camera"] = {ip("10.0.0.7"), ip("10.0.0.8")};
  auto allowed = places("Camera:554, other:80");
  EXPECT_TRUE(allowed.has_name("camera."));
  EXPECT_FALSE(allowed.has_name("cam"));
  EXPECT_FALSE(allowed.knows(at("10.0.0.8", 554))) << "nobody has asked yet";
  EXPECT_TRUE(allowed.allows(at("10.0.0.8", 554)));
  EXPECT_THAT(asked_, ElementsAre("camera")) << "not for the name with another port";
  EXPECT_FALSE(allowed.allows(at("10.0.0.8", 80)));
  EXPECT_THAT(allowed.ask("CAMERA", true), ElementsAre(ip("10.0.0.7"), ip("10.0.0.8")));
}

TEST_F(AllowedPlacesTest, AskAgainOnlyAfterAWhile) {
  names_["camera"] = {ip("10.0.0.7")};
  auto allowed = places("camera:554");
  for (int i = 0; i < 3; ++i) EXPECT_FALSE(allowed.allows(at("10.0.0.9", 554)));
  EXPECT_EQ(asked_.size(), 1u) << "a process does not ask a server of names without end";
  names_["camera"] = {ip("10.0.0.9")};
  clock_.advance(10s);
  EXPECT_TRUE(allowed.allows(at("10.0.0.9", 554)));
  EXPECT_TRUE(allowed.allows(at("10.0.0.7", 554)));
  EXPECT_EQ(asked_.size(), 2u);
}

TEST_F(AllowedPlacesTest, ForgetAnAddressThatANameHasNoMore) {
  names_["camera"] = {ip("10.0.0.7")};
  auto allowed = places("camera:554");
  EXPECT_TRUE(allowed.allows(at("10.0.0.7", 554)));
  names_["camera"] = {ip("10.0.0.8")};
  clock_.advance(2min);
  allowed.refresh();
  EXPECT_TRUE(allowed.knows(at("10.0.0.7", 554))) << "a name with several addresses shows some at a time";
  clock_.advance(3min);
  allowed.refresh();
  EXPECT_FALSE(allowed.allows(at("10.0.0.7", 554)));
  EXPECT_TRUE(allowed.knows(at("10.0.0.8", 554)));
}

TEST_F(AllowedPlacesTest, RememberAllWhileNobodyAnswersForAName) {
  names_["camera"] = {ip("10.0.0.7")};
  auto allowed = places("camera:554");
  EXPECT_TRUE(allowed.allows(at("10.0.0.7", 554)));
  names_["camera"] = {};
  clock_.advance(24h);
  allowed.refresh();
  EXPECT_EQ(asked_.size(), 2u);
  EXPECT_TRUE(allowed.knows(at("10.0.0.7", 554)));
  allowed.refresh();
  EXPECT_EQ(asked_.size(), 2u) << "not again at once";
}

TEST_F(AllowedPlacesTest, AllowNothingWhileANameIsNotKnown) {
  auto allowed = places("camera:554");
  EXPECT_FALSE(allowed.allows(at("0.0.0.0", 554)));
  EXPECT_FALSE(allowed.allows(at("::", 554)));
  EXPECT_TRUE(allowed.ask("camera", false).empty());
}

}  // namespace
}  // namespace iotcloud::processes

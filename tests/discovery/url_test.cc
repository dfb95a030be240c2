#include <gmock/gmock.h>

#include <iotcloud/config/error.h>
#include <iotcloud/discovery/access.h>
#include <iotcloud/discovery/registry.h>
#include <iotcloud/discovery/zookeeper/url.h>
#include <iotcloud/tests/captured_log.h>

namespace iotcloud::discovery {
namespace {

using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

TEST(RegistryUrl, NamesHostsPortsAndChroot) {
  const auto plain = zookeeper::parse_url("zookeeper://localhost");
  EXPECT_EQ(plain.hosts, "localhost:2181");
  EXPECT_EQ(plain.chroot, "");
  const auto full = zookeeper::parse_url("zookeeper://a:1,b,[::1]:65535/x/y");
  EXPECT_EQ(full.hosts, "a:1,b:2181,[::1]:65535");
  EXPECT_EQ(full.chroot, "/x/y");
  EXPECT_EQ(zookeeper::parse_url("zookeeper://a/").chroot, "");
}

TEST(RegistryUrl, AServerThatOtherMachinesReachNeedsAUser) {
  RegistryOptions options;
  for (const char* url : {"zookeeper://192.0.2.1", "zookeeper://127.0.0.1:2181,192.0.2.1:2181/x",
                          "zookeeper://zk1:2181", "zookeeper://[2001:db8::1]:2181"}) {
    options.url = url;
    for (const bool meant : {false, true}) {
      options.open = meant;
      try {
        make_registry(options);
        ADD_FAILURE() << url << ": anybody there could give orders";
      } catch (const config::Error& error) {
        EXPECT_THAT(error.what(), HasSubstr("registry.user"));
      }
    }
  }
  options.open = false;
  options.unencrypted = true;
  options.url = "zookeeper://192.0.2.1";
  EXPECT_THROW(make_registry(options), config::Error) << "a protected way does not say who comes by it";
  options.unencrypted = false;
  for (const char* url : {"zookeeper://127.0.0.1:1", "zookeeper://localhost:1,[::1]:1/x"}) {
    options.url = url;
    EXPECT_TRUE(make_registry(options)) << url;
  }
}

TEST(RegistryUrl, ThePasswordDoesNotGoToAnotherMachineInTheClearUnlessItIsMeant) {
  RegistryOptions options;
  options.user = "gateway-1";
  options.password = "secret";
  for (const char* url : {"zookeeper://192.0.2.1:1", "zookeeper://127.0.0.1:1,192.0.2.1:1/x"}) {
    options.url = url;
    options.unencrypted = false;
    try {
      make_registry(options);
      ADD_FAILURE() << url << ": whoever reads the network has the password";
    } catch (const config::Error& error) {
      EXPECT_THAT(error.what(),
                  AllOf(HasSubstr("no TLS"), HasSubstr("registry.unencrypted"), Not(HasSubstr("secret"))));
    }
    options.unencrypted = true;
    EXPECT_TRUE(make_registry(options)) << url;
  }
}

/// What is logged while a registry is made.
std::string said(const RegistryOptions& options) {
  const iotcloud::tests::CapturedLog log;
  make_registry(options);
  return log.text();
}

TEST(RegistryUrl, AUserThatAllProcessesShareIsWarnedOf) {
  RegistryOptions options;
  options.url = "zookeeper://localhost:1/x";
  options.user = "fleet";
  options.password = "secret";
  const auto warning = AllOf(HasSubstr("\"fleet\" have one password"), HasSubstr("registry.users"));
  EXPECT_THAT(said(options), warning);
  options.access = std::make_shared<const RegistryAccess>(std::vector<RegistryUser>{}, Paths("/iot/sensors"));
  EXPECT_THAT(said(options), Not(warning)) << "each has its own";
}

TEST(RegistryUrl, AServerOfThisMachineWithoutAUserIsWarnedOfUnlessItIsMeant) {
  RegistryOptions options;
  options.url = "zookeeper://localhost:1/x";
  EXPECT_THAT(said(options), AllOf(HasSubstr(options.url), HasSubstr("every process of this machine"),
                                   HasSubstr("registry.user"), HasSubstr("registry.open: true")));
  const auto not_warned = Not(HasSubstr("every process of this machine"));
  options.open = true;
  EXPECT_THAT(said(options), not_warned);
  options.open = false;
  options.user = "gateway-1";
  options.password = "secret";
  EXPECT_THAT(said(options), not_warned);
  EXPECT_THAT(said({.url = "embedded://not-warned"}), not_warned);
}

TEST(RegistryUrl, WhatCannotBeReadIsRefusedWithTheFormThatIsRight) {
  for (const char* url :
       {"zookeeper://", "zookeeper:///chroot", "zookeeper://a,,b", "zookeeper://a:0", "zookeeper://a:65536",
        "zookeeper://a:b", "zookeeper://a:", "zookeeper://:1", "zookeeper://a/x//y", "zookeeper://a/../y"}) {
    try {
      make_registry({.url = url});
      ADD_FAILURE() << url;
    } catch (const config::Error& error) {
      EXPECT_THAT(error.what(), HasSubstr("zookeeper://host:port"));
      EXPECT_THAT(error.what(), HasSubstr(url));
    }
  }
  EXPECT_THROW(make_registry({.url = "etcd://a"}), config::Error);
  EXPECT_THROW(make_registry({.url = ""}), config::Error);
}

}  // namespace
}  // namespace iotcloud::discovery

#pragma once

#include <memory>
#include <string>
#include <utility>

#include <gtest/gtest.h>

#include <iotcloud/tests/drivers/stream/until.h>
#include <iotcloud/tests/servers/private_server.h>

namespace iotcloud::drivers::mqtt {

/// The Mosquitto that all tests of a program share; each has topics of its own.
inline tests::PrivateServer& shared_broker() {
  static tests::PrivateServer server("mosquitto.py");
  return server;
}

/// The running test's, for topics and sessions of its own.
inline std::string test_name() {
  return ::testing::UnitTest::GetInstance()->current_test_info()->name();
}

/// An instance of the driver that is connected, to the shared broker unless the properties say otherwise, and connects
/// anew without long pauses.
template <typename Made>
std::unique_ptr<testing::MockInstance> connected(PropertyMap properties) {
  properties.try_emplace("url", shared_broker().url());
  properties.try_emplace("client_id", test_name());
  properties.try_emplace("reconnect_ms", "10");
  properties.try_emplace("reconnect_most_ms", "10");
  auto instance = std::make_unique<testing::MockInstance>(describe<Made>("made", "test", true), std::move(properties));
  EXPECT_TRUE(instance->start()) << instance->error();
  EXPECT_TRUE(until_metadata(*instance, "connection", "connected"));
  return instance;
}

}  // namespace iotcloud::drivers::mqtt

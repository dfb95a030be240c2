#pragma once

#include <atomic>
#include <cstdlib>
#include <mutex>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <mosquitto.h>
#include <mqtt_protocol.h>

#include <iotcloud/tests/eventually.h>

namespace iotcloud::drivers::mqtt {

/// A device at a broker: a bare client of libmosquitto, on a thread of the library.
class Device {
 public:
  /// \param filter of what it reads; empty: nothing
  explicit Device(const std::string& url, const std::string& filter = {}) : filter_(filter) {
    mosquitto_lib_init();
    client_ = mosquitto_new(nullptr, true, this);
    mosquitto_int_option(client_, MOSQ_OPT_PROTOCOL_VERSION, MQTT_PROTOCOL_V5);
    mosquitto_connect_callback_set(client_, [](mosquitto* client, void* device, int) {
      const std::string& wanted = static_cast<Device*>(device)->filter_;
      if (!wanted.empty()) mosquitto_subscribe(client, nullptr, wanted.c_str(), 2);
      if (wanted.empty()) static_cast<Device*>(device)->ready_ = true;
    });
    mosquitto_subscribe_callback_set(
        client_, [](mosquitto*, void* device, int, int, const int*) { static_cast<Device*>(device)->ready_ = true; });
    mosquitto_publish_callback_set(client_,
                                   [](mosquitto*, void* device, int) { ++static_cast<Device*>(device)->sent_; });
    mosquitto_message_v5_callback_set(
        client_, [](mosquitto*, void* device, const mosquitto_message* message, const mosquitto_property* properties) {
          static_cast<Device*>(device)->receive(*message, properties);
        });
    EXPECT_EQ(mosquitto_connect(client_, "127.0.0.1", std::stoi(url.substr(url.rfind(':') + 1)), 60), MOSQ_ERR_SUCCESS);
    mosquitto_loop_start(client_);
    EXPECT_TRUE(tests::eventually([this] { return ready_.load(); }));
  }
  ~Device() {
    mosquitto_disconnect(client_);
    mosquitto_loop_stop(client_, false);
    mosquitto_destroy(client_);
  }
  Device(const Device&) = delete;
  Device& operator=(const Device&) = delete;

  /// The broker has it when this returns.
  void publish(const std::string& to, const std::string& text, bool retain = false, const std::string& property = {}) {
    const int before = sent_;
    mosquitto_property* properties = nullptr;
    if (!property.empty())
      mosquitto_property_add_string_pair(&properties, MQTT_PROP_USER_PROPERTY, "unit", property.c_str());
    mosquitto_publish_v5(client_, nullptr, to.c_str(), static_cast<int>(text.size()), text.data(), 2, retain,
                         properties);
    mosquitto_property_free_all(&properties);
    EXPECT_TRUE(tests::eventually([&] { return sent_ > before; }));
  }
  /// "topic text property" of all that came.
  std::vector<std::string> received() {
    const std::lock_guard lock(mutex_);
    return received_;
  }
  /// Quality of service of the last one.
  int last_qos() const { return last_qos_; }

 private:
  void receive(const mosquitto_message& message, const mosquitto_property* properties) {
    char* value = nullptr;
    mosquitto_property_read_string_pair(properties, MQTT_PROP_USER_PROPERTY, nullptr, &value, false);
    last_qos_ = message.qos;
    const std::lock_guard lock(mutex_);
    received_.push_back(
        message.topic +
        (" " + std::string(static_cast<char*>(message.payload), static_cast<std::size_t>(message.payloadlen))) +
        (value ? " " + std::string(value) : ""));
    std::free(value);
  }

  const std::string filter_;
  mosquitto* client_;
  std::atomic<bool> ready_{false};
  std::atomic<int> sent_{0}, last_qos_{-1};
  std::mutex mutex_;
  std::vector<std::string> received_;
};

}  // namespace iotcloud::drivers::mqtt

// The driver against a device that libmodbus' own server plays, over TCP and over a terminal of the kernel.
#include <array>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <mutex>
#include <string>
#include <thread>

#include <fcntl.h>
#include <gmock/gmock.h>
#include <modbus/modbus.h>
#include <nlohmann/json.hpp>
#include <poll.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <iotcloud/drivers/modbus/modbus_driver.h>
#include <iotcloud/tests/drivers/stream/line.h>
#include <iotcloud/tests/drivers/stream/until.h>
#include <iotcloud/tests/files.h>
#include <iotcloud/tests/servers/free_port.h>
#include <iotcloud/tests/temporary_folder.h>

namespace iotcloud::drivers::modbus {
namespace {

using namespace std::chrono_literals;
using nlohmann::json;
using ::testing::HasSubstr;
using testing::MockInstance;

Descriptor modbus_plugin() {
  return describe<ModbusDriver>("modbus", "test", true);
}

/// 100 of each kind, from address 0 on.
class Device {
 public:
  Device() : tables_(modbus_mapping_new(100, 100, 100, 100)), stop_(eventfd(0, EFD_CLOEXEC)) {}
  ~Device() {
    vanish();
    ::close(stop_);
    modbus_mapping_free(tables_);
  }
  Device(const Device&) = delete;
  Device& operator=(const Device&) = delete;

  /// Answers at this port, or on this line.
  void serve_tcp(int port) {
    context_ = modbus_new_tcp("127.0.0.1", port);
    listener_ = modbus_tcp_listen(context_, 4);
    ASSERT_GE(listener_, 0) << modbus_strerror(errno);
    thread_ = std::thread([this] { run(-1); });
  }
  void serve_line(int line) {
    context_ = modbus_new_rtu("/dev/null", 19'200, 'N', 8, 1);
    modbus_set_slave(context_, 7);
    modbus_set_socket(context_, line);
    thread_ = std::thread([this, line] { run(line); });
  }
  void vanish() {
    if (!thread_.joinable()) return;
    const std::uint64_t one = 1;
    EXPECT_EQ(::write(stop_, &one, sizeof one), ssize_t{sizeof one});
    thread_.join();
    std::uint64_t taken = 0;
    EXPECT_EQ(::read(stop_, &taken, sizeof taken), ssize_t{sizeof taken});
    if (listener_ >= 0) ::close(std::exchange(listener_, -1));
    modbus_free(std::exchange(context_, nullptr));
  }
  void set(std::size_t address, std::uint16_t word) {
    const std::lock_guard lock(mutex_);
    tables_->tab_registers[address] = word;
    tables_->tab_input_registers[address] = word;
  }
  void set_bit(std::size_t address, bool on) {
    const std::lock_guard lock(mutex_);
    tables_->tab_bits[address] = on;
    tables_->tab_input_bits[address] = on;
  }
  std::uint16_t word(std::size_t address) {
    const std::lock_guard lock(mutex_);
    return tables_->tab_registers[address];
  }
  bool bit(std::size_t address) {
    const std::lock_guard lock(mutex_);
    return tables_->tab_bits[address] != 0;
  }
  void be_silent(bool silent) {
    const std::lock_guard lock(mutex_);
    silent_ = silent;
  }
  /// Answers as a gateway does in place of a device; 0: as the device.
  void answer_with(unsigned exception) {
    const std::lock_guard lock(mutex_);
    exception_ = exception;
  }
  int requests() {
    const std::lock_guard lock(mutex_);
    return requests_;
  }

 private:
  void run(int connection) {
    for (;;) {
      std::array<pollfd, 3> waiting{{{stop_, POLLIN, 0}, {listener_, POLLIN, 0}, {connection, POLLIN, 0}}};
      poll(waiting.data(), waiting.size(), -1);
      if (waiting[0].revents != 0) break;
      if (waiting[1].revents != 0) {
        if (connection >= 0) ::close(connection);
        connection = modbus_tcp_accept(context_, &listener_);
      }
      if (waiting[2].revents == 0) continue;
      std::array<std::uint8_t, MODBUS_TCP_MAX_ADU_LENGTH> request{};
      const int size = modbus_receive(context_, request.data());
      const std::lock_guard lock(mutex_);
      if (size > 0) ++requests_;
      if (size > 0 && exception_ != 0) modbus_reply_exception(context_, request.data(), exception_);
      if (size > 0 && !silent_ && exception_ == 0) modbus_reply(context_, request.data(), size, tables_);
      if (size < 0 && listener_ >= 0) ::close(std::exchange(connection, -1));
    }
    if (listener_ >= 0 && connection >= 0) ::close(connection);
  }

  std::mutex mutex_;
  modbus_mapping_t* tables_;
  const int stop_;
  modbus_t* context_ = nullptr;
  int listener_ = -1;
  bool silent_ = false;
  unsigned exception_ = 0;
  int requests_ = 0;
  std::thread thread_;
};

json last_reading(MockInstance& instance) {
  const auto all = texts(instance, "readings");
  return all.empty() ? json() : json::parse(all.back());
}

std::string at(int port) {
  return "127.0.0.1:" + std::to_string(port);
}

/// Properties with which a device is waited for that a busy machine lets answer late.
PropertyMap patient(PropertyMap properties) {
  properties.emplace("timeout_ms", "5000");
  return properties;
}

TEST(Modbus, polls_registers_of_each_table_and_type_by_its_map) {
  Device device;
  const int port = tests::free_port();
  device.serve_tcp(port);
  for (std::size_t i = 0; i < 4; ++i)
    device.set(i, std::array<std::uint16_t, 4>{0x4148, 0x0000, 0x0000, 0x4148}[i]);  // 12.5f, twice
  device.set(10, 0xfffe);
  device.set(11, 0x8000);
  device.set(12, 0xffff);
  for (std::size_t i = 20; i < 24; ++i) device.set(i, 0xffff);
  device.set_bit(3, true);
  const std::string map = R"(
- {name: power, address: 0, type: float32, unit: kW}
- {name: swapped, address: 2, type: float32, order: cdab}
- {name: temperature, table: input, address: 10, type: int16, scale: 0.1, offset: 1, unit: C}
- {name: counter, address: 11, type: uint32}
- {name: bytes, address: 11, type: int16, order: badc}
- {name: huge, address: 20, type: uint64}
- {name: minus, address: 20, type: int64}
- {name: pump, table: coil, address: 3}
- {name: door, table: discrete, address: 4}
)";
  MockInstance meter(modbus_plugin(), patient({{"connect", at(port)}, {"registers", map}, {"period_ms", "100"}}));
  ASSERT_TRUE(meter.start()) << meter.error();
  EXPECT_EQ(meter.host().metadata()["connection"], "connected");
  EXPECT_EQ(meter.host().metadata()["units"], "power=kW, temperature=C");
  const int before = device.requests();
  meter.host().advance(100ms);
  ASSERT_EQ(meter.host().published("readings").size(), 1U);
  EXPECT_EQ(texts(meter, "readings").front(),
            R"({"power":12.5,"swapped":12.5,"temperature":0.8,"counter":2147549183,"bytes":128,)"
            R"("huge":18446744073709551615,"minus":-1,"pump":true,"door":false})");
  EXPECT_EQ(device.requests() - before, 6);  // neighbours come together
  meter.host().advance(1s);
  EXPECT_EQ(meter.host().published("readings").size(), 11U);
}

TEST(Modbus, writes_commands_and_refuses_those_that_are_wrong_as_a_whole) {
  Device device;
  const int port = tests::free_port();
  device.serve_tcp(port);
  const std::string map =
      "[{name: setpoint, address: 5, type: int16, scale: 0.5, writable: true, min: -20, max: 40},"
      " {name: energy, address: 6, type: uint32, writable: true}, {name: fixed, address: 8},"
      " {name: level, address: 10, type: float32, writable: true},"
      " {name: pump, table: coil, address: 9, writable: true}]";
  MockInstance meter(modbus_plugin(), patient({{"connect", at(port)}, {"registers", map}}));
  ASSERT_TRUE(meter.start()) << meter.error();
  ASSERT_TRUE(meter.deliver("write", command(R"({"setpoint": -10.5, "energy": 70000, "pump": true})")));
  EXPECT_EQ(device.word(5), 0xffeb);
  EXPECT_EQ(device.word(6), 1);
  EXPECT_EQ(device.word(7), 70'000 - 65'536);
  EXPECT_TRUE(device.bit(9));
  const auto told = [&](const std::string& text, const std::string& why) {
    MockInstance other(modbus_plugin(), patient({{"connect", at(port)}, {"registers", map}}));
    EXPECT_TRUE(other.start() && other.deliver("write", command(text)));
    return other.host().logged_count(why) == 1;
  };
  EXPECT_TRUE(told(R"({"pump": false, "setpoint": 41})", "41: it is out of the range"));
  EXPECT_TRUE(told(R"({"pump": false, "energy": -1})", "no room for it"));
  EXPECT_TRUE(told(R"({"level": 1e39})", "no room for it"));
  EXPECT_TRUE(told(R"({"pump": false, "fixed": 1})", "no writable register \"fixed\""));
  EXPECT_TRUE(told(R"({"pump": 0})", "true or false"));
  EXPECT_TRUE(told(R"({"setpoint": "1"})", "takes a number"));
  EXPECT_TRUE(
      told("{\"setpoint\": " + std::string(1'000'000, '[') + std::string(1'000'000, ']') + "}", "takes a number"));
  EXPECT_TRUE(told("[1]", "no JSON object"));
  EXPECT_TRUE(told("{", "no JSON object"));
  EXPECT_TRUE(device.bit(9));
}

TEST(Modbus, finds_a_device_again_that_vanished) {
  Device device;
  const int port = tests::free_port();
  device.serve_tcp(port);
  MockInstance meter(modbus_plugin(), patient({{"connect", at(port)},
                                               {"registers", "[{name: a, address: 1, writable: true}]"},
                                               {"period_ms", "100"},
                                               {"reconnect_ms", "50"}}));
  ASSERT_TRUE(meter.start()) << meter.error();
  device.set(1, 5);
  meter.host().advance(100ms);
  EXPECT_EQ(last_reading(meter), json({{"a", 5}}));
  device.vanish();
  meter.host().advance(100ms);
  EXPECT_EQ(meter.host().metadata()["connection"], "away");
  meter.host().forget_published();
  meter.host().advance(1s);
  EXPECT_THAT(meter.host().metadata()["connection_problem"], HasSubstr("Connection refused"));
  EXPECT_TRUE(meter.host().published("readings").empty());
  ASSERT_TRUE(meter.deliver("write", command(R"({"a": 1})")));
  EXPECT_EQ(meter.host().logged_count("the device is away"), 3U);  // twice in its state, once for the command
  device.serve_tcp(port);
  device.set(1, 6);
  meter.host().advance(2s);
  EXPECT_EQ(meter.host().metadata()["connection"], "connected");
  EXPECT_EQ(last_reading(meter), json({{"a", 6}}));
}

TEST(Modbus, takes_a_device_for_away_in_whose_place_a_gateway_answers) {
  Device device;
  const int port = tests::free_port();
  device.serve_tcp(port);
  MockInstance meter(modbus_plugin(), patient({{"connect", at(port)},
                                               {"registers", "[{name: a, address: 1}]"},
                                               {"period_ms", "100"},
                                               {"reconnect_ms", "50"}}));
  ASSERT_TRUE(meter.start()) << meter.error();
  EXPECT_EQ(meter.host().metadata()["connection"], "connected");
  for (const unsigned exception : {MODBUS_EXCEPTION_GATEWAY_TARGET, MODBUS_EXCEPTION_GATEWAY_PATH}) {
    device.answer_with(exception);
    meter.host().advance(100ms);
    EXPECT_EQ(meter.host().metadata()["connection"], "away");
    device.answer_with(0);
    meter.host().advance(2s);
    EXPECT_EQ(meter.host().metadata()["connection"], "connected");
  }
}

TEST(Modbus, takes_a_device_that_does_not_answer_for_away) {
  Device device;
  const int port = tests::free_port();
  device.serve_tcp(port);
  device.be_silent(true);
  MockInstance meter(
      modbus_plugin(),
      {{"connect", at(port)}, {"registers", "[{name: a, address: 1}]"}, {"timeout_ms", "20"}, {"reconnect_ms", "50"}});
  ASSERT_TRUE(meter.start()) << meter.error();
  EXPECT_THAT(meter.host().metadata()["connection_problem"], HasSubstr("timed out"));
  device.be_silent(false);
  ASSERT_TRUE(until(meter, [&] {
    meter.host().advance(50ms);
    return meter.host().metadata()["connection"] == "connected";
  }));
}

TEST(Modbus, gives_null_for_a_register_that_the_device_refuses_and_reads_its_neighbours) {
  Device device;
  const int port = tests::free_port();
  device.serve_tcp(port);
  device.set(99, 3);
  MockInstance meter(
      modbus_plugin(),
      patient({{"connect", at(port)}, {"registers", "[{name: last, address: 99}, {name: beyond, address: 100}]"}}));
  ASSERT_TRUE(meter.start()) << meter.error();
  meter.host().advance(3s);
  EXPECT_EQ(last_reading(meter), json({{"last", 3}, {"beyond", nullptr}}));
  EXPECT_EQ(meter.host().logged_count("refuses to read \"beyond\""), 1U);
}

TEST(Modbus, polls_no_further_while_its_channel_is_full_and_reports_changes_only_when_asked) {
  Device device;
  const int port = tests::free_port();
  device.serve_tcp(port);
  MockInstance meter(modbus_plugin(),
                     patient({{"connect", at(port)}, {"registers", "[{name: a, address: 1}]"}, {"report", "changes"}}));
  ASSERT_TRUE(meter.start()) << meter.error();
  meter.host().answer_publish("readings", PublishStatus::would_block);
  meter.host().advance(1s);
  const int before = device.requests();
  device.set(1, 1);
  meter.host().advance(5s);
  EXPECT_EQ(device.requests(), before);
  meter.host().answer_publish("readings", PublishStatus::accepted);
  ASSERT_TRUE(meter.writable("readings"));
  EXPECT_EQ(last_reading(meter), json({{"a", 0}}));
  meter.host().advance(5s);
  ASSERT_EQ(meter.host().published("readings").size(), 2U);
  EXPECT_EQ(last_reading(meter), json({{"a", 1}}));
}

TEST(Modbus, speaks_with_a_device_on_a_line_despite_of_noise) {
  const Line line;
  const int keeps_it_open = open(line.path().c_str(), O_RDWR | O_NOCTTY | O_CLOEXEC);
  Device device;
  device.set(1, 42);
  device.serve_line(line.descriptor());
  MockInstance meter(
      modbus_plugin(),
      {{"device", line.path()}, {"unit", "7"}, {"registers", "[{name: a, address: 1}]"}, {"timeout_ms", "2000"}});
  ASSERT_TRUE(meter.start()) << meter.error();
  EXPECT_EQ(meter.host().metadata()["connection"], "connected");
  line.write(std::string("\x07\x03\x02\x00\x00\x01\x02", 7));  // an answer with a wrong checksum
  meter.host().advance(1s);
  EXPECT_EQ(last_reading(meter), json({{"a", 42}}));
  meter.close();
  device.vanish();
  ::close(keeps_it_open);
}

TEST(Modbus, says_what_is_wrong_in_its_map_and_properties) {
  const auto error_with = [](PropertyMap properties) {
    properties.try_emplace("connect", "127.0.0.1:1");
    properties.try_emplace("registers", "[{name: a, address: 1}]");
    MockInstance instance(modbus_plugin(), properties);
    EXPECT_FALSE(instance.open());
    return instance.error();
  };
  EXPECT_THAT(error_with({{"device", "x"}}), HasSubstr("give one of"));
  EXPECT_THAT(error_with({{"registers", ""}}), HasSubstr("\"registers\""));
  EXPECT_THAT(error_with({{"registers", ""}, {"registers_file", "/no/such"}}), HasSubstr("/no/such"));
  const auto map_error = [&](const std::string& map) { return error_with({{"registers", map}}); };
  EXPECT_THAT(map_error("a: 1"), HasSubstr("takes a list"));
  EXPECT_THAT(map_error("[]"), HasSubstr("empty"));
  EXPECT_THAT(map_error("[{name: a, address: 1}, {nam: b}]"), HasSubstr("has no name"));
  EXPECT_THAT(map_error("- {name: a, address: 1}\n- {name: b, address: 2, typ: int16}"),
              HasSubstr("line 2: there is no key \"typ\""));
  EXPECT_THAT(map_error("[{name: a}]"), HasSubstr("no address"));
  EXPECT_THAT(map_error("[{name: a, address: 65535, type: uint32}]"), HasSubstr("0 to 65535"));
  EXPECT_THAT(map_error("[{name: a, address: 2147483647, type: uint32}]"), HasSubstr("0 to 65535"));
  EXPECT_THAT(map_error("[{name: a, address: x}]"), HasSubstr("another kind"));
  EXPECT_THAT(map_error("[{name: a, address: 1, type: int8}]"), HasSubstr("one of: bool, float32"));
  EXPECT_THAT(map_error("[{name: a, address: 1, table: coil, type: int16}]"), HasSubstr("bool for tables"));
  EXPECT_THAT(map_error("[{name: a, address: 1, table: input, writable: true}]"), HasSubstr("coil and holding"));
  EXPECT_THAT(map_error("[{name: a, address: 1, scale: 0}]"), HasSubstr("\"scale\""));
  EXPECT_THAT(map_error("[{name: a, address: 1}, {name: a, address: 2}]"), HasSubstr("two registers \"a\""));
  EXPECT_THAT(map_error("[{name: a"), HasSubstr("line 1"));
}

TEST(Modbus, reads_no_more_at_once_than_a_request_may_have) {
  std::vector<Register> map(300);
  for (int i = 0; i < 300; ++i) map[static_cast<std::size_t>(i)].address = i;
  const auto groups = groups_of(map);
  ASSERT_EQ(groups.size(), 3U);
  EXPECT_EQ(groups[0].count, 125);
  EXPECT_EQ(groups[2].first, 250);
  EXPECT_EQ(groups[2].count, 50);
}

}  // namespace
}  // namespace iotcloud::drivers::modbus

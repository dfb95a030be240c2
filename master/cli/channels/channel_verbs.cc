// channel ...: what a channel of a driver instance carries, without a topology; the instance's driver host looks
#include <algorithm>
#include <cctype>
#include <chrono>
#include <ctime>
#include <functional>
#include <iostream>
#include <iterator>
#include <optional>
#include <ostream>
#include <random>
#include <tuple>

#include <CLI/CLI.hpp>
#include <fmt/chrono.h>
#include <fmt/format.h>

#include <iotcloud/discovery/description/json.h>
#include <iotcloud/master/cli/channels/payload_words.h>
#include <iotcloud/master/cli/driver_verbs.h>
#include <iotcloud/master/cli/options.h>
#include <iotcloud/master/cli/verb.h>
#include <iotcloud/master/listing/secret_properties.h>

namespace iotcloud::master::cli {

using discovery::ChannelLook;
using discovery::DriverRecord;
using security::Role;
using Json = nlohmann::ordered_json;
using Rows = std::vector<std::vector<std::string>>;
using std::chrono::milliseconds;

namespace {

constexpr milliseconds echo_pause{200};
constexpr std::int32_t usual_bytes = 4096;
constexpr std::int64_t most_lines = 1'000'000'000;

const char* word(discovery::Direction direction) {
  return direction == discovery::Direction::out ? "out" : "in";
}

/// One look of this program at a channel, until this object goes.
class OneLook {
 public:
  OneLook(MasterClient& master, const DriverRecord& driver, const std::string& channel, std::int32_t most,
          std::int32_t bytes)
      : master_(master), gateway_(driver.gateway) {
    std::random_device random;
    request_.instance = driver.instance;
    request_.channel = channel;
    request_.look = fmt::format("{:08x}{:08x}", random(), random());
    request_.most = most;
    request_.bytes = bytes;
  }
  ~OneLook() {
    request_.last = true;
    try {
      master_.look_at_channel(gateway_, request_);
    } catch (const std::runtime_error&) {
      return;  // a look that nobody asks for ends by itself
    }
  }
  OneLook(const OneLook&) = delete;
  OneLook& operator=(const OneLook&) = delete;

  /// What came since the last call. \throws RequestFailed when the channel cannot be looked at
  ChannelLook ask() { return master_.look_at_channel(gateway_, request_); }
  /// \throws RequestFailed when the instance has stopped, so that nothing comes.
  void check_runs(const ChannelLook& look) const {
    if (look.state == "active" || look.state == "starting" || look.state == "deployed") return;
    throw RequestFailed(fmt::format("instance {} is {}{}{}: nothing comes; `iotcloud start {}` starts it",
                                    request_.instance, printable(look.state), look.reason.empty() ? "" : ": ",
                                    printable(look.reason), request_.instance));
  }

 private:
  MasterClient& master_;
  const discovery::GatewayId gateway_;
  discovery::LookRequest request_;
};

/// A verb about one channel of one instance.
class OfChannel : public Verb {
 public:
  using Verb::Verb;
  void declare(CLI::App& options) override {
    options.add_option("ID", id_, "the id of an instance, its beginning, or its name (meter/2)")->required();
    options.add_option("CHANNEL", channel_, "the channel's name; `iotcloud channel list ID` lists them")->required();
  }

 protected:
  /// For verbs that go on until they are interrupted.
  void declare_lines(CLI::App& options, const char* what) {
    auto* count =
        options.add_option("-n,--count", lines_, what)->check(CLI::Range(std::int64_t{1}, most_lines))->type_name("N");
    options.add_flag("--once", once_, "end after the first, as -n 1")->excludes(count);
  }
  std::int64_t lines() const { return once_ ? 1 : lines_; }

  std::string id_;  ///< or its beginning, or a name
  std::string channel_;

 private:
  std::int64_t lines_ = 0;  ///< 0: without an end
  bool once_ = false;
};

class ListChannels final : public Verb {
 public:
  ListChannels()
      : Verb({"list", "List channels: those of all instances; or of one instance, with what waits in them now",
              "iotcloud channel list meter/2", Role::viewer}) {}
  void declare(CLI::App& options) override {
    options.add_option("ID", id_, "the id of an instance, its beginning, or its name (meter/2)");
  }
  int run(Call& call) override {
    const auto master = call.connect();
    if (id_.empty()) {
      list_all(call, *master);
    } else {
      list_one(call, *master);
    }
    return exit_ok;
  }

 private:
  static void list_all(Call& call, MasterClient& master) {
    auto drivers = master.drivers();
    std::sort(drivers.begin(), drivers.end(), [](const DriverRecord& a, const DriverRecord& b) {
      return std::tie(a.name, a.gateway, a.instance) < std::tie(b.name, b.gateway, b.instance);
    });
    Rows rows;
    Json all = Json::array();
    for (const auto& driver : drivers) {
      for (const auto& channel : driver.channels) {
        rows.push_back({driver.instance, printable(full_name(driver)), printable(driver.name),
                        printable(driver.gateway), printable(channel.name), word(channel.direction),
                        channel.shared ? "shared" : "exclusive", printable(channel.transport)});
        all.push_back({{"instance", driver.instance.str()},
                       {"name", full_name(driver)},
                       {"driver", driver.name.str()},
                       {"gateway", driver.gateway.str()},
                       {"channel", channel.name},
                       {"direction", word(channel.direction)},
                       {"shared", channel.shared},
                       {"broker", channel.transport},
                       {"url", without_password(channel.broker_url)}});
      }
    }
    print(call.out, call.format, {"INSTANCE", "NAME", "DRIVER", "GATEWAY", "CHANNEL", "DIRECTION", "KIND", "BROKER"},
          rows, all);
  }

  void list_one(Call& call, MasterClient& master) const {
    const auto driver = driver_of(id_, master);
    discovery::LookRequest request;
    request.instance = driver.instance;
    const auto look = master.look_at_channel(driver.gateway, request);
    Rows rows;
    Json all = Json::array();
    for (const auto& channel : look.channels) {
      std::string broker = channel.broker_state;
      if (!channel.broker_problem.empty()) broker += ": " + channel.broker_problem;
      rows.push_back(
          {printable(channel.name), word(channel.direction), channel.shared ? "shared" : "exclusive",
           printable(channel.broker), fmt::format("{}", channel.waiting),
           channel.waiting == 0 ? "-" : fmt::format("{:.1f} s", static_cast<double>(channel.oldest_ms) / 1e3),
           printable(broker)});
      Json one = {{"channel", channel.name}, {"direction", word(channel.direction)}};
      const auto rest = discovery::to_json<Json>(channel);
      for (const auto& [key, value] : rest.items()) {
        if (key != "name" && key != "out") one[key] = value;
      }
      all.push_back(std::move(one));
    }
    print(call.out, call.format, {"CHANNEL", "DIRECTION", "KIND", "BROKER", "WAITING", "OLDEST", "CONNECTION"}, rows,
          all);
  }

  std::string id_;  ///< or its beginning, or a name; empty: all instances
};

class Echo final : public OfChannel {
 public:
  Echo()
      : OfChannel({"echo", "Show the messages of a channel as they pass; a sample of them when they are many",
                   "iotcloud channel echo meter/2 temperature -n 5", Role::viewer}) {}
  void declare(CLI::App& options) override {
    OfChannel::declare(options);
    declare_lines(options, "end after so many messages; without it: when interrupted");
    options
        .add_option_function<std::string>(
            "--format",
            [this](const std::string& name) {
              format_ = name == "text"    ? PayloadFormat::text
                        : name == "json"  ? PayloadFormat::json
                        : name == "hex"   ? PayloadFormat::hex
                        : name == "image" ? PayloadFormat::image
                                          : PayloadFormat::auto_;
            },
            "how payloads are shown; image: the size of a picture")
        ->check(CLI::IsMember({"auto", "text", "json", "hex", "image"}))
        ->type_name("FORMAT");
    options.add_option("--bytes", bytes_, "of each payload at most")
        ->check(CLI::Range(std::int32_t{1}, discovery::most_seen_bytes))
        ->type_name("N");
    options.add_flag("--properties", properties_, "show the messages' properties, too");
  }
  bool goes_on() const override { return true; }
  int run(Call& call) override {
    const auto master = call.connect();
    OneLook look(*master, driver_of(id_, *master), channel_, discovery::most_seen_messages, bytes_);
    std::int64_t shown = 0, missed = 0;
    do {
      const ChannelLook seen = look.ask();
      for (const auto& message : seen.messages) {
        show(call, message);
        if (++shown == lines()) return exit_ok;
      }
      call.out.flush();
      if (seen.missed > missed && call.format == Format::table)
        call.err << fmt::format("iotcloud: {} more passed, too many to be shown\n", seen.missed - missed);
      missed = seen.missed;
      look.check_runs(seen);
    } while (call.out && pause(echo_pause));
    return exit_ok;
  }

 private:
  void show(Call& call, const discovery::SeenMessage& message) const {
    if (call.format == Format::table) {
      constexpr std::int64_t ms = 1000;
      std::string line =
          fmt::format("{:%H:%M:%S}.{:03} {}", fmt::localtime(static_cast<std::time_t>(message.seen_ms / ms)),
                      message.seen_ms % ms, payload_words(message.payload, message.size, format_));
      if (properties_) {
        for (const auto& [key, value] : message.properties)
          line += fmt::format(" {}={}", key,
                              payload_words(value, static_cast<std::int64_t>(value.size()), PayloadFormat::auto_));
      }
      call.out << printable(line) << '\n';
      return;
    }
    Json json = {
        {"number", message.number}, {"seen_ms", message.seen_ms}, {"time_ms", message.time_ms}, {"size", message.size}};
    json.update(payload_json(message.payload, message.size, format_));
    if (properties_) json["properties"] = message.properties;
    if (call.format == Format::json) {
      call.out << discovery::to_text(json) << '\n';
    } else {
      print_yaml(call.out, Json::array({json}));
    }
  }

  PayloadFormat format_ = PayloadFormat::auto_;
  std::int32_t bytes_ = usual_bytes;
  bool properties_ = false;
};

/// hz and bw: a line a second of what the host has counted.
class Meter : public OfChannel {
 public:
  using OfChannel::OfChannel;
  void declare(CLI::App& options) override {
    OfChannel::declare(options);
    declare_lines(options, "end after so many lines; without it: when interrupted");
    options.add_option("--every", every_s_, "seconds from line to line")->check(CLI::Range(0.1, 3.0))->type_name("S");
  }
  bool goes_on() const override { return true; }
  int run(Call& call) override {
    const auto master = call.connect();
    OneLook look(*master, driver_of(id_, *master), channel_, 0, 0);
    ChannelLook before = look.ask();
    look.check_runs(before);
    for (std::int64_t shown = 0; call.out && pause(std::chrono::duration<double>(every_s_));) {
      const ChannelLook now = look.ask();
      // The host's count starts again with an instance that was started again.
      if (now.elapsed_us > before.elapsed_us) {
        show(call, before, now);
        call.out.flush();
        if (++shown == lines()) return exit_ok;
      }
      look.check_runs(now);
      before = now;
    }
    return exit_ok;
  }

 protected:
  /// What came between two looks, of which the second has seen more messages.
  virtual std::string words(const ChannelLook& before, const ChannelLook& now) const = 0;
  /// All that came since the look began.
  virtual std::string total(const ChannelLook& now) const = 0;
  /// \return a second, from counts of the host's microseconds
  static double rate(std::int64_t count, std::int64_t us) {
    return us <= 0 ? 0 : static_cast<double>(count) * 1e6 / static_cast<double>(us);
  }

 private:
  void show(Call& call, const ChannelLook& before, const ChannelLook& now) const {
    const auto us = now.elapsed_us - before.elapsed_us;
    if (call.format == Format::table) {
      const std::string came = now.count == before.count
                                   ? fmt::format("no message in {:.1f} s", static_cast<double>(us) / 1e6)
                                   : words(before, now);
      call.out << came << "; " << total(now) << " since the start\n";
      return;
    }
    const Json json = {{"messages_per_s", rate(now.count - before.count, us)},
                       {"bytes_per_s", rate(now.bytes - before.bytes, us)},
                       {"average_messages_per_s", rate(now.count, now.elapsed_us)},
                       {"average_bytes_per_s", rate(now.bytes, now.elapsed_us)},
                       {"shortest_us", now.shortest_us},
                       {"longest_us", now.longest_us},
                       {"smallest", now.smallest},
                       {"largest", now.largest},
                       {"messages", now.count},
                       {"bytes", now.bytes},
                       {"elapsed_us", now.elapsed_us}};
    if (call.format == Format::json) {
      call.out << discovery::to_text(json) << '\n';
    } else {
      print_yaml(call.out, Json::array({json}));
    }
  }

  double every_s_ = 1;
};

class Hz final : public Meter {
 public:
  Hz()
      : Meter({"hz", "Show how many messages a second a channel carries, and the time between them",
               "iotcloud channel hz meter/2 temperature", Role::viewer}) {}

 private:
  std::string words(const ChannelLook& before, const ChannelLook& now) const override {
    const auto us = now.elapsed_us - before.elapsed_us;
    std::string text = fmt::format("{:.1f} messages/s, average {:.1f}/s", rate(now.count - before.count, us),
                                   rate(now.count, now.elapsed_us));
    if (now.longest_us > 0)
      text += fmt::format(", {:.1f} to {:.1f} ms apart", static_cast<double>(now.shortest_us) / 1e3,
                          static_cast<double>(now.longest_us) / 1e3);
    return text;
  }
  std::string total(const ChannelLook& now) const override { return std::to_string(now.count); }
};

class Bw final : public Meter {
 public:
  Bw()
      : Meter({"bw", "Show how many bytes a second a channel carries, and how large its messages are",
               "iotcloud channel bw camera/1 frames", Role::viewer}) {}

 private:
  std::string words(const ChannelLook& before, const ChannelLook& now) const override {
    const auto us = now.elapsed_us - before.elapsed_us;
    return fmt::format("{}/s, average {}/s, messages of {} to {}", byte_words(rate(now.bytes - before.bytes, us)),
                       byte_words(rate(now.bytes, now.elapsed_us)), byte_words(static_cast<double>(now.smallest)),
                       byte_words(static_cast<double>(now.largest)));
  }
  std::string total(const ChannelLook& now) const override { return byte_words(static_cast<double>(now.bytes)); }
};

/// The bytes of hexadecimal digits, which may have blanks between them. \throws CLI::ValidationError
std::string bytes_of_hex(const std::string& text) {
  std::string digits;
  for (const char c : text) {
    if (c == ' ' || c == ':') continue;
    if (std::isxdigit(static_cast<unsigned char>(c)) == 0)
      throw CLI::ValidationError("--hex", fmt::format("\"{}\" has more than hexadecimal digits", text));
    digits += c;
  }
  if (digits.size() % 2 != 0) throw CLI::ValidationError("--hex", "two digits are wanted for each byte");
  std::string bytes;
  for (std::size_t i = 0; i < digits.size(); i += 2)
    bytes.push_back(static_cast<char>(std::stoi(digits.substr(i, 2), nullptr, 16)));
  return bytes;
}

class Publish final : public OfChannel {
 public:
  Publish()
      : OfChannel({"publish", "Hand an instance a message, as if it had come on an incoming channel",
                   "iotcloud channel publish fan/1 control on", Role::operating}) {}
  void declare(CLI::App& options) override {
    OfChannel::declare(options);
    auto* text = options.add_option("TEXT", text_, "the message");
    auto* hex =
        options.add_option("--hex", hex_, "the message, in hexadecimal digits")->type_name("HEX")->excludes(text);
    options.add_option("--file", file_, "the file that has the message; -: standard input")
        ->type_name("FILE")
        ->excludes(text)
        ->excludes(hex);
    options.add_option("--property", properties_, "a property of the message; again for each further one")
        ->type_name("KEY=VALUE")
        ->allow_extra_args(false);
    options.add_option("-n,--count", count_, "how often")
        ->check(CLI::Range(std::int64_t{1}, most_lines))
        ->type_name("N");
    options.add_option("--rate", rate_, "with -n: so many a second")->check(CLI::Range(0.01, 20.0))->type_name("R");
  }
  void check() override {
    if (!text_ && !hex_ && file_.empty()) throw CLI::RequiredError("TEXT, --hex or --file");
    if (hex_) bytes_ = bytes_of_hex(*hex_);
    message_.properties = pairs(properties_, "--property");
  }
  bool goes_on() const override { return count_ > 1; }
  int run(Call& call) override {
    message_.channel = channel_;
    message_.payload = payload();
    const auto master = call.connect();
    const auto driver = driver_of(id_, *master);
    message_.instance = driver.instance;
    for (std::int64_t sent = 0; sent < count_; ++sent) {
      if (sent > 0 && !pause(std::chrono::duration<double>(1 / rate_))) return exit_ok;
      master->hand_message(driver.gateway, message_);
      if (call.format == Format::table) {
        call.out << fmt::format("{} B on {} of {}: its driver has handled them\n", message_.payload.size(),
                                printable(channel_), driver.instance);
      } else {
        print_data(call.out, call.format,
                   {{"instance", driver.instance.str()},
                    {"channel", channel_},
                    {"bytes", message_.payload.size()},
                    {"outcome", "handled"}});
      }
      call.out.flush();
    }
    return exit_ok;
  }

 private:
  std::string payload() const {
    if (text_) return *text_;
    if (hex_) return bytes_;
    if (file_ == "-") return {std::istreambuf_iterator<char>(std::cin), {}};
    return bytes_of(file_);
  }

  std::optional<std::string> text_, hex_;
  std::string bytes_;  ///< of `hex_`
  std::string file_;
  std::vector<std::string> properties_;
  discovery::HandedMessage message_;
  std::int64_t count_ = 1;
  double rate_ = 1;
};

}  // namespace

void add_channel_verbs(Verbs& verbs) {
  auto& group = verbs.group("channel", "Look at channels of driver instances, and send to them by hand");
  group.add<ListChannels>();
  group.add<Echo>();
  group.add<Hz>();
  group.add<Bw>();
  group.add<Publish>();
}

}  // namespace iotcloud::master::cli

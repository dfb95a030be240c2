#pragma once

#include <csignal>
#include <filesystem>
#include <stdexcept>
#include <string>
#include <vector>

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <iotcloud/drivers/driver.h>

namespace iotcloud::gateway {

/// A driver that does what the deployment's properties say, including faults.
/// throw_in: the call that throws: channels, open, activate, timer or message
///   crash_file: when this file appears it is removed and the process dies of SIGSEGV
///   alone: while it is open it has the lock of this file; there it writes a line with its process, and "not alone"
///   behind
///     it when another process has the lock (then open() throws)
///   shared: "true" makes both channels shared; channels: "none" leaves them out
///   publishes_on: publishes on this channel when it is activated, too
///   says: "KEY=VALUE", metadata that it has from the beginning; a message "say KEY=VALUE" changes it
/// It publishes one message ("up") when it is activated, and answers each message on `control` with its echo. Its
/// metadata `stored` has what on_stored reported.
class ProbeDriver : public drivers::Driver {
 public:
  ProbeDriver() = default;
  ~ProbeDriver() override {
    if (lock_ >= 0) ::close(lock_);
  }
  ProbeDriver(const ProbeDriver&) = delete;
  ProbeDriver& operator=(const ProbeDriver&) = delete;

  std::vector<drivers::ChannelSpec> channels(const drivers::PropertyMap& properties) override {
    throw_in_ = value(properties, "throw_in");
    throw_if("channels");
    drivers::ChannelSpec out;
    out.name = "readings";
    out.shared = value(properties, "shared") == "true";
    drivers::ChannelSpec in;
    in.name = "control";
    in.direction = drivers::Direction::in;
    in.shared = out.shared;
    if (value(properties, "channels") == "none") return {};
    return {out, in};
  }

  void open(drivers::DriverContext& context) override {
    context_ = &context;
    throw_if("open");
    say(value(context.properties(), "says"));
    be_alone(value(context.properties(), "alone"));
    if (throw_in_ == "timer") context.after(std::chrono::milliseconds{1}, [this] { throw_if("timer"); });
    const std::string crash_file = value(context.properties(), "crash_file");
    if (crash_file.empty()) return;
    context.every(std::chrono::milliseconds{5}, [crash_file] {
      if (std::filesystem::remove(crash_file)) {
        std::signal(SIGSEGV, SIG_DFL);  // without this a sanitizer's handler would write its report
        std::raise(SIGSEGV);
      }
    });
  }

  void activate() override {
    throw_if("activate");
    if (value(context_->properties(), "channels") == "none") return;
    context_->publish("readings", drivers::Payload::copy("up"));
    const std::string other = value(context_->properties(), "publishes_on");
    if (!other.empty()) context_->publish(other, drivers::Payload::copy("up"));
  }

  void on_message(std::string_view, drivers::Message message) override {
    throw_if("message");
    if (message.payload.text().starts_with("say ")) say(std::string(message.payload.text().substr(4)));
    context_->publish("readings", std::move(message));
  }

  void on_stored(std::string_view channel, std::uint64_t count) override {
    say("stored=" + std::string(channel) + " " + std::to_string(count));
  }

 private:
  void say(const std::string& pair) const {
    const auto equals = pair.find('=');
    if (equals != std::string::npos) context_->update_metadata({{pair.substr(0, equals), pair.substr(equals + 1)}});
  }
  void be_alone(const std::string& file) {
    if (file.empty()) return;
    lock_ = ::open(file.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600);
    const bool alone = flock(lock_, LOCK_EX | LOCK_NB) == 0;
    const std::string line = std::to_string(getpid()) + (alone ? "\n" : " not alone\n");
    if (write(lock_, line.data(), line.size()) < 0 || !alone) throw std::runtime_error("another one has " + file);
  }
  static std::string value(const drivers::PropertyMap& properties, const std::string& name) {
    const auto found = properties.find(name);
    return found == properties.end() ? "" : found->second;
  }
  void throw_if(const std::string& where) const {
    if (throw_in_ == where) throw std::runtime_error("told to throw in " + where);
  }

  std::string throw_in_;
  int lock_ = -1;  ///< see `alone`
  drivers::DriverContext* context_ = nullptr;
};

}  // namespace iotcloud::gateway

#pragma once

#include <chrono>
#include <condition_variable>
#include <functional>
#include <map>
#include <mutex>
#include <string>
#include <vector>

#include <iotcloud/drivers/plugin.h>
#include <iotcloud/tests/eventually.h>

namespace iotcloud::tests {

/// The answers that the drivers in this process got, by instance id. Thread safe.
class Answers {
 public:
  static Answers& get() {
    static Answers answers;
    return answers;
  }
  void add(const std::string& instance, std::string text) {
    const std::lock_guard lock(mutex_);
    texts_[instance].push_back(std::move(text));
    changed_.notify_all();
  }
  std::vector<std::string> of(const std::string& instance) const {
    const std::lock_guard lock(mutex_);
    const auto found = texts_.find(instance);
    return found == texts_.end() ? std::vector<std::string>() : found->second;
  }
  /// \return false if the instance does not get this many answers within 20 s.
  bool wait_for(const std::string& instance, std::size_t count) const {
    std::unique_lock lock(mutex_);
    return changed_.wait_for(lock, tests::patience, [&] {
      const auto found = texts_.find(instance);
      return found != texts_.end() && found->second.size() >= count;
    });
  }

 private:
  mutable std::mutex mutex_;
  mutable std::condition_variable changed_;
  std::map<std::string, std::vector<std::string>> texts_;  ///< guarded by mutex_
};

/// Sends "<instance id> <number>" on `ping`, one message each millisecond, `count` in all (0: endless), and stores the
/// messages that it gets on `pong`. Property `shared`: "true" makes both channels shared.
class Pinger : public drivers::Driver {
 public:
  std::vector<drivers::ChannelSpec> channels(const drivers::PropertyMap& properties) override {
    drivers::ChannelSpec ping, pong;
    ping.name = "ping";
    pong.name = "pong";
    pong.direction = drivers::Direction::in;
    ping.shared = pong.shared = properties.contains("shared") && properties.at("shared") == "true";
    return {ping, pong};
  }
  void open(drivers::DriverContext& context) override {
    context_ = &context;
    count_ = context.integer("count", 0);
  }
  void activate() override {
    timer_ = context_->every(std::chrono::milliseconds(1), [this] { send(); });
  }
  void deactivate() override { context_->stop(timer_); }
  void on_message(std::string_view, drivers::Message message) override {
    Answers::get().add(context_->instance_id(), std::string(message.payload.text()));
  }

  static const drivers::Descriptor* descriptor() {
    static const auto descriptor = drivers::describe<Pinger>("pinger", "1.0");
    return &descriptor;
  }

 private:
  void send() {
    if (count_ > 0 && next_ >= count_) return;
    const std::string text = context_->instance_id() + " " + std::to_string(next_);
    if (context_->publish("ping", drivers::Payload::copy(text)) == drivers::PublishStatus::accepted) ++next_;
  }
  drivers::DriverContext* context_ = nullptr;
  drivers::HandlerId timer_ = 0;
  std::int64_t count_ = 0, next_ = 0;
};

}  // namespace iotcloud::tests

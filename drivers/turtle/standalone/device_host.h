#pragma once

#include <functional>
#include <map>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include <boost/asio/io_context.hpp>

#include <iotcloud/drivers/driver.h>

namespace iotcloud::drivers::turtle {

/// Hosts sources and actuators in a program of their own, without a driver host: it offers timers, descriptors and
/// posted calls on the thread that runs `loop`. It has no channels (publish answers closed) and no metadata. Any thread
/// may call post, log and fail; only the loop's thread calls the rest.
class DeviceHost final : public HostInterface {
 public:
  using Log = std::function<void(LogLevel, std::string_view)>;
  /// \param loop must outlive this. \param log must be thread safe. \param on_fail runs once, on the loop's thread.
  DeviceHost(boost::asio::io_context& loop, PropertyMap properties, Log log,
             std::function<void(const std::string& reason)> on_fail);
  /// No callback runs after this.
  ~DeviceHost() override;
  DeviceHost(const DeviceHost&) = delete;
  DeviceHost& operator=(const DeviceHost&) = delete;

  const std::string& instance_id() const noexcept override { return id_; }
  const std::string& gateway_id() const noexcept override { return id_; }
  const PropertyMap& properties() const noexcept override { return properties_; }
  PublishStatus publish(std::string_view channel, Message message) noexcept override;
  HandlerId start_timer(std::chrono::microseconds first, std::chrono::microseconds period,
                        std::function<void()> callback) noexcept override;
  HandlerId watch_descriptor(int descriptor, bool for_writing, std::function<void()> callback) noexcept override;
  void stop_handler(HandlerId id) noexcept override;
  void post(std::function<void()> callback) noexcept override;
  void log(LogLevel level, std::string_view text) noexcept override;
  void fail(std::string_view reason) noexcept override;
  void update_metadata(const PropertyMap&) noexcept override {}
  void report_found(std::string_view, const PropertyMap&) noexcept override {}
  void report_gone(std::string_view) noexcept override {}
  void report_sight(bool) noexcept override {}

 private:
  struct Handler;
  void wait(const std::shared_ptr<Handler>& handler);

  boost::asio::io_context& loop_;
  const PropertyMap properties_;
  const std::string id_;
  const Log log_;
  const std::function<void(const std::string&)> on_fail_;
  std::map<HandlerId, std::shared_ptr<Handler>> handlers_;
  HandlerId next_ = 1;
  bool failed_ = false;
  /// false once this is destroyed; read on the loop's thread by posted callbacks
  const std::shared_ptr<bool> alive_ = std::make_shared<bool>(true);
};

/// Logs lines to standard error: "PROGRAM: warning: ...". Thread safe.
DeviceHost::Log log_to_stderr(std::string program);

/// Reads "key=value" words as properties. \throws std::invalid_argument for other words and for repeated keys.
PropertyMap parse_properties(const std::vector<std::string>& words);

}  // namespace iotcloud::drivers::turtle

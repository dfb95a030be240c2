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

/// What sources and actuators need to run in a program of its own, where there is no driver host: timers, descriptors
/// and posted calls on the thread that runs `loop`. There are no channels (publish answers closed) and no metadata.
/// Everything but post, log and fail belongs to that thread.
class DeviceHost final : public HostInterface {
 public:
  using Log = std::function<void(LogLevel, std::string_view)>;
  /// \param loop outlives this. \param log thread safe. \param on_fail runs on the loop's thread, once.
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
  const std::shared_ptr<bool> alive_ = std::make_shared<bool>(true);  ///< for what is posted; of the loop's thread
};

/// Lines on standard error: "PROGRAM: warning: ...". Thread safe.
DeviceHost::Log log_to_stderr(std::string program);

/// "key=value" words as properties. \throws std::invalid_argument for another word, and for a key that comes twice.
PropertyMap parse_properties(const std::vector<std::string>& words);

}  // namespace iotcloud::drivers::turtle

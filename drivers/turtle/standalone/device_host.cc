#include <cstdio>
#include <optional>
#include <stdexcept>
#include <utility>

#include <boost/asio/posix/stream_descriptor.hpp>
#include <boost/asio/post.hpp>
#include <boost/asio/steady_timer.hpp>

#include <iotcloud/drivers/turtle/standalone/device_host.h>

namespace iotcloud::drivers::turtle {

namespace asio = boost::asio;

struct DeviceHost::Handler {
  std::function<void()> callback;
  std::optional<asio::steady_timer> timer;
  std::chrono::microseconds period{0};
  std::optional<asio::posix::stream_descriptor> descriptor;
  bool for_writing = false, stopped = false;
};

DeviceHost::DeviceHost(asio::io_context& loop, PropertyMap properties, Log log,
                       std::function<void(const std::string&)> on_fail)
    : loop_(loop),
      properties_(std::move(properties)),
      id_("standalone"),
      log_(std::move(log)),
      on_fail_(std::move(on_fail)) {}

DeviceHost::~DeviceHost() {
  *alive_ = false;
  while (!handlers_.empty()) stop_handler(handlers_.begin()->first);
}

PublishStatus DeviceHost::publish(std::string_view, Message) noexcept {
  return PublishStatus::closed;
}

HandlerId DeviceHost::start_timer(std::chrono::microseconds first, std::chrono::microseconds period,
                                  std::function<void()> callback) noexcept {
  const auto handler = std::make_shared<Handler>();
  handler->callback = std::move(callback);
  handler->timer.emplace(loop_, first);
  handler->period = period;
  handlers_[next_] = handler;
  wait(handler);
  return next_++;
}

HandlerId DeviceHost::watch_descriptor(int descriptor, bool for_writing, std::function<void()> callback) noexcept {
  const auto handler = std::make_shared<Handler>();
  handler->callback = std::move(callback);
  handler->for_writing = for_writing;
  handler->descriptor.emplace(loop_);
  boost::system::error_code error;
  handler->descriptor->assign(descriptor, error);
  if (error) {
    log(LogLevel::error, "descriptor " + std::to_string(descriptor) + " cannot be watched: " + error.message());
    return next_++;
  }
  handlers_[next_] = handler;
  wait(handler);
  return next_++;
}

void DeviceHost::wait(const std::shared_ptr<Handler>& handler) {
  const auto fire = [this, handler](const boost::system::error_code& error) {
    if (error || handler->stopped) return;
    const bool once = handler->timer && handler->period.count() == 0;
    // Before the callback, which may stop its own handler.
    if (handler->timer && !once) handler->timer->expires_at(handler->timer->expiry() + handler->period);
    if (once) {
      std::erase_if(handlers_, [&](const auto& entry) { return entry.second == handler; });
      handler->stopped = true;
    }
    handler->callback();
    if (!handler->stopped) wait(handler);
  };
  if (handler->timer) {
    handler->timer->async_wait(fire);
  } else {
    using asio::posix::stream_descriptor;
    handler->descriptor->async_wait(handler->for_writing ? stream_descriptor::wait_write : stream_descriptor::wait_read,
                                    fire);
  }
}

void DeviceHost::stop_handler(HandlerId id) noexcept {
  const auto found = handlers_.find(id);
  if (found == handlers_.end()) return;
  const auto handler = found->second;
  handlers_.erase(found);
  handler->stopped = true;
  if (handler->timer) handler->timer->cancel();
  if (handler->descriptor) handler->descriptor->release();  // it stays the caller's
}

void DeviceHost::post(std::function<void()> callback) noexcept {
  asio::post(loop_, [alive = alive_, callback = std::move(callback)] {
    if (*alive) callback();
  });
}

void DeviceHost::log(LogLevel level, std::string_view text) noexcept {
  log_(level, text);
}

void DeviceHost::fail(std::string_view reason) noexcept {
  post([this, reason = std::string(reason)] {
    if (!std::exchange(failed_, true)) on_fail_(reason);
  });
}

DeviceHost::Log log_to_stderr(std::string program) {
  return [program = std::move(program)](LogLevel level, std::string_view text) {
    const char* word = level == LogLevel::error ? "error: " : level == LogLevel::warn ? "warning: " : "";
    if (level == LogLevel::debug) return;
    std::fprintf(stderr, "%s: %s%.*s\n", program.c_str(), word, static_cast<int>(text.size()), text.data());
  };
}

PropertyMap parse_properties(const std::vector<std::string>& words) {
  PropertyMap properties;
  for (const std::string& word : words) {
    const auto equals = word.find('=');
    if (equals == std::string::npos || equals == 0) {
      throw std::invalid_argument("property \"" + word + "\": write it as key=value");
    }
    if (!properties.emplace(word.substr(0, equals), word.substr(equals + 1)).second) {
      throw std::invalid_argument("property \"" + word.substr(0, equals) + "\" is given twice");
    }
  }
  return properties;
}

}  // namespace iotcloud::drivers::turtle

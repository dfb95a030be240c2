#include <algorithm>
#include <chrono>
#include <cstring>
#include <span>
#include <stdexcept>
#include <utility>

#include <iotcloud/bench/harness/machine.h>
#include <iotcloud/bench/paper/application/load_driver.h>
#include <iotcloud/drivers/property_reader.h>

namespace iotcloud::bench::paper {

LoadDriver::Options LoadDriver::read_options(const drivers::PropertyMap& properties) {
  Options options;
  drivers::PropertyReader reader(properties);
  options.folder = reader.text("folder", "");
  options.broker = reader.text("broker", "");
  options.host = static_cast<unsigned>(reader.integer("host", 0, 0, 1000));
  options.hosts = static_cast<unsigned>(reader.integer("hosts", 1, 1, 1000));
  options.shared = reader.flag("shared", false);
  reader.finish();
  if (options.folder.empty()) throw std::invalid_argument("property \"folder\": name the folder of orders and reports");
  return options;
}

std::vector<drivers::ChannelSpec> LoadDriver::channels(const drivers::PropertyMap& properties) {
  const Options options = read_options(properties);
  drivers::ChannelSpec data;
  data.name = data_channel;
  data.direction = drivers::Direction::out;
  data.broker = options.broker;
  data.shared = options.shared;
  drivers::ChannelSpec echo = data;
  echo.name = echo_channel;
  echo.direction = drivers::Direction::in;
  return {data, echo};
}

void LoadDriver::open(drivers::DriverContext& context) {
  context_ = &context;
  options_ = read_options(context.properties());
  conductor_ = Conductor::of(options_.folder);
}

void LoadDriver::activate() {
  number_ = conductor_->join(
      [this](std::shared_ptr<Point> point) { context_->post([this, point = std::move(point)] { begin(point); }); });
}

void LoadDriver::deactivate() {
  if (number_) conductor_->leave(*number_);
  number_.reset();
  if (timer_) context_->stop(*timer_);
  timer_.reset();
}

void LoadDriver::begin(std::shared_ptr<Point> point) {
  if (!number_) return;
  if (timer_) context_->stop(*timer_);
  timer_.reset();
  point_ = std::move(point);
  const Order& order = point_->order();
  turn_ = *number_ * options_.hosts + options_.host;
  messages_ = order.messages(turn_);
  next_ = expected_ = 0;
  if (!bodies_ || bodies_->size() != order.size) bodies_.emplace(std::max(order.size, sizeof(Stamp)));
  point_->joined(messages_);
  if (!blocked_) wait_for_next();
}

void LoadDriver::wait_for_next() {
  if (next_ == messages_) return;
  const std::int64_t left_ns = std::max<std::int64_t>(0, point_->order().intended_ns(turn_, next_) - now_ns());
  timer_ = context_->after(std::chrono::ceil<std::chrono::microseconds>(std::chrono::nanoseconds(left_ns)), [this] {
    timer_.reset();
    send_due();
  });
}

void LoadDriver::send_due() {
  while (next_ < messages_ && !point_->overrun()) {
    const Stamp stamp{point_->order().id, next_, point_->order().intended_ns(turn_, next_)};
    if (stamp.intended_ns > now_ns()) {
      wait_for_next();
      return;
    }
    const auto status = context_->publish(data_channel, bodies_->beginning_with(std::as_bytes(std::span(&stamp, 1))));
    if (status == drivers::PublishStatus::closed) return;
    blocked_ = status == drivers::PublishStatus::would_block;
    if (blocked_) return;
    ++next_;
    point_->sent();
  }
}

void LoadDriver::on_writable(std::string_view channel) {
  if (channel != data_channel || !blocked_) return;
  blocked_ = false;
  if (point_ && !timer_) send_due();
}

void LoadDriver::on_message(std::string_view channel, drivers::Message message) {
  const std::int64_t arrived_ns = now_ns();
  Stamp stamp;
  if (channel != echo_channel || !point_ || message.payload.size() < sizeof stamp) return;
  std::memcpy(&stamp, message.payload.data(), sizeof stamp);
  if (stamp.order != point_->order().id) return;
  if (message.payload.size() != bodies_->size() || stamp.number < expected_) {
    point_->wrong();
    return;
  }
  expected_ = stamp.number + 1;
  point_->came_back(stamp.intended_ns, arrived_ns);
}

}  // namespace iotcloud::bench::paper

#include <algorithm>
#include <filesystem>
#include <utility>

#include <fcntl.h>
#include <fmt/format.h>

#include <iotcloud/config/durable_write.h>
#include <iotcloud/config/error.h>
#include <iotcloud/discovery/description/json.h>
#include <iotcloud/discovery/order_times.h>
#include <iotcloud/gateway/followed_orders.h>
#include <iotcloud/processes/durable_file.h>

namespace iotcloud::gateway {

namespace {

constexpr unsigned of_the_gateway_only = 0600;
/// A file with fewer lines is not worth to be written anew.
constexpr std::size_t few_lines = 1000;

/// A line that is no FollowedOrder.
struct FreezeLine {
  std::string freeze;  ///< see FollowedOrders::freeze()
  static constexpr const char* what = "the freeze of a gateway";
  static constexpr auto fields = std::tuple{IOTCLOUD_FIELD(freeze, required)};
};

template <typename Line>
std::string text_line(const Line& line) {
  return discovery::to_text(discovery::to_json<nlohmann::json>(line)) + '\n';
}

}  // namespace

FollowedOrders::FollowedOrders(std::string file) : file_(std::move(file)) {
  if (!file_.empty() && std::filesystem::exists(file_)) load();
}

void FollowedOrders::load() {
  const std::string text = processes::read_file(file_, 0);
  std::size_t number = 0;
  for (std::size_t at = 0, end = 0; (end = text.find('\n', at)) != std::string::npos; at = end + 1) {
    ++number;
    const std::string line = text.substr(at, end - at);
    try {
      if (line.starts_with("{\"freeze\"")) {
        freeze_ = discovery::from_text<FreezeLine>(line, file_).freeze;
      } else {
        take(discovery::from_text<FollowedOrder>(line, file_));
      }
    } catch (const config::Error& e) {
      throw config::Error(fmt::format(
          "line {} of the orders that this gateway followed is damaged: {}. Without the file the gateway trusts the "
          "orders as they stand in the registry, also old ones: look at them (`iotcloud drivers`), and remove the file",
          number, e.what()));
    }
  }
}

const FollowedOrder* FollowedOrders::find(const discovery::InstanceId& instance) const {
  const auto found = known_.find(instance);
  return found == known_.end() ? nullptr : &found->second;
}

std::int64_t FollowedOrders::oldest_of_unknown_ms() const {
  return newest_ms_ - discovery::clocks_differ.count();
}

void FollowedOrders::take(const FollowedOrder& order) {
  known_.insert_or_assign(order.instance, order);
  newest_ms_ = std::max(newest_ms_, order.counts_ms);
}

/// An older order of such an instance is refused without them, too.
void FollowedOrders::forget_old_removals() {
  std::erase_if(known_, [this](const auto& entry) {
    return entry.second.removed && entry.second.given_ms < oldest_of_unknown_ms();
  });
}

void FollowedOrders::add(const std::vector<FollowedOrder>& orders) {
  if (orders.empty()) return;
  if (!file_.empty()) {
    if (!lines_ || written_ > 2 * known_.size() + few_lines) {
      forget_old_removals();
      replace(known_, freeze_);
    }
    std::string text;
    for (const auto& order : orders) text += text_line(order);
    try {
      processes::write_all(lines_, text, file_);
      processes::sync_file(lines_, file_);
    } catch (const config::Error&) {
      lines_.reset();  // the file may end with part of a line
      throw;
    }
    written_ += orders.size();
  }
  for (const auto& order : orders) take(order);
}

void FollowedOrders::set_freeze(const std::string& token) {
  if (token == freeze_) return;
  replace(known_, token);
  freeze_ = token;
}

void FollowedOrders::forget_all() {
  replace({}, freeze_);
  known_.clear();
  newest_ms_ = 0;
}

void FollowedOrders::replace(const Known& known, const std::string& freeze) {
  if (file_.empty()) return;
  std::string text;
  if (!freeze.empty()) text += text_line(FreezeLine{freeze});
  for (const auto& [instance, order] : known) text += text_line(order);
  lines_.reset();
  config::replace_file(file_, text, of_the_gateway_only);
  lines_ = processes::OwnedDescriptor(open(file_.c_str(), O_WRONLY | O_APPEND | O_CLOEXEC));
  if (!lines_) throw config::Error(file_ + " cannot be opened once more");
  written_ = known.size();
}

}  // namespace iotcloud::gateway

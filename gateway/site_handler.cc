#include <algorithm>
#include <cstddef>

#include <fmt/format.h>

#include <iotcloud/config/log.h>
#include <iotcloud/discovery/description/wire.h>
#include <iotcloud/gateway/host/plugin.h>
#include <iotcloud/gateway/host/round_trips.h>
#include <iotcloud/gateway/site_handler.h>
#include <iotcloud/processes/log_reader.h>

namespace iotcloud::gateway {

using discovery::DriverState;
using discovery::InstanceId;
using discovery::wire::TResponseState;

namespace {

constexpr config::Logger site_logger{"gateway.thrift"};

}  // namespace

void SiteHandler::answering(Response& answer, const std::string& what, const std::function<void()>& method) {
  answer.__set_state(TResponseState::SUCCESS);
  try {
    session_->begins(what);
    method();
  } catch (const std::exception& e) {
    answer.__set_state(TResponseState::FAILURE);
    answer.__set_statusMessage(e.what());
    site_logger.warn("an order was refused: {}", e.what());
  }
  session_->note(answer.state == TResponseState::SUCCESS ? "done" : answer.statusMessage);
}

Gateway::AwaitedRecord SiteHandler::await(Response& answer, const InstanceId& id, std::int64_t order_version,
                                          DriverState wanted) {
  auto outcome = gateway_.wait_for(
      id,
      [&](const auto& record) { return record && (record->state == wanted || record->state == DriverState::failed); },
      outcome_limit_, order_version);
  if (!outcome.known) {
    answer.__set_state(TResponseState::FAILURE);
    answer.__set_statusMessage(
        fmt::format("the order for {} stands, but nothing came of it within {} ms: its outcome "
                    "is not known yet",
                    id, outcome_limit_.count()));
  } else if (outcome.record->state != wanted) {
    answer.__set_state(TResponseState::FAILURE);
    answer.__set_statusMessage(outcome.record->reason);
  }
  return outcome;
}

void SiteHandler::check_may_order() const {
  if (!gateway_.has_joined()) {
    throw config::Error(
        fmt::format("gateway {} has not registered yet: the registry is away, or another process has the id; try again "
                    "when it has",
                    gateway_.id()));
  }
  if (!gateway_.follows_signed_orders()) return;
  throw config::Error(
      fmt::format("gateway {} follows only orders that a master has signed (orders.trusted_keys): give this one to a "
                  "master",
                  gateway_.id()));
}

void SiteHandler::hearbeat(discovery::wire::THeartBeatResponse& answer, const discovery::wire::THeartBeatRequest&) {
  const auto all = gateway_.instances();
  const auto responsive = std::count_if(all.begin(), all.end(), [](const auto& record) {
    return record.state == DriverState::active || record.state == DriverState::inactive;
  });
  answer.__set_totalSensors(static_cast<std::int32_t>(all.size()));
  answer.__set_responsiveSonsor(static_cast<std::int32_t>(responsive));
}

void SiteHandler::deploySensor(Response& answer, const discovery::wire::TSensorDeployDescriptor& descriptor) {
  answering(answer, descriptor.filename, [&] {
    check_may_order();
    check_plugin_file_name(descriptor.filename);
    discovery::OrderRecord order;
    order.instance = discovery::new_instance_id();
    order.plugin = descriptor.filename;
    if (descriptor.className.find('.') == std::string::npos) order.driver = discovery::DriverName(descriptor.className);
    if (!order.driver.empty()) check_name("driver name", order.driver);
    order.properties = descriptor.properties;
    order.epoch = gateway_.epoch();
    if (registry_.get(paths_.gateway_draining(gateway_.id()))) {
      throw config::Error(
          fmt::format("the gateway {0} is draining, so nothing is deployed on it; `iotcloud undrain {0}` "
                      "ends that",
                      gateway_.id()));
    }
    if (const auto trouble = gateway_.trouble(); !trouble.empty()) throw config::Error(trouble);
    const std::string path = paths_.order(gateway_.id(), order.instance);
    registry_.create(path, encode(order));
    const auto outcome = await(answer, order.instance, -1, DriverState::active);
    if (outcome.known && outcome.record->state == DriverState::failed) {
      registry_.remove(path);  // remove the order of a failed deployment
    } else if (outcome.known) {
      answer.__set_statusMessage(order.instance);
    }
  });
}

void SiteHandler::unDeploySensor(Response& answer, const std::string& text) {
  const InstanceId id(text);
  answering(answer, id, [&] {
    check_may_order();
    check_name("instance id", id);
    if (!registry_.remove(paths_.order(gateway_.id(), id))) {
      throw config::Error(fmt::format("the gateway {} has no driver instance {}", gateway_.id(), id));
    }
    const auto gone = gateway_.wait_for(
        id, [](const auto& record) { return !record; }, outcome_limit_);
    if (gone.known) return;
    answer.__set_state(TResponseState::FAILURE);
    answer.__set_statusMessage(
        fmt::format("the order to remove {} stands, but it is still there after {} ms", id, outcome_limit_.count()));
  });
}

void SiteHandler::set_active(Response& answer, const InstanceId& id, bool active) {
  answering(answer, id, [&] {
    check_may_order();
    check_name("instance id", id);
    const std::string path = paths_.order(gateway_.id(), id);
    const auto node = registry_.get(path);
    if (!node) throw config::Error(fmt::format("the gateway {} has no driver instance {}", gateway_.id(), id));
    auto order = discovery::decode_order(node->data, path);
    order.active = active;
    order.epoch = gateway_.epoch();
    registry_.set(path, encode(order), node->version);
    await(answer, id, node->version + 1, active ? DriverState::active : DriverState::inactive);
  });
}

void SiteHandler::authenticate(Response& answer, const std::string& token) {
  const std::string problem = session_->authenticate(token);
  answer.__set_state(problem.empty() ? TResponseState::SUCCESS : TResponseState::FAILURE);
  answer.__set_statusMessage(problem);
}

void SiteHandler::getChanges(std::vector<wire::TStateChange>& answer, const std::string& instance) {
  constexpr std::size_t most_bytes = std::size_t{4} << 20;  // masters read no answer without end
  for (const auto& change : latest_of(gateway_.changes(InstanceId(instance)), most_bytes))
    discovery::fill_wire(change, answer.emplace_back());
}

void SiteHandler::readLog(wire::TLogPart& answer, const std::string& text, const std::string& position,
                          std::int32_t most_bytes) {
  constexpr std::int32_t most_at_once = 256 * 1024;
  const InstanceId instance(text);
  try {
    if (log_folder_.empty()) throw config::Error("the driver hosts of this gateway keep no log of their own");
    check_name("instance id", instance);
    const std::string path = paths_.order(gateway_.id(), instance);
    const auto node = registry_.get(path);
    if (!node) throw config::Error(fmt::format("the gateway {} has no driver instance {}", gateway_.id(), instance));
    const std::string plugin = discovery::decode_order(node->data, path).plugin;
    check_plugin_file_name(plugin);
    const auto part = processes::read_log(fmt::format("{}/{}.log", log_folder_, plugin.substr(0, plugin.rfind('.'))),
                                          position, static_cast<std::size_t>(std::clamp(most_bytes, 1, most_at_once)));
    answer.__set_text(part.text);
    answer.__set_position(part.position);
  } catch (const config::Error& e) {
    wire::TSiteError error;
    error.__set_reason(e.what());
    throw error;
  }
}

void SiteHandler::lookAtChannel(discovery::wire::TChannelLook& answer, const discovery::wire::TLookRequest& request) {
  ChannelQuestion question;
  discovery::fill_own(request, question.look);
  discovery::fill_wire(gateway_.ask(question, answer_limit_), answer);
}

void SiteHandler::handMessage(discovery::wire::TChannelLook& answer, const discovery::wire::THandedMessage& message) {
  const auto handed = discovery::as_own<discovery::HandedMessage>(message);
  taking(fmt::format("{} bytes for channel {} of {}", handed.payload.size(), handed.channel, handed.instance));
  session_->note("refused");
  ChannelQuestion question;
  question.look.instance = handed.instance;
  question.look.channel = handed.channel;
  auto& by_hand = question.message.emplace();
  by_hand.payload = brokers::Payload::copy(handed.payload);
  for (const auto& [key, value] : handed.properties) by_hand.properties.set(key, value);
  const auto look = gateway_.ask(question, answer_limit_);
  session_->note(look.problem.empty() ? "done" : look.problem);
  discovery::fill_wire(look, answer);
}

void SiteHandler::getCarried(std::vector<wire::TCarried>& answer) {
  for (const auto& carried : carried_messages(config::process_metrics().collect())) {
    auto& told = answer.emplace_back();
    told.__set_host(carried.host);
    told.__set_ageMs(carried.age.count());
    told.__set_sent(static_cast<std::int64_t>(carried.sent));
    told.__set_received(static_cast<std::int64_t>(carried.received));
    for (const auto& [end_us, count] : carried.round_trips)
      told.roundTrips.emplace(end_us, static_cast<std::int64_t>(count));
  }
}

void SiteHandler::listPlugins(std::vector<discovery::wire::TKnownPlugin>& answer) {
  for (const auto& plugin : gateway_.known_plugins()) discovery::fill_wire(plugin, answer.emplace_back());
}

void SiteHandler::ping(wire::TPing& answer) {
  answer.__set_gateway(gateway_.id());
  answer.__set_timeMs(config::system_clock().wall_ms());
}

/// Tells the audit log that a plugin, or a message, is about to be taken. \throws wire::TSiteError if that cannot be
/// written
void SiteHandler::taking(const std::string& what) {
  try {
    session_->begins(what);
  } catch (const config::Error& e) {
    wire::TSiteError error;
    error.__set_reason(e.what());
    throw error;
  }
}

void SiteHandler::offerPlugin(std::string& upload, const wire::TPluginOffer& offer) {
  taking(fmt::format("{}, SHA-256 {}", offer.plugin, offer.sha256));
  session_->note("refused");
  upload = plugins_.offer({offer.plugin, offer.sha256, offer.size, offer.signature});
  session_->note(upload.empty() ? "it is there already" : "taken as " + upload);
}

void SiteHandler::finishPlugin(const std::string& upload) {
  taking(upload);
  session_->note("refused");
  plugins_.finish(upload);
  session_->note("done");
}

}  // namespace iotcloud::gateway

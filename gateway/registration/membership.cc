#include <fmt/format.h>
#include <nlohmann/json.hpp>
#include <unistd.h>

#include <iotcloud/config/log.h>
#include <iotcloud/gateway/registration/membership.h>

namespace iotcloud::gateway {

using discovery::RegistryError;
using discovery::RegistryErrorCode;
using nlohmann::json;

namespace {

constexpr config::Logger log{"gateway"};

}  // namespace

Membership::Membership(discovery::Registry& registry, discovery::Paths paths, Options options)
    : registry_(registry),
      paths_(std::move(paths)),
      options_(std::move(options)),
      identity_(json{{"host", options_.record.host},
                     {"port", options_.record.port},
                     {"pid", getpid()},
                     {"state", options_.state_id}}
                    .dump()) {}

Membership::Result Membership::join() {
  if (!tried_) first_try_ = options_.clock->now();
  tried_ = true;
  const std::string& id = options_.record.id;
  try {
    // The first time the record comes first, so that nobody finds a node without one; later the node comes first, so
    // that a gateway that is refused does not overwrite the record of the one that lives.
    if (!registry_.get(paths_.gateway(id))) write_record();
    if (is_own_predecessor()) {
      log.info("the id {} is still held by this gateway's former life; taking it over", id);
      registry_.remove(paths_.gateway_alive(id));
    }
    alive_ = registry_.hold(paths_.gateway_alive(id), identity_);
    write_record();
    if (!registry_.get(paths_.orders(id))) discovery::put(registry_, paths_.orders(id), "");
    return Result::joined;
  } catch (const RegistryError& e) {
    if (e.code() == RegistryErrorCode::exists) {
      tried_ = true;
      return Result::taken;
    }
    log.debug("not registered yet: {}", e.what());
    tried_ = false;
    return Result::away;
  }
}

bool Membership::hopeless() const {
  return options_.clock->now() - first_try_ > options_.session_timeout + options_.session_timeout / 2;
}

void Membership::write_record() {
  discovery::put(registry_, paths_.gateway(options_.record.id), encode(options_.record));
}

bool Membership::is_own_predecessor() {
  const auto node = registry_.get(paths_.gateway_alive(options_.record.id));
  if (!node) return false;
  const auto data = json::parse(node->data, nullptr, false);
  if (!data.is_object()) return false;
  incumbent_ = fmt::format("{}:{}", data.value("host", "?"), data.value("port", 0));
  return !options_.state_id.empty() && data.value("state", "") == options_.state_id;
}

}  // namespace iotcloud::gateway

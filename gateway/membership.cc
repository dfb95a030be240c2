#include <fmt/format.h>
#include <unistd.h>

#include <iotcloud/discovery/presence.h>
#include <iotcloud/gateway/logger.h>
#include <iotcloud/gateway/membership.h>

namespace iotcloud::gateway {

using discovery::RegistryError;
using discovery::RegistryErrorCode;
Membership::Membership(discovery::Registry& registry, discovery::Paths paths, Options options)
    : registry_(registry),
      paths_(std::move(paths)),
      options_(std::move(options)),
      record_(options_.record),
      identity_(discovery::encode(discovery::GatewayLife{options_.record.host, options_.record.port, getpid(),
                                                         options_.state_id, discovery::new_instance_id().str()})) {}

Membership::Result Membership::join() {
  const auto asked = options_.clock->now();
  const discovery::GatewayId& id = options_.record.id;
  try {
    // Without a record, write it before the ephemeral node, so that nobody finds the node without a record. Otherwise
    // hold the ephemeral node first, so that a refused gateway does not overwrite the record of the living one.
    if (!registry_.get(paths_.gateway(id))) write_record();
    if (const auto alive = registry_.get(paths_.gateway_alive(id)); alive && is_own_predecessor(*alive)) {
      logger.info("the id {} is still held by this gateway's former life; taking it over", id);
      registry_.remove(paths_.gateway_alive(id));
    }
    alive_ = registry_.hold(paths_.gateway_alive(id), identity_);
    write_record();
    return Result::joined;
  } catch (const RegistryError& e) {
    if (e.code() == RegistryErrorCode::exists) {
      if (!first_taken_) first_taken_ = options_.clock->now();
      must_be_another_ = asked - *first_taken_ > patience();
      return Result::taken;
    }
    problem_ = e.what();
    first_taken_.reset();
    return Result::away;
  }
}

void Membership::write_record() {
  discovery::put(registry_, paths_.gateway(options_.record.id), encode(record_));
}

/// Whether a dead run of this gateway wrote the node: the state folder, which this run has locked, is the same.
bool Membership::is_own_predecessor(const discovery::Node& alive) {
  return read_holder(alive).state == options_.state_id && !options_.state_id.empty();
}

/// Reads who holds the place, and keeps the address for messages.
discovery::GatewayLife Membership::read_holder(const discovery::Node& alive) {
  try {
    auto life = discovery::decode_life(alive.data, paths_.gateway_alive(options_.record.id));
    holder_address_ = fmt::format("{}:{}", life.host, life.port);
    return life;
  } catch (const config::Error& e) {
    holder_address_ = "it does not say where";
    logger.warn("{}", e.what());
    return {};
  }
}

Membership::Holder Membership::holder(const std::optional<discovery::Node>& alive) {
  if (!alive) return Holder::nobody;
  if (alive->data == identity_) return Holder::self;
  return is_own_predecessor(*alive) ? Holder::nobody : Holder::another;
}

void Membership::hold_again() {
  alive_.reset();  // first, because the end of the former hold removes its node
  alive_ = registry_.hold_eventually(paths_.gateway_alive(options_.record.id), identity_);
}

void Membership::restore_record() {
  const auto node = registry_.get(paths_.gateway(options_.record.id));
  if (!node || node->data != encode(record_)) write_record();
}

}  // namespace iotcloud::gateway

#include <iotcloud/config/log.h>
#include <iotcloud/topology/endpoints/broker_spout.h>

namespace iotcloud::topology {

namespace {

const config::Logger logger{"topology.endpoints"};

}  // namespace

void BrokerSpout::open(const Config&, const TopologyContext& context, SpoutOutputCollector& collector) {
  collector_ = &collector;
  const config::Labels labels{{"topology", context.topology}, {"component", context.component}};
  auto& metrics = *services_->metrics;
  received_ = &metrics.counter("iotcloud_spout_received_total", "Messages taken from brokers", labels);
  retried_ =
      &metrics.counter("iotcloud_spout_retried_total", "Messages whose tuple failed and was tried again", labels);
  rejected_ = &metrics.counter("iotcloud_spout_rejected_total", "Messages given up after their last try", labels);
  inbox_ = std::make_shared<Inbox>(static_cast<std::size_t>(endpoint_.reading.prefetch), context.waker);
  placement_->join(context.task_index, context.task_count, inbox_);
}

void BrokerSpout::close() {
  placement_->leave();  // first, or the broker would deliver again what the closed inbox gives back
  inbox_->close();
  slots_.clear();  // what is under way goes back to the broker
  free_.clear();
}

bool BrokerSpout::next_tuple() {
  auto [arrival, more] = inbox_->pop();
  if (!arrival) return false;
  if (arrival->tries == 0) received_->add();
  Values values = values_of(*arrival);
  if (endpoint_.reading.automatic_ack) {
    collector_->emit_to(endpoint_.stream, std::move(values));
  } else {
    ++arrival->tries;
    collector_->emit_to(endpoint_.stream, std::move(values), keep(std::move(*arrival)));
  }
  return more;
}

void BrokerSpout::ack(MessageId id) {
  if (auto arrival = take(id)) arrival->delivery.settle(brokers::Settlement::accept);
}

void BrokerSpout::fail(MessageId id) {
  auto arrival = take(id);
  if (!arrival || arrival->reader->closed()) return;  // closed: the broker delivers it again by itself
  if (endpoint_.reading.requeue && arrival->tries < endpoint_.reading.max_tries) {
    retried_->add();
    inbox_->push_front(std::move(*arrival));
    return;
  }
  rejected_->add();
  logger.warn("a message of driver {} is given up after {} {}; its tuple failed", arrival->delivery.message.driver_id,
              arrival->tries, arrival->tries == 1 ? "try" : "tries");
  arrival->delivery.settle(brokers::Settlement::reject);
}

Values BrokerSpout::values_of(const Arrival& arrival) const {
  const brokers::Message& message = arrival.delivery.message;
  Values values;
  for (const FieldRole role : endpoint_.roles) {
    switch (role) {
      case FieldRole::payload:
        if (endpoint_.form == PayloadForm::text) {
          values.add(std::string(message.payload.text()));
        } else {
          values.add(message.payload);
        }
        break;
      case FieldRole::driver_id:
        values.add(message.driver_id.empty() ? arrival.reader->driver_id() : message.driver_id);
        break;
      case FieldRole::time:
        values.add(message.time_ms);
        break;
    }
  }
  return values;
}

MessageId BrokerSpout::keep(Arrival arrival) {
  if (free_.empty()) {
    free_.push_back(static_cast<std::uint32_t>(slots_.size()));
    slots_.emplace_back();
  }
  const std::uint32_t place = free_.back();
  free_.pop_back();
  slots_[place].arrival = std::move(arrival);
  return (MessageId{++slots_[place].uses} << 32) | place;
}

std::optional<Arrival> BrokerSpout::take(MessageId id) {
  const auto place = static_cast<std::uint32_t>(id);
  if (place >= slots_.size() || slots_[place].uses != id >> 32) return std::nullopt;
  auto arrival = std::exchange(slots_[place].arrival, std::nullopt);
  if (arrival) free_.push_back(place);
  return arrival;
}

}  // namespace iotcloud::topology

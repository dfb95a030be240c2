#include <iotcloud/topology/endpoints/message_fields.h>
#include <iotcloud/topology/endpoints/sending/broker_bolt.h>

namespace iotcloud::topology {

void BrokerBolt::prepare(const Config&, const TopologyContext& context, OutputCollector& collector) {
  collector_ = &collector;
  first_task_ = context.task_index == 0;
  if (endpoint_.make_builder) builder_ = endpoint_.make_builder();
  routes_->join();
}

void BrokerBolt::cleanup() {
  routes_->leave(*collector_);
}

void BrokerBolt::execute(const Tuple& tuple) {
  if (tuple.is_tick()) {
    if (first_task_) routes_->on_tick();
    return;
  }
  routes_->send(message_of(tuple, endpoint_, payload_fields_, builder_.get(), *services_->clock), tuple, *collector_);
}

}  // namespace iotcloud::topology

#include <utility>

#include <iotcloud/master/listing/lost_orders.h>
#include <iotcloud/master/master.h>
#include <iotcloud/master/orders/order_services.h>
#include <iotcloud/master/topologies/topology_service.h>

namespace iotcloud::master {

struct Master::Impl : OrderServices {
  using OrderServices::OrderServices;
  TopologyService topologies{desk, submissions};
};

Master::Master(discovery::Registry& registry, MasterOptions options)
    : impl_(std::make_unique<Impl>(registry, std::move(options))) {}

Master::~Master() {
  impl_->desk.leadership.finish();
}

OrderResult Master::deploy(const DeployRequest& request) {
  return impl_->deployments.deploy(request);
}
OrderResult Master::undeploy(const InstanceSelection& selection) {
  return impl_->changes.change(selection, InstanceAction::undeploy);
}
OrderResult Master::start(const InstanceSelection& selection) {
  return impl_->changes.change(selection, InstanceAction::start);
}
OrderResult Master::stop(const InstanceSelection& selection) {
  return impl_->changes.change(selection, InstanceAction::stop);
}
OrderResult Master::update_metadata(const InstanceSelection& selection, const MetadataChanges& changes) {
  return impl_->changes.update_metadata(selection, changes);
}
OrderResult Master::change_deployment(const DeploymentChange& change) {
  return impl_->changes.change_deployment(change);
}
OrderResult Master::drain(const GatewaySelection& selection) {
  return impl_->draining.drain(selection, false);
}
OrderResult Master::undrain(const GatewaySelection& selection) {
  return impl_->draining.drain(selection, true);
}
OrderResult Master::update(const UpdateRequest& request) {
  return impl_->updates.update(request);
}
GivenOrder Master::give(const std::string& order, const std::string& json, const BeforeOrder& before) {
  const auto* kind = find_order_kind(order);
  if (kind == nullptr) return {"", refuse(OrderRefusal::bad_request, "this master knows no order \"" + order + "\"")};
  try {
    return kind->give(*impl_, json, before);
  } catch (const config::Error& e) {
    return {"", refuse(OrderRefusal::bad_request, e.what())};
  }
}
TopologyResult Master::order(const TopologyRequest& request) {
  return impl_->topologies.order(request);
}

std::optional<OrderResult> Master::refusal() const {
  return impl_->desk.leadership.refusal();
}

std::vector<discovery::DriverRecord> Master::drivers() const {
  return impl_->desk.view.list();
}

std::vector<discovery::DriverRecord> Master::drivers_and_lost_orders() const {
  auto all = drivers();
  auto& desk = impl_->desk;
  for (auto& waiting : lost_orders(desk.registry, desk.options.paths, all)) all.push_back(std::move(waiting));
  return all;
}

std::vector<discovery::GatewayStatus> Master::gateways() const {
  auto gateways = impl_->desk.gateways();
  for (auto& gateway : gateways) gateway.original = impl_->desk.is_direct(gateway.record.id);
  return gateways;
}

std::vector<discovery::PlacedOrder> Master::orders() const {
  return discovery::list_orders(impl_->desk.registry, impl_->desk.options.paths, {});
}

Backup Master::backup() const {
  return impl_->backups.make();
}

std::vector<discovery::TopologyStatus> Master::topologies() const {
  return discovery::list_topologies(impl_->desk.registry, impl_->desk.options.paths);
}

std::vector<discovery::PoolRecord> Master::pools() const {
  return discovery::list_pools(impl_->desk.registry, impl_->desk.options.paths);
}

discovery::TopologyHistory Master::history(const discovery::TopologyName& topology) const {
  const auto path = impl_->desk.options.paths.topology_history(topology);
  const auto node = impl_->desk.registry.get(path);
  return node ? discovery::decode_history(node->data, path) : discovery::TopologyHistory{};
}

MasterStatus Master::status() const {
  const auto& leadership = impl_->desk.leadership;
  MasterStatus status;
  status.id = impl_->desk.options.id;
  const auto lead = leadership.lead();
  status.leading = lead.has_value();
  status.epoch = lead ? lead->epoch : 0;
  status.registry_away = impl_->desk.registry.session() != discovery::SessionState::connected;
  if (!status.registry_away) status.leader = leadership.leader();  // reading it would wait for an absent registry
  return status;
}

void Master::close() {
  impl_->desk.leadership.close();
}

}  // namespace iotcloud::master

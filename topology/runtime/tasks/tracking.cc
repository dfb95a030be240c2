#include <iotcloud/topology/runtime/tasks/emitting_lane.h>
#include <iotcloud/topology/runtime/tasks/tracking.h>

namespace iotcloud::topology::internal {

/// The last handle is gone: what nobody acked or failed is lost.
void TupleCell::forget_deliveries() noexcept {
  if (first.is_open()) EmittingLane::settle_from_anywhere(*this, first, Tree::lost);
  if (more != nullptr) {
    for (detail::Delivery& delivery : more->deliveries) {
      if (delivery.is_open()) EmittingLane::settle_from_anywhere(*this, delivery, Tree::lost);
    }
    more->trees.clear();
    more->deliveries.clear();
  }
}

detail::Delivery* TupleCell::find_more(const Task* receiver) {
  for (detail::Delivery& delivery : more->deliveries) {
    if (delivery.is_open_for(receiver)) return &delivery;
  }
  return nullptr;
}

}  // namespace iotcloud::topology::internal

#include <atomic>
#include <variant>

#include <iotcloud/topology/runtime/tasks/pool.h>
#include <iotcloud/topology/storm/shim/parcel.h>
#include <iotcloud/topology/storm/value_format.h>

namespace iotcloud::topology::storm {

namespace {

/// Of the large payloads in all parcels.
std::atomic<std::size_t> bytes_in_parcels{0};

std::size_t large_bytes(const Values& values) {
  std::size_t bytes = 0;
  for (const Value& value : values.all()) {
    const auto* payload = std::get_if<Payload>(&value);
    if (payload != nullptr && payload->size() >= least_array) bytes += payload->size();
  }
  return bytes;
}

}  // namespace

ParcelPtr Parcel::pack(Values& values) {
  const std::size_t bytes = large_bytes(values);
  if (bytes == 0 || bytes_in_parcels.load(std::memory_order_relaxed) > most_bytes) return nullptr;
  bytes_in_parcels.fetch_add(bytes, std::memory_order_relaxed);
  ParcelPtr parcel(internal::Pool<Parcel>::take());
  parcel->bytes = bytes;
  parcel->values.fill(values);
  return parcel;
}

void RecycleParcel::operator()(Parcel* parcel) const noexcept {
  if (parcel->bytes > 0) bytes_in_parcels.fetch_sub(parcel->bytes, std::memory_order_relaxed);
  parcel->values.clear();
  parcel->born_ms.reset();
  internal::Pool<Parcel>::give(parcel);
}

}  // namespace iotcloud::topology::storm

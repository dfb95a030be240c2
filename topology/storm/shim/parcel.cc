#include <variant>

#include <iotcloud/config/metrics.h>
#include <iotcloud/topology/runtime/tasks/pool.h>
#include <iotcloud/topology/storm/shim/parcel.h>
#include <iotcloud/topology/storm/value_format.h>

namespace iotcloud::topology::storm {

namespace {

config::Counter& parcels_made() {
  static config::Counter& counter =
      config::process_metrics().counter("iotcloud_storm_parcels_total", "Tuples whose large payload stayed in C++");
  return counter;
}

config::Gauge& bytes_in_parcels() {
  static config::Gauge& gauge = config::process_metrics().gauge(
      "iotcloud_storm_parcel_bytes", "Large payloads that stay in C++ on their way to another task");
  return gauge;
}

std::int64_t large_bytes(const Values& values) {
  std::int64_t bytes = 0;
  for (const Value& value : values.all()) {
    const auto* payload = std::get_if<Payload>(&value);
    if (payload != nullptr && payload->size() >= least_array) bytes += static_cast<std::int64_t>(payload->size());
  }
  return bytes;
}

}  // namespace

ParcelPtr Parcel::pack(Values& values) {
  const std::int64_t bytes = large_bytes(values);
  if (bytes == 0 || bytes_in_parcels().value() > most_bytes) return nullptr;
  bytes_in_parcels().add(bytes);
  parcels_made().add();
  ParcelPtr parcel(internal::Pool<Parcel>::take());
  parcel->bytes = bytes;
  parcel->values.fill(values);
  return parcel;
}

void RecycleParcel::operator()(Parcel* parcel) const noexcept {
  bytes_in_parcels().add(-parcel->bytes);
  parcel->values.clear();
  parcel->born_ms.reset();
  internal::Pool<Parcel>::give(parcel);
}

}  // namespace iotcloud::topology::storm

#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>

#include <iotcloud/topology/value.h>

namespace iotcloud::topology::storm {

struct Parcel;
/// Empties a parcel, and gives it back to the pool.
struct RecycleParcel {
  void operator()(Parcel* parcel) const noexcept;
};
/// Owns a parcel; without one when it is null.
using ParcelPtr = std::unique_ptr<Parcel, RecycleParcel>;

/// The values, among them a large payload, of a tuple that goes from one task to one other, which is a bolt of C++ and
/// may be in the same process. Java's tuple has the parcel's address in their place. Whoever needs the values takes the
/// parcel, once: that bolt, which gets them as they are, or Java, which makes copies for another process or for a
/// component of its own. Small values cross as bytes: a receiver on another core waits longer for a parcel's memory.
struct Parcel {
  /// So many bytes of large payloads may be in parcels. What is more goes to Java as arrays, whose heap has a limit.
  static constexpr std::int64_t most_bytes = std::int64_t{64} << 20;

  /// Packs values, which are empty then. \return null, and the values as they were, when none is a large payload, or
  /// the parcels have too many bytes already.
  static ParcelPtr pack(Values& values);
  /// The number of values that Java's tuple has.
  std::size_t count() const { return values.size() + (born_ms ? 1 : 0); }

  Values values;
  std::optional<std::int64_t> born_ms;  ///< the value of the hidden last field, if the stream has it
  std::int64_t bytes = 0;               ///< of the large payloads
};

}  // namespace iotcloud::topology::storm

#include <algorithm>

#include <fmt/format.h>

#include <iotcloud/config/error.h>
#include <iotcloud/master/api/pool_pages.h>
#include <iotcloud/master/master.h>

namespace iotcloud::master {

namespace {

constexpr std::chrono::milliseconds pool_limit{5'000};

}  // namespace

LogPart read_worker_log(const Master& master, const PoolAccess& access, const discovery::PlaceId& place,
                        const std::string& position, std::int32_t most_bytes) {
  for (const auto& pool : master.pools()) {
    const bool has_it = std::any_of(pool.places.begin(), pool.places.end(), [&](const auto& one) {
      return one.topology == place.topology && one.place == place.number;
    });
    if (has_it) return pool_read_log(address_of(pool, access), pool.id, place, position, most_bytes, pool_limit);
  }
  throw config::Error(fmt::format("no pool has place {} of a topology {}; `iotcloud topology show {}` lists the places",
                                  place.number, place.topology, place.topology));
}

}  // namespace iotcloud::master

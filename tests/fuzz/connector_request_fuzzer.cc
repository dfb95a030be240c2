// What a driver asks the process that makes its connections for, and what a deployment's `network` says of where it
// may. Bit 2 of the first byte says that the rest is such a text; otherwise it is a request, and bits 0 and 1 say how
// many descriptors came with it.
#include <string>
#include <variant>
#include <vector>

#include "iotcloud/config/clock.h"
#include "iotcloud/config/error.h"
#include "iotcloud/processes/connector_request.h"
#include "iotcloud/processes/places.h"
#include "iotcloud/tests/fuzz/bytes.h"
#include "iotcloud/tests/fuzz/fuzz_target.h"

using namespace iotcloud;
using processes::AllowedPlaces;
using processes::IpAddress;
using processes::Place;

namespace {

/// A machine "camera" has all addresses that were asked for before, none has others.
AllowedPlaces allowed(const std::vector<Place>& places, const std::vector<IpAddress>& of_camera) {
  const auto resolve = [of_camera](const std::string& name, bool) {
    return name == "camera" ? of_camera : std::vector<IpAddress>{};
  };
  return {places, resolve, config::system_clock()};
}

void ask_to_connect(const processes::ConnectRequest& request) {
  const auto endpoint = processes::endpoint_of(request.address, request.size);
  if (!endpoint) return;
  const Place its{to_text(endpoint->address), endpoint->port};
  fuzz::must(!allowed({{"camera", 554}}, {}).allows(*endpoint), "an address that no place has is not allowed");
  fuzz::must(allowed({{"camera", 554}}, {endpoint->address}).allows(*endpoint) == (its.port == 554),
             "an address is allowed with its place's port only");
  if (its.port == 0 || endpoint->address.scope != 0) return;
  const Place read = processes::parse_place(to_text(its));
  fuzz::must(read == its, "an address that is written is read as the same");
  fuzz::must(allowed({read}, {}).knows(*endpoint), "an address that is a place is allowed");
}

void read_places(const std::string& text) try {
  const auto places = processes::parse_places(text);
  for (const Place& place : places)
    fuzz::must(processes::parse_place(to_text(place)) == place, "a place that is written is read as the same");
  auto all = allowed(places, {});
  all.refresh();
} catch (const config::Error&) {  // NOLINT(bugprone-empty-catch): the deployment is refused
}

}  // namespace

IOTCLOUD_FUZZ_TARGET(connector_request, 20'000) {
  if (size == 0) return;
  const std::string rest(fuzz::text(data + 1, size - 1));
  if ((*data & 4U) != 0) return read_places(rest);
  const std::size_t descriptors = *data & 3U;
  const auto request = processes::decode_connector_request(rest, descriptors);
  if (!request) return;
  const std::string once = encode(*request);
  const auto again = processes::decode_connector_request(once, descriptors);
  fuzz::must(again && encode(*again) == once, "a request that was read is written and read as the same");
  if (const auto* to = std::get_if<processes::ConnectRequest>(&*request)) {
    ask_to_connect(*to);
  } else {
    const auto& wanted = std::get<processes::FindRequest>(*request);
    fuzz::must(!allowed({{"camera", 554}, {"10.0.0.7", 80}}, {}).has_name(wanted.name) || wanted.name.size() <= 7,
               "only a place's name may be asked for");
  }
}

#include <algorithm>
#include <utility>

#include <boost/uuid/name_generator_sha1.hpp>
#include <boost/uuid/uuid_io.hpp>

#include <iotcloud/discovery/instance_name.h>

namespace iotcloud::discovery {

InstanceId named_instance_id(const GatewayId& gateway, const std::string& name, int index) {
  // The namespace of these UUIDs: a fixed one of this project, so that other programs' names give other ids.
  static constexpr boost::uuids::uuid space{
      {0x69, 0x6f, 0x74, 0x63, 0x6c, 0x6f, 0x55, 0x64, 0x80, 0x69, 0x6e, 0x73, 0x74, 0x61, 0x6e, 0x63}};
  // The names contain no '/'.
  const auto id = boost::uuids::name_generator_sha1(space)(gateway + "/" + name + "/" + std::to_string(index));
  auto text = boost::uuids::to_string(id);
  text.erase(std::remove(text.begin(), text.end(), '-'), text.end());
  return InstanceId(std::move(text));
}

}  // namespace iotcloud::discovery

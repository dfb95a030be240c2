// A library of this SDK whose compiler has another C++ ABI, by its own word.
#include <iotcloud/topology/plugin.h>

extern "C" __attribute__((visibility("default"))) const iotcloud::topology::LibraryDescriptor*
iotcloud_topology_library() {
  static const iotcloud::topology::LibraryDescriptor descriptor{
      iotcloud::topology::sdk_version, sizeof(iotcloud::topology::LibraryDescriptor), "another", nullptr};
  return &descriptor;
}

// A plugin of a later SDK, whose descriptor this host cannot know beyond the first three members.
#include <cstdint>

namespace {

struct FutureDescriptor {
  std::uint32_t sdk_version = 4711;
  std::uint32_t size = sizeof(FutureDescriptor);
  const char* cxx_abi = "another";
};

}  // namespace

extern "C" __attribute__((visibility("default"))) const void* iotcloud_driver_descriptor() {
  static const FutureDescriptor descriptor;
  return &descriptor;
}

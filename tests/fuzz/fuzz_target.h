#pragma once

#include <cstddef>
#include <cstdint>

#ifndef IOTCLOUD_LIBFUZZER
#include <map>
#include <string>
#endif

// Declares a function that gets hostile bytes, `data` and `size`:
//   IOTCLOUD_FUZZ_TARGET(envelope, 50'000) { ... }
// In the preset `fuzz` it is the one target of a libFuzzer program. Otherwise it is in the table of
// hostile_input_test.cc, which runs the target on its seeds and on `mutations` mutations of them, as many as take a
// second or two under the sanitizer.
#ifdef IOTCLOUD_LIBFUZZER
#define IOTCLOUD_FUZZ_TARGET(name, mutations)                                         \
  static void fuzz_##name(const std::uint8_t* data, std::size_t size);                \
  extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) { \
    fuzz_##name(data, size);                                                          \
    return 0;                                                                         \
  }                                                                                   \
  static void fuzz_##name(const std::uint8_t* data, std::size_t size)
#else
#define IOTCLOUD_FUZZ_TARGET(name, mutations)                                     \
  static void fuzz_##name(const std::uint8_t* data, std::size_t size);            \
  [[maybe_unused]] static const bool fuzz_##name##_is_known =                     \
      iotcloud::fuzz::targets().insert({#name, {fuzz_##name, mutations}}).second; \
  static void fuzz_##name(const std::uint8_t* data, std::size_t size)

namespace iotcloud::fuzz {

struct Target {
  void (*run)(const std::uint8_t* data, std::size_t size);
  std::size_t mutations;
};

/// All targets of the program, by name.
inline std::map<std::string, Target>& targets() {
  static std::map<std::string, Target> all;
  return all;
}

}  // namespace iotcloud::fuzz
#endif

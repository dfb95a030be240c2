#include <cstdint>
#include <cstdio>
#include <exception>
#include <string>

#include <unistd.h>

#include <iotcloud/topology/state/key_value_state.h>

/// Writes checkpoints into the store argv[1] until it is killed, each with all of three keys, and says the number of
/// each on its standard output (8 bytes) when it is durable.
int main(int, char** argv) {
  using namespace iotcloud::topology;
  try {
    KeyValueState state(make_state_store(argv[1]), {"t", "count", 0, 1});
    for (std::int64_t n = 1;; ++n) {
      for (const char* key : {"a", "b", "c"}) state.put(key, std::to_string(n) + std::string(5000, '.'));
      state.checkpoint();
      if (write(STDOUT_FILENO, &n, sizeof n) != sizeof n) return 1;
    }
  } catch (const std::exception& e) {
    std::fprintf(stderr, "%s\n", e.what());
    return 1;
  }
}

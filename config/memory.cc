#include <malloc.h>

#include <iotcloud/config/memory.h>

namespace iotcloud::config {

void keep_freed_memory(std::size_t most) {
  mallopt(M_TRIM_THRESHOLD, static_cast<int>(most));
  // an arena grows in steps of this size: fewer system calls, and untouched pages cost nothing
  mallopt(M_TOP_PAD, 4 << 20);
  // the other settings stop its automatic growth, so it is set to the largest value that this would reach
  mallopt(M_MMAP_THRESHOLD, 32 << 20);
}

}  // namespace iotcloud::config

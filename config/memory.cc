#include <malloc.h>

#include <iotcloud/config/memory.h>

namespace iotcloud::config {

void keep_freed_memory() {
  mallopt(M_TRIM_THRESHOLD, 64 << 20);
  mallopt(M_TOP_PAD, 4 << 20);          // an arena grows by so much: fewer calls, and pages are used only when touched
  mallopt(M_MMAP_THRESHOLD, 32 << 20);  // setting the others ends its adapting by itself, as far as this
}

}  // namespace iotcloud::config

#pragma once

/// On loops over the pixels of buffers that one object owns: the thread sanitizer has nothing to find in them, and
/// makes them fifty times slower. What they call must be inlined to be as fast.
#define IOTCLOUD_PIXEL_LOOP __attribute__((no_sanitize("thread")))

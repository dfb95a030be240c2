#pragma once

/// For loops over the pixels of buffers that one object owns: the thread sanitizer finds nothing in them and makes them
/// fifty times slower. Functions that such a loop calls must be inlined to stay as fast.
#define IOTCLOUD_PIXEL_LOOP __attribute__((no_sanitize("thread")))

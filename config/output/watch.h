#pragma once

#include <chrono>
#include <functional>
#include <iosfwd>

#include <iotcloud/config/output/output.h>

namespace iotcloud::config::output {

/// Ends in an orderly way what runs until it is interrupted: watch(), a tap, a log that is followed. A signal handler
/// may call it.
void interrupt();
/// Waits for `time`. \return false if interrupt() was called.
bool pause(std::chrono::duration<double> time);

/// Shows an answer once, or again every so many seconds until interrupt() is called. On a terminal each answer takes
/// the place of the one before. \param seconds 0: once. \param once shows it, and returns an exit status. \return the
/// last one
int watch(std::ostream& out, Format format, double seconds, const std::function<int()>& once);

}  // namespace iotcloud::config::output

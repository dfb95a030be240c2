#pragma once

#include <cstdint>
#include <filesystem>
#include <iosfwd>
#include <string>

#include <iotcloud/drivers/driver.h>
#include <iotcloud/drivers/turtle/recording/images.h>

/// The work of iotcloud-record. Each call reports its progress to `out`, and ends early, with a complete recording, on
/// SIGINT and SIGTERM (which must be blocked in all threads). \throws std::exception with a message for the user.
namespace iotcloud::drivers::turtle::recording {

struct RecordOptions {
  std::filesystem::path folder;
  PropertyMap properties;    ///< of the driver; `source` names the source, `actuator` is ignored
  std::uint64_t frames = 0;  ///< 0: no limit
  double seconds = 0;        ///< 0: no limit
};
void record(const RecordOptions& options, std::ostream& out);

/// Checks a recording and plays it at its pace times `speed`; 0: without pauses.
struct PlayOptions {
  std::filesystem::path folder;
  double speed = 0;
};
void play(const PlayOptions& options, std::ostream& out);

struct ImportOptions {
  std::filesystem::path from, folder;
  Unit unit = Unit::mm;
  double rate = 30;  ///< frames a second
};
void import_images(const ImportOptions& options, std::ostream& out);

}  // namespace iotcloud::drivers::turtle::recording
